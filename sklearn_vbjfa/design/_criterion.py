"""What a motion is worth and will show: it determines a model and parts causes.

With rows x_tj, weights w_tj and noise sigma_j the information on all coefficients is M
= sum_tj w_tj x_tj x_tj' / sigma_j^2, that on the model alone its block M_AA, of n
columns over their sizes at random states. It is worth log det M_AA / 2 - 2 n log
kappa(M_AA^(1/2)), the D-criterion less a smooth condition number kappa, which keeps one
direction from being seen badly for many that are seen well. Of columns C that the model
lacks, it cannot imitate S = M_CC - M_CA M_AA^-1 M_AC: a coefficient c of one effect i
leaves c' S_ii c, in squared standard errors, given the model, and c' (S_ii - S_ik
S_kk^-1 S_ki) c given the model with a rival k, the largest difference of the two.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

# Evidence at which two causes count as told apart: a sum of squared differences of 50
# noise variances is a difference of log likelihoods of 25.
DECIDED = 50.0
# What remains to be gained where nothing shows at all, of that.
_HOPELESS = 1e-3
_RIDGE, _LEAST = 1e-9, 1e-9
# Worth of a condition number that is smaller by a factor e, for each parameter [nats],
# and the power of its means of eigenvalues.
BALANCE, _POWER = 2.0, 6.0
# Why no motion shows an effect.
SAME_COLUMNS = "absorbed by other parameters"


@dataclass(frozen=True, eq=False)
class Questions:
    """What a motion is to decide."""

    n_model: int  # the first columns are those of the model
    # (n_columns,): sizes of coefficients in which columns are compared
    scale: np.ndarray
    effects: tuple = ()  # columns of effects that the model may lack
    # (n_effects,): how much it counts that each shows beside the model
    alone: np.ndarray | None = None
    # (n_effects, n_effects): the same for the row beside the model with the column
    beside: np.ndarray | None = None

    @property
    def weight(self):
        """All weights together."""
        return float(self.alone.sum() + self.beside.sum()) if self.effects else 0.0


@dataclass(frozen=True, eq=False)
class Worth:
    """Value of a criterion."""

    value: float  # to be made large [nats]
    # (n_columns, n_columns): its derivative by the information, symmetric
    by_information: np.ndarray
    # (n_effects,): evidence for each effect beside the model, in squared standard
    # errors: the mean over coefficients of the effect at random
    alone: np.ndarray
    # (n_effects, n_effects): the same beside the model with each rival
    beside: np.ndarray


def worth(information, questions):
    """Judge an information matrix (n_columns, n_columns) of scaled columns."""
    D = questions.scale
    M = information * np.outer(D, D)
    # A motion that hardly moves has next to no information, which is still a number.
    M[np.diag_indices_from(M)] += _LEAST
    a = slice(0, questions.n_model)
    n = questions.n_model
    A = M[a, a]
    size = np.sqrt(np.diag(A))
    factor = cho_factor(A / np.outer(size, size) + _RIDGE * np.eye(n), lower=True)
    value = float(np.log(np.diag(factor[0])).sum() + np.log(size).sum())
    inverse = cho_solve(factor, np.eye(n)) / np.outer(size, size)
    by = np.zeros_like(M)
    by[a, a] = 0.5 * inverse
    balance, by_model = _balance(A)
    value += n * BALANCE * balance
    by[a, a] += n * BALANCE * by_model
    alone, beside = np.zeros(0), np.zeros((0, 0))
    if questions.effects:
        C = M[n:, :n]
        S = M[n:, n:] - C @ inverse @ C.T
        decided, by_left, alone, beside = _decisions(S, questions)
        if questions.weight > 0:
            # Together they count as much as the parameters of the model.
            share = n / questions.weight
            value += share * decided
            L = np.hstack([-C @ inverse, np.eye(len(S))])
            by += share * (L.T @ by_left @ L)
    return Worth(value, by * np.outer(D, D), alone, beside)


def _balance(A):
    """Minus the logarithm of a smooth condition number, and its derivative by A."""
    # Power means of the eigenvalues stand for the largest and the smallest.
    values, vectors = np.linalg.eigh(A)
    values = np.maximum(values, 1e-12 * values[-1])
    high = (values / values[-1]) ** _POWER
    low = (values[0] / values) ** _POWER
    value = -0.5 * (
        np.log(values[-1] / values[0])
        + (np.log(high.sum()) + np.log(low.sum())) / _POWER
    )
    slope = -0.5 * (high / high.sum() - low / low.sum()) / values
    return value, (vectors * slope) @ vectors.T


def _decisions(S, questions):
    """Value of all decisions, its derivative by S, and the evidence in each."""
    n, m = questions.n_model, len(questions.effects)
    spans = [slice(block.start - n, block.stop - n) for block in questions.effects]
    # Mean over the columns of each effect, (m, n_columns).
    mean = np.zeros((m, len(S)))
    for row, span in zip(mean, spans):
        row[span] = 1.0 / (span.stop - span.start)
    alone = mean @ np.diag(S)
    value, slope = _value_of(alone)
    total = float(questions.alone @ value)
    by = np.diag((questions.alone * slope) @ mean)
    beside = np.zeros((m, m))
    for k, span in enumerate(spans):
        block = S[span, span]
        ridge = _RIDGE * np.trace(block) / len(block) + np.finfo(float).tiny
        W = np.linalg.solve(block + ridge * np.eye(len(block)), S[span])
        left = np.diag(S) - np.einsum("kc,kc->c", S[span], W)
        beside[:, k] = mean @ np.maximum(left, 0.0)
        weight = questions.beside[:, k]
        if not weight.any():
            continue
        value, slope = _value_of(beside[:, k])
        total += float(weight @ value)
        each = (weight * slope) @ mean
        by += np.diag(each)
        cross = -W * each
        by[span] += cross
        by[:, span] += cross.T
        by[span, span] += (W * each) @ W.T
    return total, by, alone, beside


def _value_of(evidence):
    """Value of evidence, -log(1 + DECIDED / evidence) / 2, and its derivative."""
    # Nearly all is gained once the evidence is larger than what decides, and where it
    # is small a doubling is worth the same everywhere.
    e = evidence + _HOPELESS * DECIDED
    return -0.5 * np.log1p(DECIDED / e), 0.5 * DECIDED / (e * (e + DECIDED))


def information_of(equations, places, n_columns, weight):
    """Information matrix (n_columns, n_columns) of rows with weights (n, nv)."""
    M = np.zeros((n_columns, n_columns))
    for j, (rows, place) in enumerate(zip(equations.rows, places)):
        M[np.ix_(place, place)] += (rows * weight[:, j]) @ rows.T
    return M


@dataclass(frozen=True, kw_only=True)
class Visible:
    """An effect that a motion shows."""

    name: str
    joint: int  # from zero
    joint_name: str
    # smallest root mean square of its torque, in the most active conditions, that
    # is distinguishable from the model and its nearest rival [N m or N]
    least: float
    rival: str  # empty if there is none


@dataclass(frozen=True, kw_only=True)
class Parted:
    """Two causes of which a report leaves open which one it is."""

    names: tuple
    joint: int  # from zero
    joint_name: str
    # smallest root mean square of the torque of either, in the most active conditions,
    # at which it is distinguishable from the other [N m or N]
    least: float


@dataclass(frozen=True, kw_only=True)
class Invisible:
    """An effect that a motion does not show."""

    name: str
    joint: int  # from zero
    joint_name: str
    reason: str


def condition_number(problem, states):
    """Condition number of the model's columns, rows over their noise."""
    # Columns are over their sizes at random states within the limits, the same for all
    # motions.
    n = problem.model.n_model
    scale = problem.questions.scale[:n]
    M = problem.information(states, 1.0)[:n, :n] * np.outer(scale, scale)
    values = np.linalg.eigvalsh(M)
    if not values[0] > 1e-14 * values[-1]:
        return float("inf")
    return float(np.sqrt(values[-1] / values[0]))


