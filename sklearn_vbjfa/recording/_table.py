"""A file's content as a data frame, names and units of its columns, and refusals."""

import contextlib
import difflib
import itertools
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas

# Bytes that a file may hold when unpacked: some hours of a robot at 1 kHz.
LARGEST = 1 << 30
# Entries of a list, and characters of a name or cell, that messages quote at most.
_ENTRIES, _CHARACTERS = 20, 60


class Loss(str):
    """A note on a part of a recording, or of its robot, that is left out."""

    __slots__ = ()


class RecordingRefused(ValueError):
    """A file that is not read, maybe with other options that read it.

    Attributes
    ----------
    reason : str
        Why the file is refused, without the options.
    options : dict of str to str, tuple or None
        The options, by the names of `read_recording`; None for one to leave out. Empty
        if none would do.
    """

    def __init__(self, reason, options=None):
        self.reason = reason.removesuffix(".")
        self.options = dict(options or {})
        offers = [f"{key}={value!r}" for key, value in self.options.items()]
        offer = f"; try {', '.join(offers)}" if offers else ""
        super().__init__(f"{self.reason}{offer}.")


class NotATable(RecordingRefused):
    """A file that holds no table of numbers at all, such as a text to be read."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """Named columns of equal length, numbers or text, out of a file.

    The index of the frame has the number by which messages call each row.
    """

    path: Path  # as messages name it
    frame: "pandas.DataFrame"
    place: str = "row {}"  # a row in messages
    # single values, and arrays of another length
    scalars: Mapping[str, np.ndarray] = field(default_factory=dict)
    # joints whose columns are called q_<joint> and tau_<joint> for certain
    joints: tuple[str, ...] = ()
    nameless: bool = False  # columns are called by their places, from "1" on
    notes: tuple[str, ...] = ()

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return len(self.frame)

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return list(self.frame)

    def values(self, name) -> np.ndarray:
        """Return a column: numbers, dates, or text as objects."""
        return self.frame[name].to_numpy()

    def numbers(self, name) -> np.ndarray:
        """Return a column as finite floats; an error names the wrong cell."""
        values = self.values(name)
        if values.dtype.kind not in "biuf":
            raise ValueError(
                f"{self.path}: column {name!r} holds {quoted(str(values[0]))} and not "
                "numbers; correct or rename it."
            )
        with np.errstate(over="ignore"):
            values = values.astype(float)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise ValueError(
                f"{self.path}: {values[bad[0]]} or nothing in {self.where(bad[0])}, "
                f"column {name!r} ({bad.size} such cells in it); interpolate them or "
                "remove those rows."
            )
        return values

    def where(self, row) -> str:
        """Name a row in words."""
        return self.place.format(self.frame.index[row])

    def take(self, rows) -> "Table":
        """Return the table of some rows."""
        return replace(self, frame=self.frame.iloc[rows])


@dataclass(frozen=True)
class Source:
    """A file to read, and the name under which the user knows it."""

    file: Path
    shown: Path

    def __str__(self):
        return str(self.shown)


# -- files that are damaged, too large or empty, packages that are missing -------------


@contextlib.contextmanager
def parsing(path, what, remedy):
    """Turn whatever a parser raises on a damaged file into one refusal."""
    try:
        yield
    except (RecordingRefused, ImportError):
        raise
    except MemoryError as error:
        raise RecordingRefused(
            f"{path}: is too large to be read at once, or damaged; save a shorter "
            "recording, or this one again."
        ) from error
    except Exception as error:
        # rosbags quotes what an error held as a tuple.
        reason = re.sub(r"\(['\"](.*?)['\"],\)", r"\1", " ".join(str(error).split()))
        reason = reason.rstrip(".")[:200] or type(error).__name__
        raise ValueError(
            f"{path}: is not a complete {what} ({reason}); {remedy}"
        ) from error


def check_size(path, size, remedy="save a shorter recording", what="unpacked"):
    """Refuse what is packed small and fills the memory."""
    if size > LARGEST:
        raise RecordingRefused(
            f"{path}: has {size / (1 << 30):.1f} GiB {what}, too large to be read at "
            f"once; {remedy}."
        )


def no_rows(path):
    """Return the refusal of a file without data."""
    return ValueError(f"{path}: no rows of data; expected one row per sample.")


def check_names(path, names, what):
    """Refuse a name that comes twice."""
    ((first, count),) = Counter(names).most_common(1)
    if count > 1:
        raise ValueError(
            f"{path}: {what} column {quoted(first)} twice; each column needs its own "
            "name."
        )


def pandas_of(path):
    """Return the module pandas, or say how to install it."""
    try:
        import pandas
    except ImportError as error:
        raise missing(path, "pandas", "reading files needs", "robot") from error
    return pandas


def missing(path, package, needs, extra):
    """Return the error of a package that is not installed."""
    return ImportError(
        f'{path}: {needs} {package}: pip install "sklearn-vbjfa[{extra}]"'
    )


# -- what a file holds, quoted ---------------------------------------------------------


def quoted(value):
    """Write a value as Python does; of a long one the beginning."""
    is_text = isinstance(value, str)
    text = value if is_text else repr(value)
    left = len(text) - _CHARACTERS
    shown = repr(text[:_CHARACTERS]) if is_text else text[:_CHARACTERS]
    return f"{shown} and {left} characters more" if left > 0 else shown


def listed(names):
    """List names with commas; of many the first."""
    names = [str(name) for name in names]
    names = [name if len(name) <= _CHARACTERS else quoted(name) for name in names]
    if len(names) > _ENTRIES:
        names[_ENTRIES - 1 :] = [f"and {len(names) - _ENTRIES + 1} more"]
    return ", ".join(names)


# Channels of joints, and which of them a command has the unit of.
KINDS = ("q", "tau", "v", "a")
MEASURED = {"q_desired": "q", "v_desired": "v", "tau_ff": "tau"}
# What one may write for a time, where a unit is asked for, in seconds.
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
# Periods of robots that move [s].
_FASTEST, _SLOWEST = 2e-5, 1.0
_DEGREE, _TURN = np.pi / 180, 2 * np.pi


@dataclass(frozen=True)
class Unit:
    """A unit: its base and its size in it."""

    base: str
    factor: float


def _sizes(text):
    """Return sizes by spelling, out of "a b=1 c=2"; those without follow the next."""
    found, waiting = {}, []
    for word in text.split():
        name, _, size = word.partition("=")
        waiting.append(name)
        if size:
            found |= dict.fromkeys(waiting, float(size))
            waiting = []
    return found


_ANGLE = _sizes("rad radian radians=1 mrad=1e-3")
_ANGLE |= dict.fromkeys(("deg", "degs", "degree", "degrees", "°"), _DEGREE)
_ANGLE |= dict.fromkeys(("rev", "revs", "turn", "turns", "revolutions"), _TURN)
_LENGTH = _sizes("m metre metres meter meters=1 cm=1e-2 mm=1e-3 um µm μm=1e-6")


def _derived(endings, **more):
    """Return units of derivatives of positions, by their base."""
    return {
        base: {f"{unit}{end}": x for unit, x in own.items() for end in endings}
        | more.get(base, {})
        for base, own in (("rad", _ANGLE), ("m", _LENGTH))
    }


_BY_BASE = {
    "q": {"rad": _ANGLE, "m": _LENGTH},
    "v": _derived(("/s", "/sec", "ps"), rad={"rpm": _TURN / 60, "1/min": _TURN / 60}),
    "a": _derived(("/s^2", "/s2", "/s²", "/s/s", "ps2")),
    "tau": {
        "N m": _sizes("Nm newtonmeter newtonmetre=1 Ncm=1e-2 mNm=1e-3 kNm=1e3")
        | _sizes("kgfcm kgcm=0.0980665 lbfin=0.1129848290276167"),
        "N": _sizes("N=1 mN=1e-3 kN=1e3"),
        "A": _sizes("A amp amps ampere amperes Arms=1 mA=1e-3"),
        "V": _sizes("V volt volts=1 mV=1e-3"),
        "count": _sizes("count counts=1"),
        "%": _sizes("% percent=1 ‰ permille=0.1"),
    },
    "t": {
        "s": _sizes("s sec secs second seconds=1 ms msec millisecond milliseconds=1e-3")
        | _sizes("us µs μs usec microseconds=1e-6 min minutes=60")
        | _sizes("ns nsec nanosecond nanoseconds=1e-9")
    },
}
_UNITS = {
    kind: {
        spelling: Unit(base, size)
        for base, sizes in bases.items()
        for spelling, size in sizes.items()
    }
    for kind, bases in _BY_BASE.items()
}
# What refusals expect.
EXPECTED = {
    "q": "rad, deg, m or mm",
    "v": "rad/s, deg/s, m/s or mm/s",
    "a": "rad/s^2, deg/s^2 or m/s^2",
    "tau": "Nm, N, A, V or %",
    "t": "s, ms, us or ns",
}
_IN_BRACKETS = re.compile(r"(.*?)\s*(?:\[([^][]*)\]|\(([^()]*)\)|\s/\s*(\S+))")
_LAST_PART = re.compile(r"(.*?)[_ .]([A-Za-z°µμ%][A-Za-z0-9^/²]*)")


def unit_of(kind: str, text: str) -> Unit | None:
    """Return the unit of a channel of a kind (q, v, a, tau, t), None if unknown."""
    plain = re.sub(r"[\s*·.⋅]|(?<=N)-(?=m)", "", text.strip())
    known = _UNITS.get(MEASURED.get(kind, kind), {})
    if plain in known:
        return known[plain]
    # Capitals matter for milli and mega, ampere and atto; words may have any.
    if len(plain) > 2 and plain.lower() in known:
        return known[plain.lower()]
    return known["Nm"] if kind == "tau" and plain.lower() == "nm" else None


def split_unit(name: str) -> tuple[str, str]:
    """Return a name without the unit in brackets at its end, and that unit."""
    match = _IN_BRACKETS.fullmatch(name)
    if match is None:
        return name, ""
    unit = next(x for x in match.groups()[1:] if x is not None).strip()
    # Of q[1] and pos(elbow) these are the joints.
    if not match[1] or unit.isdecimal() or "{" in unit:
        return name, ""
    return match[1], unit


def split_last_part(name: str, kind: str) -> tuple[str, str]:
    """Return a name without a last part that is a unit of a kind, and that unit."""
    match = _LAST_PART.fullmatch(name)
    if match is None or unit_of(kind, match[2]) is None:
        return name, ""
    return match[1], match[2]


# -- units of time ---------------------------------------------------------------------


def usual_step(t):
    """Return the middle one of the steps by which a clock rises, 0 without any."""
    # Of rows that are out of order as if they were sorted.
    step = np.diff(np.sort(t))
    step = step[step > 0]
    return float(np.median(step)) if step.size else 0.0


def unit_of_steps(step):
    """Return the unit of time in which steps are those of a robot, "" for none."""
    known = (unit for unit, size in TIME_UNITS.items() if is_of_a_robot(step * size))
    return next(known, "")


def is_of_a_robot(period):
    """Whether a period [s] is one of a robot that moves."""
    return _FASTEST < period < _SLOWEST


# -- words -----------------------------------------------------------------------------

# Words and the kinds of channels that they mean.
_WORDS = {
    "t": "t ts time timestamp stamp clock",
    "q": "q pos position angle theta encoder",
    "v": "v dq qd qdot vel velocity velocities speed",
    "a": "ddq qdd qddot acc accel acceleration",
    "torque": "tau torque trq effort eff moment force load",
    "current": "current curr cur amp ampere i",
    "command": "target cmd command desired des ref reference goal setpoint sp action",
    "other": "error temperature temp voltage external ext limit cartesian tcp enable "
    "mode window model friction fric gravity grav control con feedforward ff",
}
_KIND_OF = {word: kind for kind, words in _WORDS.items() for word in words.split()}
# The least similarity of a word to one of these.
_SIMILAR = 0.85


def kinds_in(name):
    """Return the kinds that the words of a name mean, also misspelled, a set of str."""
    text = re.sub(r"\{\w+\}", " ", split_unit(name)[0])
    text = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text)
    words = [x.lower() for x in re.findall(r"[^\W\d_]+", text)]
    near = [difflib.get_close_matches(x, _KIND_OF, 1, _SIMILAR) for x in words]
    return {_KIND_OF[word] for (word,) in filter(None, near)}


def is_current(name):
    """Return whether a name says that it is a motor's current, and no torque."""
    kinds = kinds_in(name)
    return "current" in kinds and "torque" not in kinds


