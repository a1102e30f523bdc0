"""What blocks of time say about a change of the model, and the steps of a search."""

from dataclasses import dataclass

import numpy as np
from scipy import special, stats

from sklearn_vbjfa.effects import Effect

# Effects that take less than this off a joint's squared error are not worth a name.
SMALLEST_GAIN = 0.02


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """Paired comparison of two models by blocks of time.

    Attributes
    ----------
    gain : float
        Share of the squared out-of-sample error that the second model saves.
    gain_std : float
        Its standard error, from the scatter between blocks.
    p_value : float
        How likely the blocks would favour the second model so much if it were no
        better, see `p_value`; 1 for a model that is worse in the sum of the blocks, or
        that saves too little to be worth a name. The blocks are of rows from which
        the residual's own memory is taken out, so that they are independent.
    n_blocks : int
        Blocks in which the models differ.
    helped : float
        Share of those in which the second is better.
    """

    gain: float
    gain_std: float
    p_value: float
    n_blocks: int
    helped: float

    def significant(self, level, smallest=SMALLEST_GAIN):
        """Whether the second model is better, beyond chance and worth its name."""
        return self.p_value < level and self.gain >= smallest


def p_value(before, after):
    """One-sided test over blocks that the second errors are the smaller ones.

    Wilcoxon's signed ranks keep a few difficult blocks from deciding, but with a
    dozen blocks they cannot reach the level that a hundred candidates ask for, however
    clear the case; Student's t of the log ratios can. The smaller p-value counts,
    twice, as two tests were made.
    """
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


def step_up(p_values, n_tests, alpha):
    """Level of significance after Benjamini and Hochberg, with p-values of n tests.

    That of Bonferroni if none of them passes.
    """
    p_values = np.sort(p_values)
    rank = np.arange(1, p_values.size + 1)
    passing = rank[p_values <= alpha * rank / n_tests]
    return alpha / n_tests * max(int(passing.max(initial=1)), 1)


def compare(before, after, white=None):
    """Compare squared errors (n_blocks,) of two models.

    `white` is the same pair in rows from which the residual's memory is taken out, see
    `Judge`; blocks of these are independent, and the p-value is theirs.
    """
    difference = before - after
    changed = difference != 0
    count = int(changed.sum())
    total = before.sum()
    if count == 0 or total == 0:
        return Evidence(gain=0.0, gain_std=0.0, p_value=1.0, n_blocks=0, helped=0.0)
    judged = (before, after) if white is None else white
    left = judged[0] - judged[1]
    better = difference.sum() > 0 and left.sum() > 0
    used = left != 0
    return Evidence(
        gain=float(difference.sum() / total),
        gain_std=float(difference.std() * np.sqrt(difference.size) / total),
        p_value=p_value(judged[0][used], judged[1][used]) if better else 1.0,
        n_blocks=count,
        helped=float((difference > 0).sum() / count),
    )


def no_worse(best, other):
    """Whether blocks cannot tell that `other` is worse than the best.

    Within one standard error of the paired difference.
    """
    difference = other - best
    error = difference.std() * np.sqrt(difference.size)
    return bool(difference.sum() <= error)


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """An effect that was tried.

    Attributes
    ----------
    effect : Effect
        With the best shape parameters.
    evidence : Evidence
        Against the model without it.
    squares : ndarray of shape (n_blocks, nv)
        Squared out-of-sample residuals with it.
    white : ndarray of shape (n_blocks, nv)
        The same in rows without the residual's memory, in units of what is left of
        each joint's residual, see `Judge`.
    """

    effect: Effect
    evidence: Evidence
    squares: np.ndarray
    white: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Rule:
    """By which rule a step was taken, and at what level.

    Attributes
    ----------
    name : str
        In words.
    level : float
        The p-value had to be below it (not below it, for what is dropped or refused);
        nan where no p-value decided.
    n_tests : int
        Tests among which the level is shared out; 0 where no p-value decided.
    """

    name: str
    level: float = np.nan
    n_tests: int = 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """One round of the search.

    Attributes
    ----------
    action : {"add", "replace", "drop", "refuse", "withdraw"}
        What was done; what does not hold on later data is refused, what does harm on
        motion that it was not fitted to is withdrawn.
    effect : Effect
        What was added or dropped.
    evidence : Evidence
        Why.
    rule : Rule
        By which rule, at what level.
    squares_before, squares_after : ndarray of shape (nv,)
        Sums of squared out-of-sample residuals.
    replaced : Effect or None
        What it replaced.
    rivals : tuple of Candidate
        Others that the data cannot tell from it.
    tried : tuple of Candidate
        All candidates of the joint that beat chance, best first.
    """

    action: str
    effect: Effect
    evidence: Evidence
    rule: Rule
    squares_before: np.ndarray
    squares_after: np.ndarray
    replaced: Effect | None = None
    rivals: tuple = ()
    tried: tuple = ()
