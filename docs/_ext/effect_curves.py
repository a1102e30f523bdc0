"""The picture of an effect: its torque over the signal that it depends on."""

import numpy as np

from sklearn_vbjfa.diagnosis.report._pictures import Figure, Plot, ends_of, range_of

# Most points of the cloud.
_CLOUD = 1500
# Bins that may be needed to follow a law, the fewest first, and rows in one to count.
_BINS, _FEWEST = (24, 48, 96, 192), 8
# Share of the law's variance that may be lost between the bins.
_LOST = 0.05
# Quantiles at the ends of a signal: beyond them the bins would be empty.
_ENDS = (0.001, 0.999)

# Added to the style sheet of reports.
STYLE = """
.vbjfa .figures.pairs{grid-template-columns:minmax(0,1fr) minmax(0,1fr)}
.vbjfa path.spread{fill:var(--after);fill-opacity:.16}
.vbjfa path.mean-before{stroke:var(--ink);stroke-width:2}
.vbjfa path.law{stroke:var(--law);stroke-width:2.5;stroke-dasharray:7 4}
.vbjfa .key.spread{background:var(--after);opacity:.35}
.vbjfa .key.law{background:none;width:18px;height:0;border-top:2px dashed var(--law);
border-radius:0}
"""


def effect_figure(x, after, law, *, with_motion, x_label, y_label):
    """Draw the torque of a joint without an effect over a signal (m,), and its law."""
    # after, law (m,): residual of a model with the effect, and torque of the effect.
    center, bins = _binned(x, law)
    without = after + law

    def means(values):
        return np.array([values[own].mean() for own in bins])

    rows = np.argsort(x, kind="stable")
    rows = rows[np.linspace(0, rows.size - 1, min(rows.size, _CLOUD)).astype(int)]
    way = ", in the direction of motion" if with_motion else ""
    seen = range_of(np.r_[without[rows], means(law)])
    title = f"without the effect{way}"
    plot = Plot(ends_of(center), seen, x_label, y_label, title)
    mean, half = means(without), np.array([without[own].std() for own in bins])
    plot.zero()
    plot.cloud(x[rows], without[rows])
    across = [*plot.across(center), *plot.across(center)[::-1]]
    down = [*plot.down(mean + half), *plot.down(mean - half)[::-1]]
    outline = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(across, down))
    plot.add("spread", f"M{outline}Z")
    plot.line("mean-before", center, mean)
    plot.line("law", center, means(law))
    return Figure(
        title="",
        charts=(plot,),
        keys=(
            ("cloud", "rows of the recording"),
            ("spread", "mean ± one standard deviation"),
            ("law", "fitted law"),
        ),
    )


def _binned(x, law):
    """Middles of bins and their rows: no more bins than the law needs."""
    low, high = np.quantile(x, _ENDS)
    if not high > low:
        low, high = x.min(), x.max()
    labels, lost = [], []
    for n in _BINS:
        label = np.clip((n * (x - low) / (high - low)).astype(int), 0, n - 1)
        mean = np.bincount(label, law, n) / np.maximum(
            np.bincount(label, minlength=n), 1
        )
        labels.append(label)
        lost.append(((law - mean[label]) ** 2).sum())
    # What even the finest bins lose is no function of the signal.
    spare = _LOST * ((law - law.mean()) ** 2).sum()
    k = next(k for k, left in enumerate(lost) if left <= lost[-1] + spare)
    edges = np.linspace(low, high, _BINS[k] + 1)
    bins = [np.flatnonzero(labels[k] == b) for b in range(_BINS[k])]
    kept = [b for b, own in enumerate(bins) if own.size >= _FEWEST]
    return (0.5 * (edges[1:] + edges[:-1]))[kept], [bins[b] for b in kept]
