"""What the wide columns of a torque regressor are, by their names and their values.

One parameter vector in SI units is shared by the blocks of columns of all joints. What
rescales, centres or mixes columns on the way breaks that, and nothing downstream would
notice: the fit still runs. Names tell the parameters; numbers tell what scalers leave.
"""

import itertools
import re
import warnings

import numpy as np

# Scalers hit their target to rounding; by chance, columns of different units do not.
_EXACT = 1e-6
# Values of a column of signs, which may have any statistic exactly.
_FEW_VALUES = 3
# Columns looked at before all of them are.
_FIRST = 8
# Mean of a torque, relative to its root mean square, that columns without a mean miss.
_MEAN_TORQUE = 0.1


def parameter_names_of(names, nv):
    """Read the names of the p parameters off those of the nv * p columns."""
    # Columns are such as "tau_joint_1/joint_2:m" with any prefix, as
    # `ColumnTransformer` adds. None where they are not those of `RigidBodyFeatures`,
    # ValueError where only some are.
    names = [] if names is None else [str(name) for name in names]
    if not any(re.search("(^|__)tau_.+/.+:", name) for name in names):
        return None
    # The first column is the mass of the first joint's own body.
    first = re.fullmatch(r"((?:.*__)?tau_(.+)/)\2:m", names[0])
    blocks = np.array(names, dtype=object).reshape(nv, -1)
    if first is not None:
        parameters = [name[len(first[1]) :] for name in blocks[0]]
        if all(_one_joint(block, parameters) for block in blocks):
            return tuple(parameters)
    raise ValueError(
        "Columns of RigidBodyFeatures were left out, renamed or put in another order "
        f"before this regressor: {len(names)} columns from {names[0]} to {names[-1]} "
        f"are not the same parameters for each of {nv} joints. Take the step between "
        "the two out of the pipeline; a selection of columns belongs into the "
        "regressor, as in make_pipeline(SelectFromModel(...), Lasso())."
    )


def _one_joint(block, parameters):
    """Whether columns are these parameters in the torque of one joint."""
    before = {
        name[: len(name) - len(parameter)] if name.endswith(parameter) else None
        for name, parameter in zip(block, parameters)
    }
    return len(before) == 1 and re.fullmatch("(.*__)?tau_.+/", before.pop() or "")


def check_as_computed(X, tau, parameter_names=None, *, warn_only=False):
    """Refuse (or warn of) columns that a scaler or another transformer has changed."""
    # X (n_samples, nv * p), tau (n_samples, nv). Values that a scaler leaves, or that
    # cannot be those of their names, are refused; that all columns have a mean of zero
    # and the torques have not is a warning.
    trace = _trace_of_a_scaler(X) or _impossible(X, tau.shape[1], parameter_names)
    if trace:
        message = (
            f"X is not as RigidBodyFeatures computes it: {trace}. All joints share one "
            "parameter vector in SI units, so that no scaler or PCA can stand between "
            "the features and JointTorqueRegressor. Leave it out (columns get unit "
            "mean square inside), or put it into the regressor: "
            "JointTorqueRegressor(make_pipeline(StandardScaler(), Lasso()))."
        )
        if not warn_only:
            raise ValueError(message)
        warnings.warn(message, UserWarning, stacklevel=3)
    elif _is_centred(X) and not _is_centred_torque(tau):
        warnings.warn(
            "All columns of X have a mean of zero, the torques have not. If a scaler "
            "has centred the columns, take it out: there is no intercept, and constant "
            "torques (gravity) are lost.",
            UserWarning,
            stacklevel=3,
        )


