"""Robots moved by commands, simulated with MuJoCo and not with the package.

A robot is its numbers: bodies, armature, damping, Coulomb friction and offset of every
joint, and the delay of its commands. The truth is stepped at 20 kHz under a drive that
sets its torque at 1 kHz; what methods found is simulated at `STEP`, from the commands
alone. MuJoCo's friction is a soft constraint: `SOLREF` makes it turn within some
hundredths of a rad/s, where its default needs a tenth and more.
"""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout
from scipy import interpolate, signal

TICK = 1e-3  # period of the drive [s]
SUBSTEPS = 20  # steps of the physics in it
LOG = 5  # ticks from one row of the log to the next
DT = LOG * TICK
STEP = 1e-3  # step of simulations of what was found [s]
SOLREF = "0.002 1"
SPEED_BAND = 40.0  # low-pass behind which a drive differentiates its encoder [Hz]


@dataclass(frozen=True, kw_only=True, eq=False)
class Numbers:
    """A robot's numbers, all (nv,) but bodies (nv, 10) and delay, one or (nv,)."""

    bodies: np.ndarray
    armature: np.ndarray
    damping: np.ndarray
    coulomb: np.ndarray
    offset: np.ndarray
    delay: float | np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class Gains:
    """Gains of a drive: kp [N m/rad], kd [N m s/rad], each (nv,)."""

    kp: np.ndarray
    kd: np.ndarray

    def torque(self, wanted, q, v):
        """Torque of the PD law."""
        return self.kp * (wanted - q) - self.kd * v


@dataclass(frozen=True, kw_only=True, eq=False)
class Log:
    """A log at 200 Hz: what is recorded, and, where it was simulated, what was so."""

    q: np.ndarray
    v: np.ndarray
    wanted: np.ndarray
    true_q: np.ndarray | None = None
    true_v: np.ndarray | None = None
    true_a: np.ndarray | None = None

    def wanted_at(self, times):
        """Command at times [s], (n, nv) or, for times (n, nv), one time a joint.

        A command is held until the next row: within the band of the rows it is the mean
        of the last period of a spline.
        """
        n = len(self.wanted)
        spline = interpolate.CubicSpline(DT * np.arange(n), self.wanted)
        total, last = spline.antiderivative(), DT * (n - 1)

        def mean(times, j=slice(None)):
            ends = [np.clip(x, 0.0, last) for x in (times, times - DT)]
            outside = (times - ends[0]) - (times - DT - ends[1])
            first, final = self.wanted[0], self.wanted[-1]
            held = np.where(times[:, None] < 0.5 * last, first, final)
            found = total(ends[0]) - total(ends[1]) + outside[:, None] * held
            return found[:, j] / DT

        if times.ndim == 1:
            return mean(times)
        return np.stack([mean(x, j) for j, x in enumerate(times.T)], axis=1)


# -- the robot for MuJoCo --------------------------------------------------------------


def _words(values):
    return " ".join(f"{x:.17g}" for x in np.ravel(values))


def mjcf(described, numbers, gains=None, step=STEP):
    """Text of an MJCF of a robot whose base is held and whose bodies touch nothing."""
    import pinocchio as pin

    children = {i: [] for i in range(described.njoints)}
    for i in range(1, described.njoints):
        children[described.parents[i]].append(i)

    def body(i):
        j = i - 1
        place = described.jointPlacements[i]
        quaternion = pin.Quaternion(place.rotation).coeffs()[[3, 0, 1, 2]]
        data = described.joints[i].createData()
        described.joints[i].calc(data, np.zeros(1))
        slides, turns = np.asarray(data.S).reshape(2, 3)
        kind = "hinge" if turns.any() else "slide"
        axis = turns if turns.any() else slides
        inertia = pin.Inertia.FromDynamicParameters(numbers.bodies[j])
        full = inertia.inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
        inside = "".join(body(k) for k in children[i])
        return (
            f'<body pos="{_words(place.translation)}" quat="{_words(quaternion)}">'
            f'<inertial mass="{inertia.mass:.17g}" pos="{_words(inertia.lever)}" '
            f'fullinertia="{_words(full)}"/>'
            f'<joint name="{described.names[i]}" type="{kind}" axis="{_words(axis)}" '
            f'armature="{numbers.armature[j]:.17g}" '
            f'damping="{numbers.damping[j]:.17g}" '
            f'frictionloss="{numbers.coulomb[j]:.17g}" solreffriction="{SOLREF}"/>'
            f"{inside}</body>"
        )

    drives = []
    for j, name in enumerate(list(described.names)[1:]):
        if gains is None:
            drives.append(f'<motor joint="{name}"/>')
        else:
            drives.append(
                f'<position joint="{name}" kp="{gains.kp[j]:.17g}" '
                f'kv="{gains.kd[j]:.17g}"/>'
            )
    gravity = _words(described.gravity.linear)
    return (
        f'<mujoco><compiler angle="radian"/>'
        f'<option timestep="{step:.17g}" gravity="{gravity}" '
        'integrator="Euler"><flag contact="disable"/></option><worldbody>'
        f"{''.join(body(i) for i in children[0])}</worldbody>"
        f"<actuator>{''.join(drives)}</actuator></mujoco>"
    )


