"""Logs of one simulated arm, each with one fault."""

import pickle
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass
class Arm:
    """Motion of the arm, its torques, and where files are written."""

    folder: Path
    urdf: Path
    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray

    @property
    def nv(self):
        return self.q.shape[1]

    @property
    def dt(self):
        return self.t[1] - self.t[0]


def column_names(nv, names=None):
    names = names or range(1, nv + 1)
    return ["t", *(f"q{k}" for k in names), *(f"tau{k}" for k in names)]


def csv_text(header, *columns, sep=","):
    rows = np.column_stack(columns)
    lines = [sep.join(header), *(sep.join(f"{x:.8g}" for x in row) for row in rows)]
    return "\n".join(lines) + "\n"


# Each returns the changed columns; joints are counted from one.


def scaled_torque(arm, factor, joint=None):
    factors = np.ones(arm.nv)
    factors[slice(None) if joint is None else joint - 1] = factor
    return {"tau": arm.tau * factors}


def swapped(arm, channel, joints):
    values = getattr(arm, channel).copy()
    one, other = (j - 1 for j in joints)
    values[:, [one, other]] = values[:, [other, one]]
    return {channel: values}


def rows(arm, stop=None, step=1):
    return {name: getattr(arm, name)[:stop:step] for name in ("t", "q", "tau")}


def jittery(arm):
    steps = arm.dt * np.random.default_rng(1).lognormal(0, 1, len(arm.t))
    return {"t": np.cumsum(steps)}


def end_stop(arm, joint):
    """Stop a joint at the end of its range; the end stop exerts a torque."""
    k, q, tau = joint - 1, arm.q.copy(), arm.tau.copy()
    end = np.quantile(q[:, k], 0.85)
    beyond = np.maximum(q[:, k] - end, 0)
    q[:, k] -= beyond
    tau[:, k] += 400 * beyond
    return {"q": q, "tau": tau}


def disconnected(arm, joint, noise):
    tau = arm.tau.copy()
    tau[:, joint - 1] = noise * np.random.default_rng(1).normal(size=len(tau))
    return {"tau": tau}


def filtered(arm, hertz):
    from scipy.signal import lfilter

    decay = np.exp(-2 * np.pi * hertz * arm.dt)
    start = decay * arm.tau[:1]
    return {"tau": lfilter([1 - decay], [1, -decay], arm.tau, axis=0, zi=start)[0]}


def warming(arm, joint):
    tau = arm.tau.copy()
    tau[:, joint - 1] += 6 * (1 - np.exp(-arm.t / 8))
    return {"tau": tau}


# Each writes a file and returns its path, or the paths of the log and of the robot.


def renamed(arm, header):
    header = header or column_names(arm.nv)
    return write(arm, "log.csv", csv_text(header, arm.t, arm.q, arm.tau))


def gripper(arm, names=None):
    open_ = 0.02 + 0.02 * np.sign(np.sin(arm.t))
    q = np.insert(arm.q, 3, open_, axis=1)
    tau = np.insert(arm.tau, 3, 0.3 * np.sign(open_ - 0.02), axis=1)
    return write(arm, "log.csv", csv_text(column_names(7, names), arm.t, q, tau))


def quaternion(arm, replace):
    half = arm.q[:, 0] / 2
    components = [0 * half, 0 * half, np.sin(half), np.cos(half)]
    names = column_names(arm.nv)
    if replace:
        header = ["t", "q_x", "q_y", "q_z", "q_w", *names[1 + arm.nv :]]
        return write(arm, "log.csv", csv_text(header, arm.t, *components, arm.tau))
    header = [*names, "qx", "qy", "qz", "qw"]
    return write(arm, "log.csv", csv_text(header, arm.t, arm.q, arm.tau, *components))


def times(arm, form):
    if form == "thousands":
        stamps = [f'"{1000 * x:,.1f}"' for x in arm.t]
    else:
        seconds = arm.t + 86390
        stamps = [
            f"{int(x // 3600) % 24:02d}:{int(x // 60) % 60:02d}:{x % 60:07.4f}"
            for x in seconds
        ]
    values = csv_text(column_names(arm.nv)[1:], arm.q, arm.tau).splitlines()
    return write(
        arm, "log.csv", "\n".join(f"{a},{b}" for a, b in zip(["t", *stamps], values))
    )


def encoded(arm, encoding="utf-8", replace=(), before="", name="log.csv"):
    """Write the log in another encoding, with some characters replaced."""
    content = csv_text(column_names(arm.nv), arm.t, arm.q, arm.tau)
    for old, new in replace:
        content = content.replace(old, new)
    return write(arm, name, (before + content).encode(encoding))


def binary(arm, name, begin):
    return write(arm, name, begin.encode("latin-1") + b"\0" * 200)


def pickled(arm):
    return write(arm, "frame.pkl", pickle.dumps({"q": arm.q, "tau": arm.tau}))


def missing_file(arm, path):
    return path


def robot(arm, path=None, name="robot.urdf", content=None, scale=None):
    log = encoded(arm)
    if scale is not None:
        content = re.sub(
            r'(<origin [^>]*xyz=)"([^"]+)"',
            lambda x: (
                f'{x[1]}"{" ".join(f"{scale * float(v):g}" for v in x[2].split())}"'
            ),
            arm.urdf.read_text(),
        )
    return log, path or write(arm, name, content)


def output(arm, to):
    log = encoded(arm)
    if to == "folder":
        (arm.folder / "folder").mkdir()
    (arm.folder / "out").symlink_to(arm.folder / to)
    return log


def write(arm, name, content):
    path = arm.folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path
