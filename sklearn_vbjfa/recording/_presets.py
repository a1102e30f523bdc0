"""Names of columns that tools for robots give to the channels that they log."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class KnownLog:
    """Names of the channels in one kind of log."""

    what: str  # the log, in words
    source: str  # where its names come from
    # patterns of positions and torques; ``*`` is anything, the same in all
    q: str
    tau: str
    v: str = ""
    # patterns of commands, by the names of the channels of a drive; they may have
    # another prefix
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
