"""What the search for effects tries, and what it does."""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.diagnosis._evidence import Evidence


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
    coef : ndarray of shape (k,)
        Its coefficients.
    outside : float
        Share of its columns' power outside the span of the model's.
    """

    effect: object
    evidence: Evidence
    squares: np.ndarray
    white: np.ndarray
    coef: np.ndarray
    outside: float


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
    replaced : Effect or None
        What it replaced.
    evidence : Evidence
        Why.
    rivals : tuple of Candidate
        Others that the data cannot tell from it.
    tried : tuple of Candidate
        All candidates of the joint that beat chance, best first.
    rule : Rule
        By which rule, at what level.
    squares_before, squares_after : ndarray of shape (nv,)
        Sums of squared out-of-sample residuals.
    """

    action: str
    effect: object
    replaced: object
    evidence: Evidence
    rivals: tuple
    tried: tuple
    rule: Rule
    squares_before: np.ndarray
    squares_after: np.ndarray


def closure(effect, library):
    """Names of all effects that an effect contains, directly or not."""
    by_name = {e.name: e for e in library}
    found, open_ = set(), list(effect.contains)
    while open_:
        name = open_.pop()
        if name not in found:
            found.add(name)
            open_ += by_name[name].contains if name in by_name else ()
    return found
