"""Requirements on recordings and settings; each error says how to meet them."""

import warnings

import numpy as np

from sklearn_vbjfa.inspection import finding
from sklearn_vbjfa.model import DoubtWarning
from sklearn_vbjfa.recording import Drive, listed

# Sample period [s] too long for any robot; sample period too long if the fastest joint
# is slower than this speed [rad/s or m/s], as with a time that is not in seconds.
_SLOWEST_PERIOD, _SLOW_PERIOD, _SLOW_SPEED = 1.0, 0.05, 0.02
# Largest ratio of a speed to the robot's limit (degrees instead of radians give 57 and
# are reported elsewhere); the limit if there is none, or a larger one [rad/s or m/s].
_TOO_FAST, _LARGEST_SPEED, _NO_LIMIT = 300.0, 100.0, 1e4


def check_widths(names, X, y=None):
    nv = len(names)
    robot = f"The robot has {nv} joint(s) ({', '.join(names)}), so "
    if X.shape[1] not in {nv, 3 * nv}:
        raise ValueError(
            f"{robot}X must have {nv} columns of positions or {3 * nv} of states "
            f"[q | v | a]; got {X.shape[1]}. Leave out channels of locked joints, or "
            "lock joints that were not recorded with pinocchio.buildReducedModel."
        )
    if y is not None and y.shape[1] != nv:
        raise ValueError(
            f"{robot}y must have {nv} column(s) of torques; got {y.shape[1]}."
        )


def check_speed(dt, fast, model):
    """Reject a sample period dt [s] at which the robot could not move as recorded."""
    # A period in ms or Hz changes the speeds by a factor of a thousand. fast (nv,):
    # 99.5th percentiles of the speeds [rad/s or m/s]; model: for velocity limits.
    top = float(np.max(fast, initial=0.0))
    if dt is None or not top > 0:
        return
    limit = np.asarray(model.velocityLimit, dtype=float)
    limit = np.where((limit > 0) & (limit < _NO_LIMIT), limit, _LARGEST_SPEED)
    if dt >= _SLOWEST_PERIOD or (dt >= _SLOW_PERIOD and top < _SLOW_SPEED):
        raise ValueError(
            f"dt={dt:.6g} s is too slow for a motion: the fastest joint would move at "
            f"{top:.2g} rad/s or m/s. dt is in seconds."
        )
    if float(np.max(fast / limit)) > _TOO_FAST:
        raise ValueError(
            f"dt={dt:.6g} s is too short for this motion: the fastest joint would "
            f"move at {top:.2g} rad/s or m/s, far more than the robot allows. Give "
            "times in seconds (not minutes)."
        )


def check_input_noise(input_noise):
    if input_noise not in ("auto", None):
        raise ValueError(
            "input_noise must be 'auto' (measured from the recording) or None "
            f"(taken as zero); got {input_noise!r}."
        )


def check_channels(names, positions, torques):
    """Reject torques without information, warn of joints that do not move."""
    # positions, torques (n, nv): at least their lowest and highest values.
    moves = np.ptp(positions, axis=0) > 0
    if not moves.any():
        raise ValueError(
            "No joint moves in this recording; expected a motion that excites the "
            "joints to be identified. Check the position columns."
        )
    flat = ~(np.ptp(torques, axis=0) > 0)
    dead = [name for name, bad in zip(names, flat & moves) if bad]
    if dead:
        raise ValueError(
            f"The torque of {', '.join(dead)} is constant: nothing was measured, or a "
            "brake held. Check the recording, or leave the joint out (joint_names)."
        )
    for j in np.flatnonzero(~moves):
        # Same message as in `inspect_channels`, so that it is shown once.
        facts = {"range": 0.0, "mean": positions[0, j]}
        still = finding("still_joint", names, j, "warning", **facts)
        warnings.warn(still.message, DoubtWarning, stacklevel=5)


def check_length(parts, lowpass, cutoff, names):
    """Reject recordings all shorter than the filter; warn of some if named."""
    need = 2 * lowpass.half + 1
    short = [p for p in parts if p.stop - p.start < need]
    if len(short) == len(parts):
        longest = max(p.stop - p.start for p in parts)
        raise ValueError(
            f"The low-pass at {cutoff:.4g} Hz is {need} samples long and the longest "
            f"stretch to be fitted has {longest}; give a longer recording or a higher "
            "cutoff (None for no low-pass)."
        )
    left_out = [name for name, p in zip(names, parts) if p in short]
    if left_out:
        warnings.warn(
            f"{len(short)} of {len(parts)} recordings ({listed(left_out)}) are "
            f"shorter than the low-pass filter ({need} samples) and are left out.",
            DoubtWarning,
            stacklevel=5,
        )


def check_count(moments, standstill, n_parameters):
    """Reject a fit with all samples masked or fewer equations than parameters."""
    if moments is None or not moments.n.any():
        raise ValueError(
            "Every sample is masked as standstill; lower `standstill` (now "
            f"{np.array2string(standstill, precision=3)}) or pass None."
        )
    count = int(moments.n_rows.sum())
    if count < n_parameters:
        raise ValueError(
            f"{count} equations (joints times filtered, moving samples) are fewer "
            f"than the {n_parameters} parameters; record for longer, or raise "
            "`cutoff`."
        )


def check_weight(sample_weight, shape):
    """Return validated weights for torques of this shape (n, nv); ones for None."""
    if sample_weight is None:
        # Allocated weights would take as much memory as the torques.
        return np.broadcast_to(1.0, shape)
    weight = np.asarray(sample_weight, dtype=float)
    if weight.shape not in {shape, shape[:1]}:
        raise ValueError(
            f"sample_weight must have the shape {shape[:1]} or {shape}; got "
            f"{weight.shape}."
        )
    if not np.isfinite(weight).all() or weight.min() < 0:
        raise ValueError("sample_weight must be finite and not negative.")
    if not weight.any():
        raise ValueError("Sample weights must contain at least one non-zero number.")
    return weight if weight.ndim == 2 else np.repeat(weight[:, None], shape[1], 1)


def check_drive(identifier):
    drive = identifier.drive
    if drive is None:
        return
    if not isinstance(drive, Drive):
        raise ValueError(
            "drive must be a PDDrive, CurrentDrive, VoltageDrive or None; got "
            f"{drive!r}. Torques need no drive."
        )
    if identifier.gains is not None and drive.gains is None:
        raise ValueError(
            "drive has gains, and cannot be combined with gains: leave gains=None."
        )
