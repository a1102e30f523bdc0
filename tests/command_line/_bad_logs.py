"""Logs of one simulated arm, each with one thing wrong with it."""

import gzip
import pickle
import re
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass
class Arm:
    """Motion of the arm, its rigid-body torques, and where files are written."""

    folder: Path
    urdf: Path
    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray

    def __post_init__(self):
        import pinocchio as pin

        self.pin, self.model = pin, pin.buildModelFromUrdf(str(self.urdf))
        self.data = self.model.createData()
        self.dt = self.t[1] - self.t[0]
        self.v = np.gradient(self.q, self.dt, axis=0)

    def gravity(self, direction=(0, 0, -9.81)):
        """Return the torques of the weight (n, nv)."""
        model = self.model.copy()
        model.gravity.linear = np.array(direction)
        return np.array(
            [self.pin.computeGeneralizedGravity(model, self.data, x) for x in self.q]
        )

    def contact(self, newtons):
        """Return the torques of a vertical force at the last link (n, nv)."""
        pin, force = self.pin, np.array([0, 0, newtons, 0, 0, 0])
        found = np.zeros_like(self.q)
        for row, q in enumerate(self.q):
            pin.computeJointJacobians(self.model, self.data, q)
            J = pin.getJointJacobian(
                self.model, self.data, self.model.nv, pin.LOCAL_WORLD_ALIGNED
            )
            found[row] = J.T @ force
        return found


def heads(nv, names=None):
    names = names or range(1, nv + 1)
    return ["t", *(f"q{k}" for k in names), *(f"tau{k}" for k in names)]


def text(header, *columns, sep=","):
    rows = np.column_stack(columns)
    lines = [sep.join(header), *(sep.join(f"{x:.8g}" for x in row) for row in rows)]
    return "\n".join(lines) + "\n"


# -- values ----------------------------------------------------------------------------

# Each returns the changed columns; joints are counted from one.


def torque(arm, factor, joint=None):
    factors = np.ones(arm.model.nv)
    factors[slice(None) if joint is None else joint - 1] = factor
    return {"tau": arm.tau * factors}


def position(arm, factor, joint):
    q = arm.q.copy()
    q[:, joint - 1] *= factor
    return {"q": q}


def exchanged(arm, channel, joints):
    values = getattr(arm, channel).copy()
    one, other = (j - 1 for j in joints)
    values[:, [one, other]] = values[:, [other, one]]
    return {channel: values}


def late(arm, seconds):
    k = round(seconds / arm.dt)
    return {"q": arm.q[k:], "tau": arm.tau[:-k], "t": arm.t[k:]}


def rows(arm, stop=None, step=1):
    return {name: getattr(arm, name)[:stop:step] for name in ("t", "q", "tau")}


def jittery(arm):
    steps = arm.dt * np.random.default_rng(1).lognormal(0, 1, len(arm.t))
    return {"t": np.cumsum(steps)}


def pushed(arm, newtons):
    on = (arm.t > 8) & (arm.t < 11)
    return {"tau": arm.tau + on[:, None] * arm.contact(newtons)}


def stopped(arm, joint):
    """Stop an encoder at the end of its range; the stop has a torque."""
    k, q, tau = joint - 1, arm.q.copy(), arm.tau.copy()
    end = np.quantile(q[:, k], 0.85)
    beyond = np.maximum(q[:, k] - end, 0)
    q[:, k] -= beyond
    tau[:, k] += 400 * beyond
    return {"q": q, "tau": tau}


def braked(arm, joint):
    q, tau = arm.q.copy(), arm.tau.copy()
    q[:, joint - 1], tau[:, joint - 1] = q[0, joint - 1], 0
    return {"q": q, "tau": tau}


def disconnected(arm, joint, noise):
    tau = arm.tau.copy()
    tau[:, joint - 1] = noise * np.random.default_rng(1).normal(size=len(tau))
    return {"tau": tau}


def frozen(arm, joint):
    q, half = arm.q.copy(), len(arm.q) // 2
    q[half:, joint - 1] = q[half, joint - 1]
    return {"q": q}


def weightless(arm):
    return {"tau": arm.tau - arm.gravity()}


def hanging(arm):
    """Hang the base from the ceiling."""
    return {"tau": arm.tau - arm.gravity() + arm.gravity((0, 0, 9.81))}


def weight_alone(arm):
    return {"tau": arm.gravity()}


def velocities(arm):
    return {"tau": arm.v}


def rigid_bodies(arm):
    a = np.gradient(arm.v, arm.dt, axis=0)
    torques = [
        arm.pin.rnea(arm.model, arm.data, *row).copy() for row in zip(arm.q, arm.v, a)
    ]
    return {"tau": np.array(torques)}


