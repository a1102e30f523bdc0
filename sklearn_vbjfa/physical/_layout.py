"""Layout of a parameter vector: which columns are bodies, which are non-negative."""

import warnings

import numpy as np

from sklearn_vbjfa.effects import declarable, declared
from sklearn_vbjfa.physical._pseudo_inertia import INERTIAL_NAMES, N_INERTIAL

# The paper's layout, and this package's default friction: ten inertial parameters and
# the viscous friction of the joint.
_PAPER_WIDTH = 11


def resolve_layout(n_features, options, names=None):
    """Find the columns of the bodies (n_bodies, 10), and those that stay positive."""
    if options.body_starts is not None:
        starts, kept = options.body_starts, options.nonnegative
    else:
        starts, kept = _named_layout(n_features, names) or _guessed_layout(n_features)
    starts, kept = np.array(starts, dtype=int), np.array(kept, dtype=int)
    return starts[:, None] + np.arange(N_INERTIAL), kept


def _named_layout(n_features, names):
    """First columns of the bodies and those of friction; None without any names."""
    if names is None:
        return None
    names = [str(name) for name in names]
    if len(names) != n_features:
        raise ValueError(
            f"parameter_names must hold {n_features} names, one for each column; got "
            f"{len(names)}."
        )
    starts = _named_bodies(names)
    return starts and (starts, [k for k, x in enumerate(names) if _is_nonnegative(x)])


def _named_bodies(names):
    """First columns of the bodies by names such as "joint_1:m", a list."""
    split = [name.rpartition(":") for name in names]
    inertial = [bool(colon) and name in INERTIAL_NAMES for _, colon, name in split]
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
    return starts


def _is_nonnegative(name):
    """Whether a column such as "joint_1:viscous" is of friction that resists motion."""
    effect = name.rpartition(":")[2]
    return effect in declarable() and bool(declared(effect).nonnegative)


def _guessed_layout(n_features):
    """First columns of the bodies of 10 or 11 columns, and the other columns."""
    if n_features < N_INERTIAL:
        warnings.warn(
            f"{n_features} columns are too few for a body (10 inertial "
            "parameters): there is nothing to constrain and the values pass "
            "through unchanged.",
            UserWarning,
            stacklevel=5,
        )
        return [], []
    plain, paper = n_features % N_INERTIAL == 0, n_features % _PAPER_WIDTH == 0
    if plain and paper:
        warnings.warn(
            f"{n_features} columns are a whole number of joints both at 10 and at "
            "11 parameters per joint; taken as 11 (viscous friction last). "
            "Pass parameter_names.",
            UserWarning,
            stacklevel=5,
        )
    if not plain and not paper:
        raise ValueError(
            f"{n_features} columns are not a whole number of joints with 10 or 11 "
            "parameters each: name the columns (pass parameter_names, or data frames "
            'of RigidBodyFeatures, set_output(transform="pandas")).'
        )
    width = _PAPER_WIDTH if paper else N_INERTIAL
    starts = range(0, n_features, width)
    return starts, [first + N_INERTIAL for first in starts] if paper else []