def _impossible(X, nv, parameter_names):
    """Say which column cannot be what its name says, or return an empty string."""
    if parameter_names is None:
        return ""
    blocks = X.reshape(X.shape[0], nv, -1)
    # Each is of one joint and zero in the torques of the others.
    for k, name in enumerate(parameter_names):
        kind = name.rpartition(":")[2]
        if kind not in ("offset", "coulomb"):
            continue
        column = blocks[:, :, k]
        largest = np.abs(column).max()
        constant = np.ptp(column, axis=0).max() <= _EXACT
        if kind == "offset" and not (constant and abs(largest - 1.0) <= _EXACT):
            return f"the columns {name} of a constant torque are not 1"
        if kind == "coulomb" and largest > 1.0 + _EXACT:
            return f"the columns {name} of a sign reach {largest:.6g}"
    return ""


def _trace_of_a_scaler(X):
    """Say what all columns have in common that they cannot have, or nothing."""
    varying = np.flatnonzero(X.max(axis=0) > X.min(axis=0))
    if varying.size < 2 or X.shape[0] <= _FEW_VALUES:
        return ""
    for left_so, trace in _TRACES:
        text = left_so(X[:, varying[:_FIRST]]) and left_so(X[:, varying])
        if text and _varied(X, varying):
            return f"all {varying.size} columns that vary have {text}, as {trace}"
    return ""


def _one_spread(V):
    """Whether every standard deviation is 1."""
    return "a standard deviation of 1" if _all_one(V.std(axis=0)) else ""


def _one_range(V):
    """Whether all columns have the same smallest and the same largest value."""
    low, high = V.min(axis=0), V.max(axis=0)
    size = _EXACT * np.abs(V).max()
    if np.ptp(low) > size or np.ptp(high) > size:
        return ""
    return f"a range of {low[0]:g} to {high[0]:g}"


def _one_size(V):
    """Whether every largest absolute value is 1."""
    largest = np.abs(V).max(axis=0)
    return "a largest absolute value of 1" if _all_one(largest) else ""


def _one_quartile_range(V):
    """Whether every interquartile range is 1; columns of mostly one value have none."""
    first, third = np.percentile(V, [25.0, 75.0], axis=0)
    wide = (third - first)[third > first]
    return "an interquartile range of 1" if wide.size and _all_one(wide) else ""


def _no_correlation(V):
    """Whether columns, three or more, have no correlation with each other."""
    if V.shape[1] < 3:
        return ""
    centred = V - V.mean(axis=0)
    centred /= np.sqrt(np.mean(centred**2, axis=0))
    gram = centred.T @ centred / V.shape[0]
    np.fill_diagonal(gram, 0.0)
    return "no correlation with each other" if np.abs(gram).max() <= _EXACT else ""


# What transformers leave. Of most X, the first columns say that none of it is there.
_TRACES = (
    (_one_spread, "StandardScaler leaves them"),
    (_one_range, "MinMaxScaler leaves them"),
    (_one_size, "MaxAbsScaler leaves them"),
    (_one_quartile_range, "RobustScaler leaves them"),
    (_no_correlation, "PCA leaves them"),
)


def _all_one(values):
    """Whether all numbers are 1."""
    return bool(np.all(np.abs(values - 1.0) <= _EXACT))


def _varied(X, columns):
    """Whether two of some columns at least take more values than signs do."""
    many = (j for j in columns if np.unique(X[:, j]).size > _FEW_VALUES)
    return len(list(itertools.islice(many, 2))) == 2


def _is_centred(X):
    """Whether all columns that vary, two or more, have a mean of zero, to rounding."""
    varying = X.max(axis=0) > X.min(axis=0)
    rounding = 100 * np.finfo(float).eps * np.abs(X).max(axis=0)
    centred = np.abs(X.mean(axis=0)) <= rounding
    return np.count_nonzero(varying) > 1 and bool(np.all(centred[varying]))


def _is_centred_torque(tau):
    """Whether no torque has a mean worth speaking of."""
    size = np.sqrt(np.mean(tau**2, axis=0))
    return bool(np.all(np.abs(tau.mean(axis=0)) <= _MEAN_TORQUE * size))
