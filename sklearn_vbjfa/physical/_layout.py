"""Layout of a parameter vector: which columns are bodies, which are non-negative."""

import warnings
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.effects import declarable, declared
from sklearn_vbjfa.physical._pseudo_inertia import INERTIAL_NAMES, N_INERTIAL

# The paper's layout, and this package's default friction: ten inertial parameters and
# the viscous friction of the joint.
_PAPER_WIDTH = 11
_HOW_TO_NAME = (
    "name the columns (pass parameter_names, or data frames of RigidBodyFeatures, "
    'set_output(transform="pandas"))'
)


@dataclass(frozen=True, kw_only=True)
class ParameterLayout:
    """Columns of the bodies and of non-negative values in a parameter vector."""

    body_starts: np.ndarray  # (n_bodies,): first column of each body's ten
    nonnegative: np.ndarray  # columns that must not be negative, increasing

    @property
    def body_columns(self):
        """Columns of every body, ndarray of int of shape (n_bodies, 10)."""
        return self.body_starts[:, None] + np.arange(N_INERTIAL)


def resolve_layout(
    n_features, *, body_starts=None, nonnegative="auto", parameter_names=None
):
    """Find the bodies and the non-negative columns of a parameter vector."""
    names = _check_names(parameter_names, n_features)
    named = None if names is None else _named_bodies(names)
    width = None
    if body_starts is not None:
        starts = _check_body_starts(body_starts, n_features)
    elif named is not None:
        starts = named
    else:
        width = _guess_width(n_features)
        starts = np.arange(0, n_features - width + 1, width)
    in_body = np.zeros(n_features, dtype=bool)
    in_body[starts[:, None] + np.arange(N_INERTIAL)] = True

    if not isinstance(nonnegative, str) or nonnegative != "auto":
        kept = _check_columns(nonnegative, "nonnegative", n_features)
        if in_body[kept].any():
            raise ValueError(
                f"nonnegative names column {int(kept[in_body[kept]][0])}, which is an "
                "inertial parameter; the constraint set already bounds those. List "
                "friction and effect columns alone."
            )
    elif named is not None:
        signs = np.array([_is_nonnegative(name) for name in names])
        kept = np.flatnonzero(signs & ~in_body)
    elif width is not None or not starts.size or in_body.all():
        kept = np.flatnonzero(~in_body) if starts.size else np.array([], dtype=int)
    else:
        raise ValueError(
            f"{int((~in_body).sum())} columns belong to no body, and some effects, "
            f"such as an offset, may be negative. Either {_HOW_TO_NAME}, or set "
            "nonnegative to the columns that must not be negative, () for none."
        )
    return ParameterLayout(body_starts=starts, nonnegative=kept)


def _check_names(names, n_features):
    if names is None:
        return None
    names = [str(name) for name in names]
    if len(names) != n_features:
        raise ValueError(
            f"parameter_names must hold {n_features} names, one for each column; got "
            f"{len(names)}."
        )
    return names


def _named_bodies(names):
    """First columns of the bodies by names such as "joint_1:m", None without any."""
    split = [name.rpartition(":") for name in names]
    inertial = [bool(colon) and name in INERTIAL_NAMES for _, colon, name in split]
    if not any(inertial):
        return None
    starts, at = [], 0
    while at < len(names):
        if not inertial[at]:
            at += 1
            continue
        joint = split[at][0]
        body = [f"{joint}:{name}" for name in INERTIAL_NAMES]
        if names[at : at + N_INERTIAL] != body:
            raise ValueError(
                f"The columns named {joint!r} are not the body of one joint from "
                f"column {at} on: expected {body[0]}, {body[1]} to {body[-1]} in the "
                f"order of RigidBodyFeatures; got {', '.join(names[at : at + 10])}."
            )
        starts.append(at)
        at += N_INERTIAL
    return np.array(starts)


def _is_nonnegative(name):
    """Whether a column such as "joint_1:viscous" is of friction that resists motion."""
    effect = name.rpartition(":")[2]
    return effect in declarable() and bool(declared(effect).nonnegative)


def _guess_width(n_features):
    """Columns per joint, 10 or 11; one more than there are where none has a body."""
    if n_features < N_INERTIAL:
        warnings.warn(
            f"{n_features} columns are too few for a body (10 inertial "
            "parameters): there is nothing to constrain and the values pass "
            "through unchanged.",
            UserWarning,
            stacklevel=5,
        )
        return n_features + 1
    plain, paper = n_features % N_INERTIAL == 0, n_features % _PAPER_WIDTH == 0
    if plain and paper:
        warnings.warn(
            f"{n_features} columns are a whole number of joints both at 10 and at "
            "11 parameters per joint; taken as 11 (viscous friction last). "
            "Pass parameter_names, or set body_starts.",
            UserWarning,
            stacklevel=5,
        )
    if not plain and not paper:
        raise ValueError(
            f"{n_features} columns are not a whole number of joints with 10 or 11 "
            f"parameters each. Either {_HOW_TO_NAME}, or set body_starts."
        )
    return _PAPER_WIDTH if paper else N_INERTIAL


def _check_columns(values, name, n_features):
    """Array of distinct column numbers, sorted."""
    values = np.asarray(values)
    if values.size == 0:
        return np.array([], dtype=int)
    if (
        values.ndim != 1
        or not np.issubdtype(values.dtype, np.integer)
        or values.min() < 0
        or values.max() >= n_features
    ):
        raise ValueError(
            f"{name} must be a list of column numbers from 0 to {n_features - 1}; got "
            f"{values!r}."
        )
    return np.unique(values)


def _check_body_starts(body_starts, n_features):
    """Column numbers of bodies that fit and do not overlap."""
    starts = _check_columns(body_starts, "body_starts", n_features)
    ends = np.append(starts[1:], n_features)
    if starts.size != np.size(body_starts) or np.any(ends - starts < N_INERTIAL):
        raise ValueError(
            f"body_starts must be at least 10 columns apart and from the end, got "
            f"{np.asarray(body_starts).tolist()} for {n_features} columns."
        )
    return starts
