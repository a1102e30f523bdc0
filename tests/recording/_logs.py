"""One recording in the file formats of several tools, with their documented names.

Sources of the names:

- bagpy (rosbag to CSV), ``message_by_topic`` and ``slotvalues``: arrays of numbers get
  a number after an underscore, the list of names stays one cell.
- PlotJuggler: series of a JointState are TOPIC/JOINT/position, velocity, effort
  (jointstates_msg.h of https://github.com/PlotJuggler/plotjuggler-ros-plugins), and
  its CSV exporter puts ``__time`` before them in alphabetical order
  (StatePublisherCSV of https://github.com/PlotJuggler/PlotJuggler).
- ``rostopic echo -p``: ``%time`` in nanoseconds, then ``field.`` before each name.
- ``ros2 topic echo --csv``: the values of a message without a header, in the order of
  the message (``message_to_csv`` in rosidl_runtime_py/convert.py).
- RTDE client library of Universal Robots, ``record.py``: blanks between the cells, and
  the number of the joint after an underscore (its rtde/csv_writer.py); timestamp [s]
  and actual_current [A] as in the RTDE guide of universal-robots.com.
- libfranka, ``logToCSV``: time in milliseconds, state.q[0], state.tau_J[0].
  https://github.com/frankaemika/libfranka/blob/main/src/log.cpp
"""

import csv

import numpy as np

# Torque constants of the current channels of a UR [N m/A].
GAINS = (12.5, 12.5, 12.5, 9.0, 9.0, 9.0)
# Start of the clocks that count from 1970 [s].
EPOCH = 1_700_000_000.25


def _write(path, header, rows, delimiter=","):
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, delimiter=delimiter, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
    return path


def _cells(values):
    return [f"{x:.9f}" for x in values]


def _numbered(pattern, n, first=0):
    return [pattern.format(k) for k in range(first, first + n)]


def _shuffled(recording):
    """Order in which a driver publishes the joints, unlike that of the model."""
    return np.argsort([name[::-1] for name in recording.joint_names])[::-1]


def ros_csv(recording, folder):
    """Write /joint_states as bagpy does."""
    order, n = _shuffled(recording), recording.nv
    header = ["Time", "header.seq", "header.stamp.secs", "header.stamp.nsecs"]
    header += ["header.frame_id", "name"]
    header += _numbered("position_{}", n) + _numbered("velocity_{}", n)
    header += _numbered("effort_{}", n)
    names = str([recording.joint_names[j] for j in order])
    rows = []
    for k, t in enumerate(recording.t + EPOCH):
        row = [f"{t + 2e-4:.9f}", k, int(t), round(t % 1 * 1e9), "", names]
        row += _cells(recording.q[k, order]) + n * ["0.0"]
        rows.append(row + _cells(recording.tau[k, order]))
    return _write(folder / "ros.csv", header, rows)


def plotjuggler(recording, folder):
    """Write an export of all series of /joint_states."""
    series = {"/joint_states/header/stamp": recording.t + EPOCH}
    for j, name in enumerate(recording.joint_names):
        series[f"/joint_states/{name}/position"] = recording.q[:, j]
        series[f"/joint_states/{name}/effort"] = recording.tau[:, j]
    series = dict(sorted(series.items()))
    header = ["__time", *series]
    table = zip(*series.values())
    rows = ([f"{t:.6f}", *_cells(row)] for t, row in zip(recording.t + EPOCH, table))
    return _write(folder / "plotjuggler.csv", header, rows)


def rostopic(recording, folder):
    """Write the output of ``rostopic echo -p /joint_states``."""
    order, n = _shuffled(recording), recording.nv
    header = ["%time", "field.header.seq", "field.header.stamp"]
    header += ["field.header.frame_id"]
    for pattern in ("field.name{}", "field.position{}", "field.velocity{}"):
        header += _numbered(pattern, n)
    header += _numbered("field.effort{}", n)
    names = [recording.joint_names[j] for j in order]
    rows = []
    for k, t in enumerate(recording.t):
        stamp = int(EPOCH) * 10**9 + round(t * 1e9)
        row = [stamp + 200_000, k, stamp, "", *names, *_cells(recording.q[k, order])]
        rows.append(row + n * ["0.0"] + _cells(recording.tau[k, order]))
    return _write(folder / "rostopic.csv", header, rows)


def ros2_echo(recording, folder):
    """Write the output of ``ros2 topic echo --csv /joint_states``."""
    order, n = _shuffled(recording), recording.nv
    names = [recording.joint_names[j] for j in order]
    rows = [
        [
            int(EPOCH) + int(t),
            round(t % 1 * 1e9),
            "base_link",
            *names,
            *_cells(recording.q[k, order]),
            *n * ["0.0"],
            *_cells(recording.tau[k, order]),
        ]
        for k, t in enumerate(recording.t)
    ]
    return _write(folder / "echo.csv", rows[0], rows[1:])


def rtde(recording, folder):
    """Write the output of ``record.py``, with currents."""
    n = recording.nv
    header = ["timestamp", *_numbered("target_q_{}", n), *_numbered("actual_q_{}", n)]
    header += _numbered("actual_current_{}", n)
    current = recording.tau / np.array(GAINS[:n])
    rows = (
        [f"{t:.6f}", *_cells(q), *_cells(q + 1e-3), *_cells(i)]
        for t, q, i in zip(recording.t + 512.0, recording.q - 1e-3, current)
    )
    return _write(folder / "rtde.csv", header, rows, " ")


def libfranka(recording, folder):
    """Write the output of ``logToCSV``."""
    n = recording.nv
    header = ["time", "success_rate"]
    for name in ("q", "q_d", "dq", "dq_d", "tau_J", "tau_ext_hat_filtered"):
        header += _numbered(f"state.{name}[{{}}]", n)
    header += _numbered("cmd.q_d[{}]", n) + _numbered("cmd.tau_J_d[{}]", n)
    header = [header[0], *(f" {name}" for name in header[1:])]
    zeros = n * ["0"]
    rows = []
    for k, t in enumerate(recording.t):
        q, tau = _cells(recording.q[k]), _cells(recording.tau[k])
        row = [round(1e3 * t) + 20_000, 1, *q, *q, *zeros, *zeros]
        rows.append([*row, *tau, *zeros, *q, *zeros])
    return _write(folder / "franka.csv", header, rows)


def plain(recording, folder):
    """Write names and units of this package."""
    n = recording.nv
    header = ["t", *_numbered("q{}", n, 1), *_numbered("tau{}", n, 1)]
    rows = (
        [f"{t:.6f}", *_cells(q), *_cells(tau)]
        for t, q, tau in zip(recording.t, recording.q, recording.tau)
    )
    return _write(folder / "plain.csv", header, rows)


KINDS = {
    "plain CSV": plain,
    "ROS joint_states as CSV (bagpy)": ros_csv,
    "PlotJuggler": plotjuggler,
    "rostopic echo -p": rostopic,
    "ros2 topic echo --csv": ros2_echo,
    "UR RTDE record": rtde,
    "libfranka log": libfranka,
}
