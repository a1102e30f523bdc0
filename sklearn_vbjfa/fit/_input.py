"""The recording that an identifier is fitted to, from arrays or as it was read."""

from dataclasses import replace

import numpy as np
from sklearn.utils.validation import validate_data

from sklearn_vbjfa.equations._recording_checks import (
    check_motion,
    check_weight,
    check_widths,
    warn_of_disorder,
)
from sklearn_vbjfa.recording import (
    OfferedSignals,
    check_time_stamps,
    check_useful,
    columns_beside,
    contiguous_groups,
    positions_in_order,
    signals_for,
    torques_in_order,
)
from sklearn_vbjfa.robot._robot import recording_of


def recording_of_arguments(identifier, X, y, groups, sample_weight, t, signals):
    """Make a `Recording` of the arguments of a fit, rejecting invalid ones."""
    columns = columns_beside(X, identifier.joint_names_)
    X, y = validate_data(
        identifier,
        positions_in_order(X, identifier.joint_names_),
        torques_in_order(y, identifier.joint_names_),
        dtype=np.float64,
        multi_output=True,
        y_numeric=True,
    )
    y = np.asarray(y, dtype=float).reshape(X.shape[0], -1)
    check_widths(identifier.joint_names_, X, y)
    _check_rows(identifier, X, groups, t, contiguous_groups(groups, X.shape[0]))
    channels = {}
    if identifier.drive is not None:
        channels, signals = identifier.drive.taken(y, signals)
    used = signals_for(identifier.effects_, signals, columns, X.shape[0])
    recording = recording_of(
        identifier.joint_names_,
        identifier.dt,
        X,
        y,
        groups=groups,
        weight=check_weight(sample_weight, y.shape),
        t=t,
        signals=used,
    )
    check_useful(signals, recording)
    if identifier.drive is None:
        return recording
    recording = identifier.drive.driven(replace(recording, signals=channels))
    return replace(recording, signals=used)


def checked_recording(identifier, recording):
    """Return a recording with the signals that are needed, rejecting others."""
    names, X = identifier.joint_names_, recording.inputs
    if recording.joint_names != names or recording.dt != identifier.dt:
        raise ValueError(
            f"recording must have the joints of the robot ({', '.join(names)}) in "
            f"their order and its sample period dt={identifier.dt} s; got "
            f"{', '.join(recording.joint_names)} and {recording.dt} s."
        )
    validate_data(identifier, X, skip_check_array=True)
    _check_rows(identifier, X, recording.groups, recording.t, recording.segments)
    offered = OfferedSignals(columns=recording.signals)
    used = signals_for(identifier.effects_, None, offered, recording.n_samples)
    weight = recording.weight
    if weight is not None and used.keys() == recording.signals.keys():
        return recording
    weight = check_weight(weight, recording.tau.shape)
    return replace(recording, signals=used, weight=weight)


def _check_rows(identifier, X, groups, t, parts):
    nv = identifier.features_.n_joints_
    if X.shape[1] == nv:
        check_motion(identifier.joint_names_, X, parts)
    warn_of_disorder(identifier.joint_names_, X[:, :nv], parts, groups)
    check_time_stamps(t, identifier.dt, parts)