def is_physical(bodies):
    """Whether MuJoCo takes the bodies: masses and principal moments of some body."""
    import pinocchio as pin

    for values in bodies:
        if not values[0] > 0:
            return False
        moments = np.linalg.eigvalsh(pin.Inertia.FromDynamicParameters(values).inertia)
        if not (moments[0] > 0 and moments[0] + moments[1] >= moments[2]):
            return False
    return True


# -- the truth -------------------------------------------------------------------------


def read_noise(deviation, shape, rng):
    """Noise of encoders [rad] and of the speeds that drives make of them [rad/s]."""
    e = deviation * rng.standard_normal(shape)
    keep = np.exp(-2 * np.pi * SPEED_BAND * TICK)
    difference = np.diff(e, axis=0, prepend=e[:1]) / TICK
    return e, signal.lfilter([1 - keep], [1.0, -keep], difference, axis=0)


def recorded(described, numbers, gains, motion, duration, *, deviation, in_loop, rng):
    """Simulate a robot that follows a motion, and log it."""
    model = mujoco.MjModel.from_xml_string(
        mjcf(described, numbers, step=TICK / SUBSTEPS)
    )
    data = mujoco.MjData(model)
    n = round(duration / TICK) + 1
    t = TICK * np.arange(n)
    wanted = np.mean(
        [
            motion(DT * np.floor(np.maximum(t + share * TICK - numbers.delay, 0) / DT))
            for share in (np.arange(10) + 0.5) / 10
        ],
        axis=0,
    )
    e, w = read_noise(deviation, wanted.shape, rng)
    seen_e, seen_w = (e, w) if in_loop else (0 * e, 0 * w)
    data.qpos[:] = wanted[0]
    q, v = np.empty_like(wanted), np.empty_like(wanted)
    for k in range(n):
        q[k], v[k] = data.qpos, data.qvel
        applied = gains.torque(wanted[k], q[k] + seen_e[k], v[k] + seen_w[k])
        data.ctrl[:] = applied - numbers.offset
        mujoco.mj_step(model, data, SUBSTEPS)
    rows = np.arange(LOG, n - LOG, LOG)
    return Log(
        q=(q + e)[rows],
        v=(v + w)[rows],
        wanted=motion(t)[rows],
        true_q=q[rows],
        true_v=v[rows],
        true_a=((v[rows + 1] - v[rows - 1]) / (2 * TICK)),
    )


# -- what was found, from the commands alone -------------------------------------------


class ClosedLoop:
    """Simulations of robots under a drive, from commands alone."""

    def __init__(self, described, gains, bodies, step=STEP):
        self.gains, self.step, self._row = gains, step, round(DT / step)
        nothing = np.zeros(described.nv)
        numbers = Numbers(
            bodies=bodies,
            armature=nothing,
            damping=nothing,
            # MuJoCo has no row for a friction that is zero when it is compiled.
            coulomb=nothing + 1.0,
            offset=nothing,
            delay=0.0,
        )
        self._model = mujoco.MjModel.from_xml_string(
            mjcf(described, numbers, gains, step)
        )
        self._data = mujoco.MjData(self._model)

    def _of(self, numbers):
        model = copy.copy(self._model)
        model.dof_armature[:] = numbers.armature
        model.dof_damping[:] = numbers.damping
        model.dof_frictionloss[:] = numbers.coulomb
        return model

    def positions(self, robots, log, starts=(0,), rows=None):
        """Positions at the rows of a log, (n_robots, n_starts, rows, nv)."""
        states = self._states(robots, log, starts, rows)
        nv = self._model.nv
        return states[..., 1 : 1 + nv]

    def motion(self, robot, log):
        """Positions and speeds of one robot at the rows of a log, each (n, nv)."""
        nv = self._model.nv
        states = self._states([robot], log, (0,), None)[0, 0]
        return states[:, 1 : 1 + nv], states[:, 1 + nv : 1 + 2 * nv]

    def _states(self, robots, log, starts, rows):
        nv = self._model.nv
        rows = len(log.q) if rows is None else rows
        size = mujoco.mj_stateSize(
            self._model, mujoco.mjtState.mjSTATE_FULLPHYSICS.value
        )
        t = self.step * np.arange((rows - 1) * self._row)
        models, first, controls = [], [], []
        for one in robots:
            late = np.broadcast_to(one.delay, nv)
            for start in starts:
                models.append(self._of(one))
                wanted = log.wanted_at(start * DT + t[:, None] - late)
                controls.append(wanted - one.offset / self.gains.kp)
                state = np.zeros(size)
                state[1 : 1 + 2 * nv] = np.r_[log.q[start], log.v[start]]
                first.append(state)
        found, _ = rollout.rollout(
            models, [self._data], np.array(first), np.array(controls)
        )
        at_rows = found[:, self._row - 1 :: self._row]
        found = np.concatenate([np.array(first)[:, None], at_rows], axis=1)
        return found.reshape(len(robots), len(starts), rows, size)
