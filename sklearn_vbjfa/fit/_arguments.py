"""Settings for experts, and validation of the arguments of a fit."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from numbers import Real

import numpy as np
from sklearn.utils.validation import validate_data

from sklearn_vbjfa.equations._checks import check_weight, check_widths
from sklearn_vbjfa.equations._states import SAMPLES_FOR_NOISE
from sklearn_vbjfa.inspection import at_rest, disorder
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.recording import (
    OfferedSignals,
    check_time_stamps,
    check_useful_signals,
    positions_and_signals,
    signals_for,
    take_arrays,
    torques_in_order,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class FitOptions:
    """Settings of `RobotIdentifier` for experts.

    Parameters
    ----------
    state_cutoff : "auto", float, array-like of shape (nv,) or None, default="auto"
        Cut-off frequency [Hz] of `StateEstimator`; ``"auto"`` is 1.25 times the
        cut-off of least acceleration error.
    standstill : "auto", float, array-like of shape (nv,) or None, default="auto"
        Speed [rad/s or m/s] at or below which the equations of a joint are excluded.
        ``"auto"`` is 2 % of the 99.5th percentile of its speed; a joint that shows only
        the noise of its encoder stands still. None excludes nothing.
    joint_weights : "auto", None or array-like of shape (nv,), default="auto"
        Weights of the joints' equations, see `JointTorqueRegressor`.
    torque_noise : float or array-like of shape (nv,), default=None
        Standard deviation of the white noise of one torque sample [N m or N], for
        ``noise_floor_``. None estimates it above the band of the low-pass filter.
    known_masses : dict of str to float, default=None
        Known masses [kg] of bodies, or of a ``"payload"`` (effect `Payload`), which
        determine the common factor of unknown gains.
    window : float, default=1.0
        Length [s] of the windows of ``criterion="simulation"``.
    alike : "auto" or None, default="auto"
        ``"auto"``: rotor inertia, viscous and Coulomb friction, and coefficients of
        unsigned effects share a mean where joints have the same drive: their names
        differ in a leg, a side or a number only and their described bodies are equal.
        None, `gains` or a custom `regressor`: each joint has its own values.
    """

    state_cutoff: object = "auto"
    standstill: object = "auto"
    joint_weights: object = "auto"
    torque_noise: object = None
    known_masses: Mapping[str, float] | None = None
    window: float = 1.0
    alike: str | None = "auto"


def check_criterion(identifier):
    if identifier.criterion not in ("torque", "simulation"):
        raise ValueError(
            f"criterion must be 'torque' or 'simulation'; got {identifier.criterion!r}."
        )
    if identifier.criterion == "torque":
        return
    window = identifier.fit_options.window
    if not (isinstance(window, Real) and 0 < window < np.inf):
        raise ValueError(f"window must be a positive time in s; got {window!r}.")
    if identifier.dt is None:
        raise ValueError(
            "criterion='simulation' needs the sample period: give dt in seconds."
        )


def checked_arrays(estimator, names, X, y):
    """Return X and y in the order of the joints, and further columns of X."""
    X, columns = positions_and_signals(X, names)
    X, y = validate_data(
        estimator,
        X,
        torques_in_order(y, names),
        dtype=np.float64,
        multi_output=True,
        y_numeric=True,
    )
    y = np.asarray(y, dtype=float).reshape(X.shape[0], -1)
    check_widths(names, X, y)
    return X, y, columns


def recording_of_arguments(identifier, X, y, groups, sample_weight, t, signals):
    """Validate the arguments of a fit and return them as a `Recording`."""
    names, dt, channels = identifier.joint_names_, identifier.dt, {}
    X, y, columns = checked_arrays(identifier, names, X, y)
    if identifier.drive is not None:
        channels, signals = identifier.drive.split_signals(y, signals)
    used = signals_for(identifier.effects_, signals, columns, X.shape[0])
    weight = check_weight(sample_weight, y.shape)
    recording = take_arrays(
        X, y, groups, weight, t, dt=dt, joint_names=names, signals=used
    )
    _check_rows(identifier, recording)
    check_useful_signals(signals, recording)
    if identifier.drive is None:
        return recording
    recording = identifier.drive.driven(replace(recording, signals=channels))
    return replace(recording, signals=used)


def checked_recording(identifier, recording, inspected=False):
    """Validate a recording and keep the signals that the effects need."""
    names, X = identifier.joint_names_, recording.inputs
    if recording.joint_names != names or recording.dt != identifier.dt:
        raise ValueError(
            f"recording must have the joints of the robot ({', '.join(names)}) in "
            f"their order and its sample period dt={identifier.dt} s; got "
            f"{', '.join(recording.joint_names)} and {recording.dt} s."
        )
    validate_data(identifier, X, skip_check_array=True)
    _check_rows(identifier, recording, inspected)
    offered = OfferedSignals(recording.signals)
    used = signals_for(identifier.effects_, None, offered, recording.n_samples)
    weight = recording.weight
    if weight is not None and used.keys() == recording.signals.keys():
        return recording
    weight = check_weight(weight, recording.tau.shape)
    return replace(recording, signals=used, weight=weight)


def check_rows_suffice(identifier, recording):
    """Reject a recording that is too short for automatic settings."""
    longest = max(part.stop - part.start for part in recording.segments)
    automatic = recording.states is None and isinstance(identifier.cutoff, str)
    # The estimator of the states rejects shorter recordings.
    minimum = 4 * SAMPLES_FOR_NOISE
    if automatic and SAMPLES_FOR_NOISE <= longest < minimum:
        raise ValueError(
            f"The longest recording has {longest} rows; record at least {minimum}."
        )


def _check_rows(identifier, recording, inspected=False):
    data = recording.joint_names, recording.q, recording.segments
    if recording.states is None and (noise := at_rest(*data)) is not None:
        raise ValueError(noise.message)
    if not inspected:
        check_rows_suffice(identifier, recording)
        for finding in disorder(*data):
            warnings.warn(finding.message, DoubtWarning, stacklevel=4)
    if recording.t is not None:
        check_time_stamps(recording.t, identifier.dt, recording.segments)