@dataclass(frozen=True, kw_only=True)
class KnownLog:
    """Names of the channels in one kind of log."""

    what: str  # the log, in words
    source: str  # where its names come from
    # patterns of positions and torques; ``*`` is anything
    q: str
    tau: str
    v: str = ""
    # patterns of commands, by the names of the channels of a drive
    commands: Mapping[str, str] = field(default_factory=dict)
    # columns, the best first; two with a plus between are seconds and nanoseconds
    # with the unit in brackets where it is not seconds
    times: tuple[str, ...]
    # unit of what is proportional to torques; "" where they are in N m or N
    motor_unit: str = ""
    # regular expression of columns with joints' names; its group is a number, empty
    # for a column with all of them
    joints: str = ""
    # parts of the names of joints, in the order in which motors are numbered
    motors: tuple[str, ...] = ()
    segment: str = ""  # column that tells recordings apart
    # regular expressions of columns that are no conditions of the robot: counters,
    # references, commands, frames, what follows from the rest
    no_signals: tuple[str, ...] = ()


_PLOTJUGGLER = (
    "series of plugins/ros2_parsers/jointstates_msg.h of github.com/PlotJuggler/"
    "plotjuggler-ros-plugins, in a file of plotjuggler_plugins/StatePublisherCSV/"
    "publisher_csv.cpp of github.com/facontidavide/PlotJuggler"
)
_ROSTOPIC = (
    "_str_plot_fields in tools/rostopic/src/rostopic/__init__.py of github.com/ros/"
    "ros_comm; wiki.ros.org/rostopic"
)
_RTDE = (
    "outputs of the RTDE guide of universal-robots.com; numbers as in "
    "rtde/csv_writer.py of github.com/UniversalRobots/RTDE_Python_Client_Library"
)
_RTDE_OTHERS = (
    r"(target|actual|output|input|standard|tool|ft|runtime|joint|safety|robot|speed|"
    r"safety|script|elbow|payload|wrench|collision)_.*",
)
_LIBFRANKA = "logToCSV, src/log.cpp of github.com/frankaemika/libfranka"

