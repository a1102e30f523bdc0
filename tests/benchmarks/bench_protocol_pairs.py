"""Fitted to some recordings, judged on another that the report has not seen.

Run as ``python tests/benchmarks/bench_protocol_pairs.py --sets development --data-home
DIR``; the confirmation sets are run once, see ``README.md``. Everything, the search for
effects included, is fitted to the recordings of the fit; the judged recording is
touched once, by the two fitted models.
"""

import sys
import time
import warnings
from dataclasses import dataclass

import numpy as np
from _protocol_sets import PAIRED_SETS, STAGES, pairs
from _report import fixed, parser, publish, rst_table, rst_title
from sklearn.base import clone

from sklearn_vbjfa import EffectDiscovery
from sklearn_vbjfa.physical import ProjectionError

# Share of the judged range that the fitted one has to cover.
OVERLAP = 0.8


@dataclass(frozen=True, kw_only=True)
class Scale:
    """What all pairs of a set are measured by, from all of its recordings."""

    spread: np.ndarray
    torque: dict
    speed: dict

    def overlap(self, fitted, judged):
        """Shares of the judged torque and speed range that were fitted, (2, nv)."""
        return np.array(
            [
                covered(_union(ranges, fitted), _union(ranges, judged))
                for ranges in (self.torque, self.speed)
            ]
        )


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """One pair: arrays of shape (nv,), torques in N m or N."""

    judged: str
    before: np.ndarray
    after: np.ndarray
    reported_before: np.ndarray
    reported_after: np.ndarray
    difference: np.ndarray
    width: np.ndarray
    overlap: np.ndarray
    effects: tuple
    perhaps: tuple
    seconds: float

    @property
    def counted(self):
        """Joints of which the judged ranges were fitted."""
        return (self.overlap >= OVERLAP).all(axis=0)

    @property
    def ratio(self):
        """Judged over reported error, both in N m."""
        return _divide(self.after, self.reported_after)

    @property
    def surely_worse(self):
        """Whether the completed model is worse by more than the report's interval."""
        half = 0.5 * (self.difference[1] - self.difference[0])
        return self.after - self.before > half


def covered(fitted, judged):
    """Share of the range `judged` that lies in the range `fitted`, (nv,) of (2, nv)."""
    shared = np.minimum(fitted[1], judged[1]) - np.maximum(fitted[0], judged[0])
    return _divide(np.maximum(shared, 0.0), judged[1] - judged[0])


def measure_scale(recording, identifier):
    """Fit the declared model to all recordings; return the `Scale` of the set."""
    q, tau, groups = recording.q, recording.tau, recording.groups
    model = clone(identifier).fit(q, tau, groups=groups)
    found = model.residuals(q, tau, groups=groups)
    states = model.state_estimator_.transform(q, groups=groups)
    speed = states[found.index, recording.nv : 2 * recording.nv]
    moving = found.weight > 0
    # rms over normalised error without its 0 / 0 where nothing is missed.
    mean = (found.weight * found.torque).sum(axis=0) / found.weight.sum(axis=0)
    square = found.weight * (found.torque - mean) ** 2
    spread = np.sqrt(square.sum(axis=0) / found.weight.sum(axis=0))
    label = groups[found.index]
    ranges = {"torque": {}, "speed": {}}
    for number, name in enumerate(recording.group_names):
        own = moving & (label == number)[:, None]
        for key, signal in (("torque", found.torque), ("speed", speed)):
            ranges[key][name] = np.array(
                [_columns(signal, own, np.min), _columns(signal, own, np.max)]
            )
    return Scale(spread=spread, **ranges)


