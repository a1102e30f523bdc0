"""Arguments of the reader, and the joints whose columns are looked for."""

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike

import numpy as np

from sklearn_vbjfa.recording._drives import Drive, parse_drive
from sklearn_vbjfa.recording._presets import PRESETS
from sklearn_vbjfa.recording._recording import check_dt
from sklearn_vbjfa.recording._table import RecordingRefused
from sklearn_vbjfa.recording._units import KINDS, TIME_UNITS

# Commands of joints, and further names that logs have for them. qd is in neither list:
# some mean a desired position, others a velocity.
COMMAND_NAMES = {
    "q_desired": ("q_des", "q_cmd", "q_target", "q_ref")
    + ("target_position", "goal_position", "position_command"),
    "v_desired": ("v_des", "dq_des", "dq_cmd", "target_velocity"),
    "tau_ff": ("tau_feedforward",),
    "kp": (),
    "kd": (),
    "supply": (),
}
# A channel of a mapping, with the number or the name of one joint.
_KEY = re.compile(
    rf"({'|'.join((*COMMAND_NAMES, *KINDS))})(\d+|[_.\[(].+)?|t|segment", re.IGNORECASE
)


@dataclass(frozen=True, kw_only=True)
class Robot:
    """The joints whose columns are looked for."""

    names: tuple[str, ...] = ()  # in the order of the columns
    chosen: bool = False  # True if the user, or the file, names them
    in_model: tuple[str, ...] = ()  # those of the description, in its order
    slides: tuple[bool, ...] = ()  # which of these are prismatic


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """The arguments of `read_recording`, see there; they are checked."""

    mapping: dict
    preset: str | None
    dt: float | None
    urdf: str | PathLike | None
    joint_names: tuple[str, ...]
    topic: str | None
    gains: tuple[float, ...] | str | None
    time_unit: str | None
    drive: Drive | None  # its channels stand in place of torques

    @functools.cached_property
    def _movable(self):
        if self.urdf is None:
            return ()
        from sklearn_vbjfa.model import movable_joints

        return movable_joints(self.urdf)

    @property
    def joints(self):
        """Joints of the robot as far as they are known, tuple of str."""
        return self.joint_names or self._movable

    def robot(self, table):
        """Return the robot of a file, which may name its joints."""
        names = self.joint_names
        if not names and "joint_names" in table.scalars:
            names = _distinct(np.atleast_1d(table.scalars["joint_names"]))
        if self.urdf is None:
            return Robot(names=names, chosen=bool(names))
        from sklearn_vbjfa import model as models

        robot = models.load_reduced if names else models.load_model
        model = robot(self.urdf, *[names] * bool(names))
        in_model = models.joint_names(model)
        # Columns with numbers are in the order of the file, which may name what a joint
        # carries before the joint.
        in_file = tuple(name for name in self._movable if name in in_model)
        return Robot(
            names=names or in_file,
            chosen=bool(names),
            in_model=in_model,
            slides=models.is_prismatic(model),
        )

    @property
    def recorded(self):
        """Channels of torques or of the drive, the one that must be there first."""
        drive = self.drive
        if drive is None:
            return ("tau",)
        return ("tau" if drive.spelled else drive.told, *drive.beside)

    @property
    def kinds(self):
        """All kinds of channels, in order; the first two must be there."""
        return "q", *self.recorded, "v", "a"


def checked(columns, preset, dt, joint_names, gains, time_unit, drive, **others):
    """Return the options of arguments as users give them."""
    if dt is not None:
        check_dt(dt)
    for name, value, known in (
        ("time_unit", time_unit, TIME_UNITS),
        ("preset", preset, PRESETS),
    ):
        if value is not None and value not in known:
            raise ValueError(
                f"{name} must be one of {', '.join(known)}; got {value!r}."
            )
    if preset is not None and columns:
        raise RecordingRefused(
            "give columns or a preset, not both: a preset is a mapping.",
            {"preset": None},
        )
    if drive is not None and gains is not None:
        raise RecordingRefused(
            "gains are factors of columns of torques, and a drive has its own: leave "
            "gains out (command line: --gain), or the drive.",
            {"gains": None},
        )
    return ReadOptions(
        mapping={} if columns is None else parse_mapping(columns),
        preset=preset,
        dt=dt,
        joint_names=_distinct(joint_names),
        gains=_checked_gains(gains),
        time_unit=time_unit,
        drive=parse_drive(drive) if isinstance(drive, str) else drive,
        **others,
    )


def _distinct(joint_names):
    """Return joint names as a tuple of str, empty for None."""
    if isinstance(joint_names, str):
        raise ValueError(
            f"joint_names must be several names, one per column, got {joint_names!r}."
        )
    names = tuple(str(x) for x in (() if joint_names is None else joint_names))
    if len(set(names)) < len(names):
        raise ValueError(f"joint_names must differ from one another, got {names}.")
    return names


def _checked_gains(gains):
    """Return gains as a tuple of float, "unknown" or None."""
    if gains is None or (isinstance(gains, str) and gains == "unknown"):
        return gains
    try:
        found = tuple(float(x) for x in np.atleast_1d(gains))
    except (TypeError, ValueError):
        found = (0.0,)
    if isinstance(gains, str) or not all(np.isfinite(x) and x != 0 for x in found):
        raise ValueError(
            f"gains must be a factor for each joint, finite and not 0, or 'unknown'; "
            f"got {gains!r}."
        )
    return found


def parse_mapping(text) -> dict[str, str]:
    """Return patterns by names of channels, out of "q=actual_q_{i},t=timestamp"."""
    if isinstance(text, Mapping):
        pairs = [(str(key), str(value)) for key, value in text.items()]
    else:
        parts = [part.partition("=") for part in str(text).split(",")]
        pairs = [(key.strip(), value.strip()) for key, _, value in parts]
    found: dict[str, str] = {}
    for key, value in pairs:
        if not value or key in found or _KEY.fullmatch(key) is None:
            wrong = f"{key}={value}"
            break
        found[key] = value
    else:
        wrong = "" if found else "nothing"
    if wrong:
        raise ValueError(
            f"columns has {wrong!r}; expected CHANNEL=NAME, each channel once, with "
            'commas between them, such as "q=position_{i},tau=effort_{i},t=time". '
            "Channels are q, tau, v, a, t, segment (of one joint: q1, tau_elbow), with "
            f"a drive also {', '.join(COMMAND_NAMES)}; {{i}} stands for the joint's "
            "number and {joint} for its name."
        )
    return found


def split_key(key):
    """Return the kind of a key of a mapping, and the number or joint in it."""
    match = _KEY.fullmatch(key)
    kind = (match[1] or key).lower()
    suffix = key[len(kind) :].strip("_.[]()")
    return kind, int(suffix) if suffix.isdecimal() else suffix