# How Unitree numbers the motors of its quadrupeds: by legs, front and rear, right and
# left.
_QUADRUPED = tuple(
    f"{leg}_{joint}"
    for leg in ("FR", "FL", "RR", "RL")
    for joint in ("hip", "thigh", "calf")
)


def _unitree():
    """Yield patterns of motors' states and commands, and names of what differs."""
    names = (
        ("motor_state", "tau_est", "motor_cmd", "kp", "kd"),
        ("motorState", "tauEst", "motorCmd", "Kp", "Kd"),
    )
    # As JSON and C++ write it, PlotJuggler, tables of pandas, and matrices of all
    # motors.
    places = ("[{i}].{}", "[{i}]/{}", ".{i}.{}", "_{i}.{}", "_{i}_{}", ".{}{i}")
    for (state, tau, command, kp, kd), place in itertools.product(names, places):
        place = place.replace("{i}", "{{i}}")
        yield f"*{state}{place}", tau, f"*{command}{place}", kp, kd


_STAMPS = (
    "header.stamp.secs+header.stamp.nsecs",
    "header.stamp.sec+header.stamp.nanosec",
)
# sensor_msgs/JointState has positions in rad or m and efforts in N m or N
# (docs.ros.org, message definition). By the pattern of its fields: what writes them,
# where this comes from, and columns of time, the best first.
_JOINT_STATES = {
    "field.{}{{i}}": (
        ", written by rostopic echo -p",
        f"{_ROSTOPIC}; github.com/jmscslgroup/catvehicle/issues/9",
        ("field.header.stamp [ns]", "%time [ns]"),
    ),
    "{}_{{i}}": (
        " as a table",
        "bagpy/bagreader.py of github.com/jmscslgroup/bagpy; message_to_csv in "
        "rosidl_runtime_py/convert.py of github.com/ros2/rosidl_runtime_py, values "
        "without a header, in the order of the message",
        (*_STAMPS, "Time"),
    ),
    "{}{{i}}": (
        " as JSON",
        "sensor_msgs/msg/JointState.msg of github.com/ros2/common_interfaces, its "
        "fields as rosidl_runtime_py/convert.py writes them",
        _STAMPS,
    ),
    "*/{{joint}}/{}": (
        ", exported from PlotJuggler",
        _PLOTJUGGLER,
        ("*/header/stamp", "__time"),
    ),
    "*{}[{{i}}]": (" without names", _PLOTJUGGLER, ("*header/stamp", "__time")),
}

