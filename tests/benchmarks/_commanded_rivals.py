"""How others find armature, damping, Coulomb friction and delay from commands.

Least squares, with the delay on a grid, and instrumental variables know the torque of
the PD law; CMA-ES minimises errors of positions that are simulated from the commands
alone, as users of PACE do. All keep to the bodies of the description.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from _commanded_robots import DT, ClosedLoop, Numbers
from _undeclared_robots import inverse_dynamics
from scipy import interpolate, signal

from sklearn_vbjfa import InstrumentalVariables

STATE_BAND, BAND = 30.0, 15.0  # of positions, and of columns and torques [Hz]
MARGIN = 0.5  # left out at both ends [s]
STANDSTILL = 0.02  # share of the fastest speed
DELAYS = np.arange(0.0, 25.01e-3, 0.5e-3)  # the grid [s]
VALUES = ("armature", "damping", "coulomb")
# Box of CMA-ES: logarithms of N m s^2/rad, N m s/rad, N m; and s.
LOWEST = np.array([1e-3, 1e-2, 1e-2])
HIGHEST = np.array([0.2, 2.0, 3.0])
LATEST = 0.025
SLOW_STEP = 2.5e-3  # of its simulations [s]


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """Numbers, and intervals of some by name, each (2, nv), or (2,) for "delay"."""

    numbers: Numbers
    intervals: dict = field(default_factory=dict)


def _filtered(x, band):
    sos = signal.butter(4, band, fs=1 / DT, output="sos")
    return signal.sosfiltfilt(sos, x, axis=0)


def states(q):
    """Positions, speeds, accelerations, each (n, nv), of positions as read."""
    t = DT * np.arange(len(q))
    spline = interpolate.CubicSpline(t, _filtered(q, STATE_BAND))
    return spline(t), spline(t, 1), spline(t, 2)


def lowpass(x):
    """Low-pass of columns and torques (n, ...), without the margins."""
    margin = round(MARGIN / DT)
    return _filtered(x, BAND)[margin:-margin]


def moving(v):
    """Which samples of which joint count, (n - margins, nv)."""
    margin = round(MARGIN / DT)
    inner = np.abs(v[margin:-margin])
    return inner > STANDSTILL * inner.max(axis=0)


def late_torque(log, gains, delay):
    """Torque of the PD law whose command is late, (n, nv)."""
    times = DT * np.arange(len(log.q))
    return gains.torque(log.wanted_at(times - delay), log.q, log.v)


def own_columns(v, a):
    """Columns of a joint's own terms, (n, nv, 4): those of `VALUES`, offset."""
    return np.stack([a, v, np.sign(v), np.ones_like(v)], axis=2)


def slope_of_delay(log, gains, delay, step=1e-4):
    """Differentiate the PD law's torque by its delay, behind the low-pass (n, nv)."""
    ahead, behind = (late_torque(log, gains, delay + s) for s in (step, -step))
    return lowpass((ahead - behind) / (2 * step))


def numbers_of(described, terms, delay, bodies):
    """Numbers of the four terms (nv, 4)."""
    armature, damping, coulomb, offset = np.transpose(terms)
    return Numbers(
        bodies=bodies,
        armature=armature,
        damping=damping,
        coulomb=coulomb,
        offset=offset,
        delay=float(delay),
    )


def vectors(model):
    """Inertial parameters of all bodies, (nv, 10)."""
    return np.array([body.toDynamicParameters() for body in model.inertias[1:]])


# -- least squares ---------------------------------------------------------------------


def least_squares(described, gains, log, *, delays=(0.0,)):
    """Four terms of every joint beside the described bodies."""
    q, v, a = states(log.q)
    X = lowpass(own_columns(v, a))
    rigid = lowpass(inverse_dynamics(described, q, v, a))
    rows = moving(v)
    nv = described.nv
    power = lowpass(late_torque(log, gains, 0.0)).var(axis=0)
    found, bases = None, [np.linalg.qr(X[rows[:, j], j])[0] for j in range(nv)]
    for delay in delays:
        Y = lowpass(late_torque(log, gains, delay)) - rigid
        left = 0.0
        for j, Q in enumerate(bases):
            y = Y[rows[:, j], j]
            left += (np.sum(y**2) - np.sum((Q.T @ y) ** 2)) / power[j]
        if found is None or left < found[0]:
            found = left, delay, Y
    _, delay, Y = found
    terms = [np.linalg.lstsq(X[r, j], Y[r, j])[0] for j, r in enumerate(rows.T)]
    return Found(numbers=numbers_of(described, terms, delay, vectors(described)))


# -- instrumental variables ------------------------------------------------------------