def filtered(arm, hertz):
    from scipy.signal import lfilter

    keep = np.exp(-2 * np.pi * hertz * arm.dt)
    start = keep * arm.tau[:1]
    return {"tau": lfilter([1 - keep], [1, -keep], arm.tau, axis=0, zi=start)[0]}


def warming(arm, joint):
    tau = arm.tau.copy()
    tau[:, joint - 1] += 6 * (1 - np.exp(-arm.t / 8))
    return {"tau": tau}


def zeroed(arm):
    return {"q": arm.q - arm.q[0]}


def held(arm, times):
    q, tau = (np.repeat(x, times, axis=0) for x in (arm.q, arm.tau))
    return {"q": q, "tau": tau, "t": np.arange(len(q)) * arm.dt / times}


def per_cent(arm, rated):
    return {"tau": 100 * arm.tau / np.array(rated)}


# -- files -----------------------------------------------------------------------------

# Each writes a file and returns its path, or the path and that of the robot.


def renamed(arm, header):
    header = header or heads(arm.model.nv)
    return write(arm, "log.csv", text(header, arm.t, arm.q, arm.tau))


def gripper(arm, names=None):
    """Put a gripper in the middle of the joints."""
    open_ = 0.02 + 0.02 * np.sign(np.sin(arm.t))
    q = np.insert(arm.q, 3, open_, axis=1)
    tau = np.insert(arm.tau, 3, 0.3 * np.sign(open_ - 0.02), axis=1)
    return write(arm, "log.csv", text(heads(7, names), arm.t, q, tau))


def quaternion(arm, instead):
    half = arm.q[:, 0] / 2
    four = [0 * half, 0 * half, np.sin(half), np.cos(half)]
    names = heads(arm.model.nv)
    if instead:
        header = ["t", "q_x", "q_y", "q_z", "q_w", *names[1 + arm.model.nv :]]
        return write(arm, "log.csv", text(header, arm.t, *four, arm.tau))
    header = [*names, "qx", "qy", "qz", "qw"]
    return write(arm, "log.csv", text(header, arm.t, arm.q, arm.tau, *four))


def stamps(arm, header):
    """Seconds and nanoseconds in columns of their own."""
    t = arm.t + 0.5
    seconds = [f"{1_700_000_000 + int(x)},{round(x % 1 * 1e9)}" for x in t]
    values = text(heads(arm.model.nv)[1:], arm.q, arm.tau).splitlines()
    lines = [f"{a},{b}" for a, b in zip([header, *seconds], values)]
    return write(arm, "log.csv", "\n".join(lines))


def times(arm, form):
    """Write times as texts."""
    if form == "thousands":
        written = [f'"{1000 * x:,.1f}"' for x in arm.t]
    else:
        since = arm.t + 86390
        written = [
            f"{int(x // 3600) % 24:02d}:{int(x // 60) % 60:02d}:{x % 60:07.4f}"
            for x in since
        ]
    values = text(heads(arm.model.nv)[1:], arm.q, arm.tau).splitlines()
    return write(
        arm, "log.csv", "\n".join(f"{a},{b}" for a, b in zip(["t", *written], values))
    )


def empty_rows(arm):
    lines = text(heads(arm.model.nv), arm.t, arm.q, arm.tau).splitlines()
    for k in range(50, len(lines), 100):
        lines[k] = lines[k].split(",")[0] + "," * 2 * arm.model.nv
    return write(arm, "log.csv", "\n".join(lines))


def encoded(arm, encoding="utf-8", replace=(), before="", name="log.csv"):
    """Write the log in another encoding, with some characters replaced."""
    content = text(heads(arm.model.nv), arm.t, arm.q, arm.tau)
    for old, new in replace:
        content = content.replace(old, new)
    return write(arm, name, (before + content).encode(encoding))


def packed(arm, name):
    content = text(heads(arm.model.nv), arm.t, arm.q, arm.tau).encode()
    if not name.endswith(".zip"):
        return write(arm, name, gzip.compress(content))
    with zipfile.ZipFile(arm.folder / name, "w") as file:
        file.writestr("run.csv", content)
    return arm.folder / name


def binary(arm, name, begin):
    return write(arm, name, begin.encode("latin-1") + b"\0" * 200)


def pickled(arm):
    return write(arm, "frame.pkl", pickle.dumps({"q": arm.q, "tau": arm.tau}))


def place(arm, path):
    """Return a path that is none here."""
    return path


def robot(arm, path=None, name="robot.urdf", content=None, scale=None):
    """Write the log as it is, with another description."""
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
    """Put a link in place of the output folder."""
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