PRESETS: dict[str, tuple[KnownLog, ...]] = {
    "ros": tuple(
        KnownLog(
            what=f"/joint_states{what}",
            source=source,
            q=pattern.format("position"),
            v=pattern.format("velocity"),
            tau=pattern.format("effort"),
            times=times,
            joints=r"(?:field\.)?name_?(\d*)",
            no_signals=(r"%?time|Time|__time", r"(.*[./])?(header|name)([./_\d].*)?"),
        )
        for pattern, (what, source, times) in _JOINT_STATES.items()
    ),
    "ur": (
        KnownLog(
            what="RTDE of a Universal Robots controller, its torques",
            source=f"{_RTDE}; actual_current_as_torque since PolyScope 5.23",
            q="actual_q_{i}",
            v="actual_qd_{i}",
            tau="actual_current_as_torque_{i}",
            times=("timestamp",),
            no_signals=_RTDE_OTHERS,
        ),
        KnownLog(
            what="RTDE of a Universal Robots controller, its motor currents",
            source=_RTDE,
            q="actual_q_{i}",
            v="actual_qd_{i}",
            tau="actual_current_{i}",
            times=("timestamp",),
            motor_unit="A",
            no_signals=_RTDE_OTHERS,
        ),
    ),
    "franka": (
        KnownLog(
            what="the log of libfranka",
            source=_LIBFRANKA,
            q="state.q[{i}]",
            v="state.dq[{i}]",
            tau="state.tau_J[{i}]",
            times=("time [ms]",),
            no_signals=(r"success_rate", r"(state|cmd)\..*"),
        ),
        KnownLog(
            what="franka_states, written by rostopic echo -p",
            source="franka_msgs/msg/FrankaState.msg of github.com/frankaemika/"
            f"franka_ros; {_ROSTOPIC}",
            q="field.q{i}",
            v="field.dq{i}",
            tau="field.tau_J{i}",
            times=("field.header.stamp [ns]", "%time [ns]"),
            no_signals=(r"%time", r"field\..*"),
        ),
    ),
    "lerobot": tuple(
        KnownLog(
            what="a LeRobot data set",
            # The library names no channel of torque by itself; these three
            # are what it made of the ALOHA recordings.
            source="lerobot/common/datasets/push_dataset_to_hub/aloha_hdf5_format.py "
            "of github.com/huggingface/lerobot, commit 01942cb; names of the motors in "
            "meta/info.json, huggingface.co/docs/lerobot",
            q=f"observation.state.{key}",
            v=f"observation.velocity.{key}",
            tau=f"observation.effort.{key}",
            commands={"q_desired": f"action.{key}"},
            times=("timestamp",),
            segment="episode_index",
            no_signals=(
                r"(frame_|task_)?index",
                r"next\..*",
                r"action.*",
                r"observation\..*",
            ),
        )
        for key in ("{joint}", "{i}")
    ),
    "unitree": tuple(
        KnownLog(
            what="motor states and commands of a Unitree robot",
            source="MotorState and MotorCmd of unitree_go/msg and unitree_hg/msg in "
            "github.com/unitreerobotics/unitree_ros2, with capitals those of "
            "unitree_legged_msgs in github.com/unitreerobotics/unitree_ros; numbers of "
            "the motors in unitree_legged_const.h of unitree_sdk2",
            q=state.format("q"),
            v=state.format("dq"),
            tau=state.format(tau),
            commands={
                "q_desired": command.format("q"),
                "v_desired": command.format("dq"),
                "tau_ff": command.format("tau"),
                "kp": command.format(kp),
                "kd": command.format(kd),
            },
            times=("t", "time", "timestamp", "__time", "*tick [ms]"),
            motors=_QUADRUPED,
            no_signals=(r".*motor_?([sS]tate|[cC]md).*", r".*tick", r".*crc"),
        )
        for state, tau, command, kp, kd in _unitree()
    ),
}