def judge(recording, identifier, scale, label, fitted, judged):
    """Close the loop on the fitted recordings and judge it on the others."""
    fit, unseen = recording.select(*fitted), recording.select(*judged)
    started = time.perf_counter()
    loop = EffectDiscovery(identifier, random_state=0)
    loop.fit(fit.q, fit.tau, groups=fit.groups)
    seconds = time.perf_counter() - started
    declared = clone(identifier).fit(fit.q, fit.tau, groups=fit.groups)
    models = declared, loop.identifier_
    found = [m.residuals(unseen.q, unseen.tau, groups=unseen.groups) for m in models]
    spread, outcome = loop.torque_std_, loop.report_.outcome
    each = [one.intervals for one in outcome.errors]
    low, high = np.transpose([one["after"] for one in each])
    return Verdict(
        judged=label,
        before=found[0].rms(),
        after=found[1].rms(),
        reported_before=spread * loop.error_before_,
        reported_after=spread * loop.error_after_,
        difference=spread * np.transpose([one["difference"] for one in each]),
        width=_divide(high, low),
        overlap=scale.overlap(fitted, judged),
        effects=tuple(f"{e.name} {e.joint + 1}" for e in loop.effects_),
        perhaps=tuple(f"{e.name} {e.joint + 1}" for e in loop.possible_),
        seconds=seconds,
    )


def run_set(name, data_home=None, chosen=None):
    """Judge the pairs of one set."""
    frozen = PAIRED_SETS[name]
    recording = frozen.recording(data_home)
    identifier = frozen.identifier(recording.robot_model(), recording.dt)
    scale = measure_scale(recording, identifier)
    verdicts, failed = [], []
    for label, fitted, judged in pairs(recording.group_names, frozen.leave_out):
        if chosen and label not in chosen:
            continue
        try:
            verdicts.append(judge(recording, identifier, scale, label, fitted, judged))
        except (ValueError, ProjectionError) as error:
            failed.append(f"{label}: {error}")
            continue
        effects = ", ".join(verdicts[-1].effects)
        print(
            f"{name} {label}: {verdicts[-1].seconds:.0f} s, {effects}",
            file=sys.stderr,
            flush=True,
        )
    return recording, scale, verdicts, failed


HEADERS = [
    "judged",
    "joint",
    "declared [N m]",
    "completed [N m]",
    "reported [N m]",
    "judged / reported",
    "declared [%]",
    "completed [%]",
    "reported [%]",
    "interval, upper / lower end",
    "surely worse than declared",
    "torque, speed range [%]",
    "counted",
]


def rows_of(verdict, spread):
    """Rows of the table, one a joint."""
    share = 100 / spread
    columns = [
        fixed(verdict.before, 3),
        fixed(verdict.after, 3),
        fixed(verdict.reported_after, 3),
        fixed(verdict.ratio, 2),
        fixed(share * verdict.before),
        fixed(share * verdict.after),
        fixed(share * verdict.reported_after),
        fixed(verdict.width, 2),
        ["yes" if w else "no" for w in verdict.surely_worse],
        [", ".join(fixed(100 * pair, 0)) for pair in verdict.overlap.T],
        ["yes" if c else "no" for c in verdict.counted],
    ]
    return [
        [verdict.judged, f"j{j + 1}", *cells] for j, cells in enumerate(zip(*columns))
    ]


SUMMARY = [
    "set",
    "pairs and joints",
    "counted",
    "declared, median [%]",
    "completed, median [%]",
    "completed, worst [%]",
    "completed worse than declared",
    "surely worse",
    "judged / reported, median",
    "judged / reported, worst",
    "interval, upper / lower end, median",
]


def summary(name, verdicts, spread):
    """Row of the summary: medians and worst cases of what is counted."""
    counted = np.concatenate([v.counted for v in verdicts])

    def gather(values):
        return np.concatenate([values(v) for v in verdicts])[counted]

    before = gather(lambda v: 100 * v.before / spread)
    after = gather(lambda v: 100 * v.after / spread)
    ratio, width = gather(lambda v: v.ratio), gather(lambda v: v.width)
    worse = gather(lambda v: v.surely_worse)
    return [
        name,
        str(counted.size),
        str(counted.sum()),
        *fixed([_over(np.median, before), _over(np.median, after)]),
        *fixed([_over(np.max, after)]),
        str(int((after > before).sum())),
        str(int(worse.sum())),
        *fixed([_over(np.median, ratio), _over(np.max, ratio)], 2),
        *fixed([_over(np.median, width)], 2),
    ]


