"""Two predictions block by block: for ceilings, signals and contradictions."""

from dataclasses import dataclass

import numpy as np
from scipy import special, stats

# What takes less than this off a joint's squared error is not worth telling.
SMALLEST_GAIN = 0.02


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Paired comparison of two models by blocks of time."""

    gain: float  # share of the squared out-of-sample error that the second model saves
    gain_std: float  # from the scatter between blocks
    # how likely the blocks would favour the second model so much if it were no better,
    # see `p_value`; 1 for a model that is worse in the sum of the blocks, or that saves
    # too little to be worth a name
    p_value: float
    n_blocks: int  # in which the models differ
    helped: float  # share of those in which the second is better

    def significant(self, level, smallest=SMALLEST_GAIN):
        """Whether the second model is better, beyond chance and worth its name."""
        return self.p_value < level and self.gain >= smallest


def p_value(before, after):
    """One-sided test over blocks that the second errors are the smaller ones."""
    # Wilcoxon's signed ranks keep a few difficult blocks from deciding, but with a
    # dozen blocks they cannot reach the level that a hundred candidates ask for,
    # however clear the case; Student's t of the log ratios can. The smaller p-value
    # counts, twice, as two tests were made.
    if before.size < 3:
        return 1.0
    ranks = stats.wilcoxon(before - after, alternative="greater").pvalue
    # A block that is fitted exactly would decide alone.
    tiny = 1e-6 * before.mean()
    ratio = np.log((before + tiny) / (after + tiny))
    error = ratio.std(ddof=1) / np.sqrt(ratio.size)
    t = ratio.mean() / error if error > 0 else np.copysign(np.inf, ratio.mean())
    mean = special.stdtr(ratio.size - 1, -t)
    return float(min(1.0, 2 * np.fmin(ranks, mean)))


def compare(before, after, white=None):
    """Compare squared errors (n_blocks,) of two models."""
    # `white` is the same pair in rows from which the residual's memory is taken out,
    # see `Whitening`; blocks of these are independent, and the p-value is theirs.
    difference = before - after
    changed = difference != 0
    count = int(changed.sum())
    total = before.sum()
    if count == 0 or total == 0:
        return Comparison(gain=0.0, gain_std=0.0, p_value=1.0, n_blocks=0, helped=0.0)
    judged = (before, after) if white is None else white
    left = judged[0] - judged[1]
    better = difference.sum() > 0 and left.sum() > 0
    used = left != 0
    return Comparison(
        gain=float(difference.sum() / total),
        gain_std=float(difference.std() * np.sqrt(difference.size) / total),
        p_value=p_value(judged[0][used], judged[1][used]) if better else 1.0,
        n_blocks=count,
        helped=float((difference > 0).sum() / count),
    )