def instruments(described, gains, log, *, rounds=3):
    """Least squares through the motion that is simulated from the commands (IDIM-PIV).

    It begins with least squares and its delay of the grid. In each round the closed
    loop is simulated with what was found, and the four terms of every joint and one
    change of the delay are found with simulated columns as instruments; the command is
    its own.
    """
    nv = described.nv
    q, v, a = states(log.q)
    X = lowpass(own_columns(v, a))
    rigid = lowpass(inverse_dynamics(described, q, v, a))
    rows = moving(v)
    found = least_squares(described, gains, log, delays=DELAYS)
    numbers = _physical_terms(found.numbers)
    loop = ClosedLoop(described, gains, vectors(described))
    t = DT * np.arange(len(q))
    for _ in range(rounds):
        simulated, speeds = loop.motion(numbers, log)
        Z = own_columns(speeds, interpolate.CubicSpline(t, simulated)(t, 2))
        Z = lowpass(Z)
        slope = slope_of_delay(log, gains, numbers.delay)
        Y = lowpass(late_torque(log, gains, numbers.delay)) - rigid
        weight = 1 / Y.std(axis=0)
        blocks = []
        for j in range(nv):
            which = rows[:, j]
            size = which.sum()
            A, B = np.zeros((2, size, 4 * nv + 1))
            A[:, 4 * j : 4 * j + 4] = X[which, j]
            B[:, 4 * j : 4 * j + 4] = Z[which, j]
            A[:, -1] = B[:, -1] = -slope[which, j]
            blocks.append(weight[j] * np.c_[A, Y[which, j], B])
        block = np.concatenate(blocks)
        size = 4 * nv + 1
        two_stage = InstrumentalVariables(fit_intercept=False).fit(
            block[:, :size], block[:, size], instruments=block[:, size + 1 :]
        )
        terms = two_stage.coef_[:-1].reshape(nv, 4)
        delay = numbers.delay + two_stage.coef_[-1]
        numbers = _physical_terms(
            numbers_of(described, terms, delay, vectors(described))
        )
    return Found(numbers=numbers_of(described, terms, delay, vectors(described)))


def _physical_terms(numbers):
    least = {name: np.maximum(getattr(numbers, name), 1e-4) for name in VALUES}
    return replace(numbers, **least, delay=max(numbers.delay, 0.0))


# -- CMA-ES ----------------------------------------------------------------------------


def branches(described):
    """Joints that move together, a list for each that hangs from the base."""
    roots = []
    for i in range(1, described.njoints):
        parent = described.parents[i]
        roots.append(i - 1 if parent == 0 else roots[parent - 1])
    return [
        [j for j, r in enumerate(roots) if r == root] for root in dict.fromkeys(roots)
    ]


class Box:
    """Points of a unit box for each branch of a robot, and the robots they stand for.

    A branch has logarithms of armature, damping and Coulomb friction of its joints, and
    a delay of its own: branches do not feel each other while the base is held, so that
    one simulation of the robot serves all.
    """

    def __init__(self, described):
        self.legs = branches(described)
        self.sizes = [3 * len(leg) + 1 for leg in self.legs]
        terms = np.zeros((described.nv, 4))
        self._empty = numbers_of(described, terms, 0.0, vectors(described))

    def robot(self, points):
        """Robot of one point (size,) of each branch."""
        nv = len(self._empty.armature)
        values = {name: np.zeros(nv) for name in (*VALUES, "delay")}
        for leg, x in zip(self.legs, points):
            terms = LOWEST * (HIGHEST / LOWEST) ** x[:-1].reshape(-1, 3)
            for name, column in zip(VALUES, terms.T):
                values[name][leg] = column
            values["delay"][leg] = LATEST * x[-1]
        return replace(self._empty, **values)

    def found(self, points, gains, shift):
        """Return what was found: best points, and shifts of the positions (nv,)."""
        best = self.robot(points)
        delay = float(np.median(best.delay))
        numbers = replace(best, delay=delay, offset=gains.kp * shift)
        return Found(numbers=numbers)


def evolution(described, gains, log, *, population, generations, seed=0):
    """Armature, damping, friction loss and delay whose simulated positions are closest.

    Every joint has a constant shift of its position beside these, in closed form, which
    becomes a torque: it takes what gravity does to bodies that are not as described.
    The delay is the median of those of the branches.
    """
    import cma

    loop = ClosedLoop(described, gains, vectors(described), SLOW_STEP)
    box, power = Box(described), log.q.var(axis=0)
    options = {"popsize": population, "bounds": [0, 1], "verbose": -9}
    searches = [
        cma.CMAEvolutionStrategy(
            np.full(n, 0.5), 0.25, {**options, "seed": seed + 1 + k}
        )
        for k, n in enumerate(box.sizes)
    ]
    for _ in range(generations):
        asked = [search.ask() for search in searches]
        found = loop.positions([box.robot(points) for points in zip(*asked)], log)[:, 0]
        missed = (found - log.q).var(axis=1) / power
        # A simulation that diverged is as bad as any.
        missed = np.where(np.isfinite(missed), missed, 1e6)
        for search, points, leg in zip(searches, asked, box.legs):
            search.tell(points, missed[:, leg].sum(axis=1).tolist())
    best = [search.result.xbest for search in searches]
    shift = (loop.positions([box.robot(best)], log)[0, 0] - log.q).mean(axis=0)
    return box.found(best, gains, shift)
