"""Layout of a parameter vector: which columns are bodies, which are non-negative."""

import warnings
from dataclasses import dataclass
from numbers import Integral

import numpy as np

from sklearn_vbjfa.effects import declarable, declared_nonnegative
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
    """Where the bodies and the non-negative columns of a parameter vector are.

    Attributes
    ----------
    n_features : int
        Length of the vector.
    body_starts : ndarray of int of shape (n_bodies,)
        First column of each body's ten.
    nonnegative : ndarray of int of shape (n_nonnegative,)
        Columns that must not be negative, in increasing order.
    """

    n_features: int
    body_starts: np.ndarray
    nonnegative: np.ndarray

    @property
    def body_columns(self):
        """Columns of every body, ndarray of int of shape (n_bodies, 10)."""
        return self.body_starts[:, None] + np.arange(N_INERTIAL)


def resolve_layout(
    n_features,
    *,
    parameters_per_joint="auto",
    body_starts=None,
    nonnegative="auto",
    parameter_names=None,
):
    """Find the bodies and the non-negative columns of a parameter vector.

    Parameters
    ----------
    n_features : int
        Length of the vector.
    parameters_per_joint : "auto" or int >= 10, default="auto"
        See :class:`PhysicalProjector`.
    body_starts : array-like of int or None, default=None
        See :class:`PhysicalProjector`.
    nonnegative : "auto", array-like of int or of bool, default="auto"
        See :class:`PhysicalProjector`.
    parameter_names : array-like of str of shape (n_features,) or None, default=None
        See :class:`PhysicalProjector`.

    Returns
    -------
    layout : ParameterLayout
        The columns' roles.

    Raises
    ------
    ValueError
        If the columns are not a whole number of joints, bodies overlap or leave the
        vector, a non-negative column belongs to a body, the names tear a body apart,
        or "auto" cannot know.

    Warns
    -----
    UserWarning
        If the vector is too short for a body, or "auto" had to choose between two
        readings.

    Examples
    --------
    >>> from sklearn_vbjfa.physical import resolve_layout
    >>> layout = resolve_layout(24, parameters_per_joint=12, nonnegative=[10, 11, 22])
    >>> layout.body_starts, layout.nonnegative
    (array([ 0, 12]), array([10, 11, 22]))
    """
    names = _check_names(parameter_names, n_features)
    named = None if names is None else _named_bodies(names)
    width = None
    if body_starts is not None:
        starts = _check_body_starts(body_starts, n_features)
    elif named is not None and _is_auto(parameters_per_joint):
        starts = named
    else:
        width = _check_width(parameters_per_joint, n_features)
        starts = np.arange(0, n_features - width + 1, width)
    in_body = np.zeros(n_features, dtype=bool)
    in_body[starts[:, None] + np.arange(N_INERTIAL)] = True

    if _is_auto(nonnegative):
        if named is not None:
            signs = np.array([_is_nonnegative(name) for name in names])
            kept = np.flatnonzero(signs & ~in_body)
        elif width == _PAPER_WIDTH or not starts.size or in_body.all():
            kept = np.flatnonzero(~in_body) if starts.size else np.array([], dtype=int)
        else:
            raise ValueError(
                'nonnegative="auto" knows the layouts of 10 and 11 columns per joint '
                f"(the eleventh is viscous friction); here {int((~in_body).sum())} "
                "columns belong to no body and some effects, an offset say, may be "
                f"negative. Either {_HOW_TO_NAME}, or set nonnegative to the columns "
                "that must not be negative, () for none."
            )
    else:
        kept = _check_nonnegative(nonnegative, n_features)
        if in_body[kept].any():
            raise ValueError(
                f"nonnegative names column {int(kept[in_body[kept]][0])}, which is an "
                "inertial parameter; the constraint set already bounds those. List "
                "friction and effect columns alone."
            )
    return ParameterLayout(n_features=n_features, body_starts=starts, nonnegative=kept)


def _is_auto(value):
    """Whether an option is left to be found out."""
    return isinstance(value, str) and value == "auto"


def _check_names(names, n_features):
    """List of names, one a column, or None."""
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
    """First columns of the bodies that names such as "joint_1:m" tell; None without."""
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
    return effect in declarable() and declared_nonnegative(effect)


def _check_width(width, n_features):
    """Columns per joint; explicit, or 10 or 11 when the length tells."""
    if isinstance(width, str):
        if width != "auto":
            raise ValueError(
                'parameters_per_joint must be "auto" or an integer >= 10, got '
                f"{width!r}"
            )
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
                "11 parameters per joint; taken as 11 (viscous friction last). Set "
                "parameters_per_joint.",
                UserWarning,
                stacklevel=5,
            )
        if not plain and not paper:
            raise ValueError(
                f"{n_features} columns are not a whole number of joints with 10 or 11 "
                f"parameters each. Either {_HOW_TO_NAME}, or set parameters_per_joint, "
                "or body_starts where joints differ."
            )
        return _PAPER_WIDTH if paper else N_INERTIAL
    if isinstance(width, bool) or not isinstance(width, Integral) or width < N_INERTIAL:
        raise ValueError(
            f'parameters_per_joint must be "auto" or an integer >= 10, got {width!r}'
        )
    if n_features % width:
        raise ValueError(
            f"{n_features} columns are not a whole number of joints with "
            f"{width} parameters each (parameters_per_joint). Set it to the columns of "
            "one joint, or set body_starts where joints differ."
        )
    return int(width)


def _check_indices(values, name, n_features):
    """Array of distinct column numbers, sorted."""
    values = np.asarray(values)
    if values.size == 0:
        return np.array([], dtype=int)
    if values.ndim != 1 or not np.issubdtype(values.dtype, np.integer):
        raise ValueError(
            f"{name} must be a list of column numbers, got an array of shape "
            f"{values.shape} and type {values.dtype}."
        )
    if values.min() < 0 or values.max() >= n_features:
        raise ValueError(
            f"{name} must hold column numbers from 0 to {n_features - 1}, got "
            f"{values.min()} to {values.max()}."
        )
    return np.unique(values)


def _check_body_starts(body_starts, n_features):
    """Column numbers of bodies that fit and do not overlap."""
    given = np.asarray(body_starts)
    starts = _check_indices(body_starts, "body_starts", n_features)
    if starts.size != given.size:
        raise ValueError("body_starts names a column twice; every body has its own.")
    if np.any(np.diff(starts) < N_INERTIAL):
        raise ValueError(
            "body_starts must be at least 10 columns apart, got "
            f"{starts.tolist()}: two bodies overlap."
        )
    if starts.size and starts[-1] + N_INERTIAL > n_features:
        raise ValueError(
            f"The body that starts at column {starts[-1]} (body_starts) needs 10 "
            f"columns; the vector has {n_features}."
        )
    return starts


def _check_nonnegative(nonnegative, n_features):
    """Column numbers from numbers or a mask."""
    values = np.asarray(nonnegative)
    if values.dtype == bool:
        if values.shape != (n_features,):
            raise ValueError(
                f"nonnegative as a mask must have shape ({n_features},), got "
                f"{values.shape}."
            )
        return np.flatnonzero(values)
    return _check_indices(nonnegative, "nonnegative", n_features)