def _least(noise, evidence):
    """Torque that decides, where one as large as the noise has some evidence."""
    return float(noise * np.sqrt(DECIDED / max(evidence, 1e-12)))


def promise(problem, robot, states, step, noise):
    """Say what the motion shows and what not, keyword arguments of the motion."""
    questions, model = problem.questions, problem.model
    if not questions.effects:
        return {}
    judged = worth(problem.information(states, step), questions)
    effects = [one.effect for one in model.effects[model.n_own :]]
    asked = questions.beside > 0
    # Of what the library holds beside it nobody has asked.
    asked_for = questions.beside >= 1
    shows, invisible = [], []
    for k, effect in enumerate(effects):
        where = {
            "name": effect.name,
            "joint": effect.joint,
            "joint_name": robot.joint_names[effect.joint],
        }
        if not questions.alone[k] > 0:
            invisible.append(Invisible(reason=SAME_COLUMNS, **where))
            continue
        evidence, rival = judged.alone[k], ""
        if asked[k].any():
            beside = np.where(asked[k], judged.beside[k], np.inf)
            nearest = int(np.argmin(beside))
            if beside[nearest] < evidence:
                evidence, rival = beside[nearest], effects[nearest].name
        least = _least(noise[effect.joint], evidence)
        shows.append(Visible(least=least, rival=rival, **where))
    parts = []
    for k, i in zip(*np.nonzero(np.triu(np.minimum(asked_for, asked_for.T)))):
        weakest = min(judged.beside[k, i], judged.beside[i, k])
        joint = effects[k].joint
        parts.append(
            Parted(
                names=(effects[k].name, effects[i].name),
                joint=joint,
                joint_name=robot.joint_names[joint],
                least=_least(noise[joint], weakest),
            )
        )
    return {
        "shows": tuple(shows),
        "invisible": tuple(invisible),
        "parts": tuple(sorted(parts, key=lambda one: (one.joint, one.least))),
    }