def section(name, recording, scale, verdicts, failed):
    """Paragraphs of one set."""
    frozen = PAIRED_SETS[name]
    units = recording.torque_units
    cells = [row for verdict in verdicts for row in rows_of(verdict, scale.spread)]
    out = [f"{v.judged} j{j + 1}" for v in verdicts for j in np.flatnonzero(~v.counted)]
    spread = ", ".join(f"{x:.3g}" for x in scale.spread)
    return [
        rst_title(name, "~"),
        f"{recording}: {', '.join(recording.group_names)}. {frozen.describe()}"
        f". Spread of the torque while the joint moves, all recordings: "
        f"{spread} (unit: {', '.join(dict.fromkeys(units))}, in the table N m).",
        rst_table(cells, HEADERS, n_labels=2),
        f"Not counted, range not fitted: {', '.join(out) or 'none'}.",
        *[f"Failed: {message}" for message in failed],
        "\n".join(
            f"- {v.judged}: {', '.join(v.effects) or 'nothing'}"
            + (f"; perhaps {', '.join(v.perhaps)}" if v.perhaps else "")
            + f" ({v.seconds:.0f} s)"
            for v in verdicts
        ),
    ]


INTRODUCTION = f"""Every label is left out once: models are fitted to the other
recordings, the search for effects included, and judged on it. Declared, completed:
root mean square of the torque error on the judged recordings, behind the low-pass and
mask of the fit, of both models fitted to all of the fitted recordings. Reported: what
the report of these says, the error after times the spread of the torque. In per cent of
the torque's spread in the moving time of all recordings of the set. Surely worse: by
more than half the width of the report's interval for the difference. Counted are pairs
and joints of which {100 * OVERLAP:.0f} % or more of the judged range of torque and of
speed were fitted."""


def _union(ranges, names):
    """Range of several recordings, (2, nv); an empty one of joints that never move."""
    low, high = np.moveaxis([ranges[name] for name in names], 1, 0)
    low = np.where(np.isnan(low), np.inf, low).min(axis=0)
    high = np.where(np.isnan(high), -np.inf, high).max(axis=0)
    return np.array([low, high])


def _columns(values, which, reduce):
    """Reduce each column's chosen rows to a number; nan without rows."""
    return np.array(
        [reduce(x[use]) if use.any() else np.nan for x, use in zip(values.T, which.T)]
    )


def _divide(a, b):
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.asarray(b) > 0, a / b, np.nan)


def _over(reduce, values):
    """Reduce what is finite; nan for nothing."""
    values = values[np.isfinite(values)]
    return reduce(values) if values.size else np.nan


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__, data=True)
    arguments.add_argument("--sets", choices=STAGES, default="development")
    arguments.add_argument("--data", nargs="*", help="some of the sets")
    arguments.add_argument("--judged", nargs="*", help="some labels of pairs")
    arguments = arguments.parse_args(argv)
    stage = "quick" if arguments.quick else arguments.sets
    names = [n for n, frozen in PAIRED_SETS.items() if frozen.stage == stage]
    if arguments.data:
        names = [name for name in names if name in arguments.data]
    paragraphs, rows = [], []
    for name in names:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            found = run_set(name, arguments.data_home, arguments.judged)
        paragraphs += section(name, *found)
        if found[2]:
            rows.append(summary(name, found[2], found[1].spread))
    part = f" Only the pairs {', '.join(arguments.judged)}." if arguments.judged else ""
    publish(
        f"protocol_pairs_{arguments.sets}",
        "\n\n".join([INTRODUCTION + part, rst_table(rows, SUMMARY), *paragraphs]),
        arguments,
        command=f"protocol_pairs.py --sets {arguments.sets}",
    )


if __name__ == "__main__":
    main()
