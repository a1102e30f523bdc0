"""How others find armature, damping, Coulomb friction and delay from commands.

Least squares, with the delay on a grid, and instrumental variables know the torque of
the PD law; CMA-ES minimises errors of positions that are simulated from the commands
alone, as users of PACE do, and least squares of the same, as mujoco.sysid. All keep to
the bodies of the description, but for one least squares that frees them.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from _commanded_robots import DT, ClosedLoop, Numbers
from _undeclared_robots import inverse_dynamics, regressor
from scipy import interpolate, optimize, signal

from sklearn_vbjfa import InstrumentalVariables

STATE_BAND, BAND = 30.0, 15.0  # of positions, and of columns and torques [Hz]
# Behind the low-pass one in so many samples is independent.
FEWER = 0.5 / (BAND * DT)
MARGIN = 0.5  # left out at both ends [s]
STANDSTILL = 0.02  # share of the fastest speed
DELAYS = np.arange(0.0, 25.01e-3, 0.5e-3)  # the grid [s]
BLOCK = 0.5  # of errors by blocks of time [s]
VALUES = ("armature", "damping", "coulomb")
# Box of CMA-ES: logarithms of N m s^2/rad, N m s/rad, N m; and s.
LOWEST = np.array([1e-3, 1e-2, 1e-2])
HIGHEST = np.array([0.2, 2.0, 3.0])
LATEST = 0.025
SLOW_STEP = 2.5e-3  # of its simulations [s]


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """Numbers, and deviations of some by name, each (nv,), or a number for "delay"."""

    numbers: Numbers
    deviations: dict
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


def late_torque(log, gains, delay, held=0.0):
    """Torque of the PD law whose command is late, (n, nv), and what it reads, held."""
    times = DT * np.arange(len(log.q))
    read = log.q, log.v
    if held:
        read = (interpolate.CubicSpline(times, x)(times - held) for x in read)
    return gains.torque(log.wanted_at(times - delay), *read)


def own_columns(v, a):
    """Columns of a joint's own terms, (n, nv, 4): those of `VALUES`, offset."""
    return np.stack([a, v, np.sign(v), np.ones_like(v)], axis=2)


def slope_of_delay(log, gains, delay, step=1e-4):
    """Differentiate the PD law's torque by its delay, behind the low-pass (n, nv)."""
    ahead, behind = (late_torque(log, gains, delay + s) for s in (step, -step))
    return lowpass((ahead - behind) / (2 * step))


def block_covariance(A, left, blocks):
    """Covariance (p, p) of least squares A (n, p) by the scatter of blocks (n,)."""
    scores = np.zeros((blocks.max() + 1, A.shape[1]))
    np.add.at(scores, blocks, A * left[:, None])
    used = np.unique(blocks).size
    inverse = np.linalg.inv(A.T @ A)
    few = used / max(used - A.shape[1], 1)
    return few * inverse @ (scores.T @ scores) @ inverse


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


def least_squares(
    described, gains, log, *, delays=(0.0,), held=0.0, motion=None, by_blocks=False
):
    """Four terms of every joint beside the described bodies."""
    q, v, a = motion or states(log.q)
    X = lowpass(own_columns(v, a))
    rigid = lowpass(inverse_dynamics(described, q, v, a))
    rows = moving(v)
    nv = described.nv
    power = lowpass(late_torque(log, gains, 0.0)).var(axis=0)
    found, bases = None, [np.linalg.qr(X[rows[:, j], j])[0] for j in range(nv)]
    for delay in delays:
        Y = lowpass(late_torque(log, gains, delay, held)) - rigid
        left = 0.0
        for j, Q in enumerate(bases):
            y = Y[rows[:, j], j]
            left += (np.sum(y**2) - np.sum((Q.T @ y) ** 2)) / power[j]
        if found is None or left < found[0]:
            found = left, delay, Y
    _, delay, Y = found
    terms, deviations = np.empty((nv, 4)), np.empty((nv, 4))
    block = (np.arange(len(rows)) * DT / BLOCK).astype(int)
    slope = slope_of_delay(log, gains, delay)
    stacked, residuals, blocks = [], [], []
    for j in range(nv):
        A, y = X[rows[:, j], j], Y[rows[:, j], j]
        terms[j], square, *_ = np.linalg.lstsq(A, y)
        variance = FEWER * square[0] / (len(y) - 4 * FEWER)
        deviations[j] = np.sqrt(variance * np.diag(np.linalg.inv(A.T @ A)))
        if by_blocks:
            left, own = y - A @ terms[j], block[rows[:, j]]
            deviations[j] = np.sqrt(np.diag(block_covariance(A, left, own)))
            # What the four terms leave of the delay's column.
            alone = slope[rows[:, j], j]
            alone = alone - A @ np.linalg.lstsq(A, alone)[0]
            stacked.append(alone / left.std())
            residuals.append(left / left.std())
            blocks.append(own)
    by_name = dict(zip(VALUES, deviations.T))
    if by_blocks:
        own = [np.concatenate(x) for x in (stacked, residuals, blocks)]
        spread = block_covariance(own[0][:, None], *own[1:])
        by_name["delay"] = float(np.sqrt(spread[0, 0]))
    return Found(
        numbers=numbers_of(described, terms, delay, vectors(described)),
        deviations=by_name,
    )


def free_least_squares(described, gains, log):
    """Bodies and four terms, of least change of the description; delay on the grid."""
    q, v, a = states(log.q)
    X, Y = _free_system(described, q, v, a)
    rows = moving(v)
    weights = rows / lowpass(late_torque(log, gains, 0.0)).std(axis=0)
    A = (X * weights[:, :, None]).reshape(-1, X.shape[2])
    scale = np.sqrt((A**2).sum(axis=0))
    scale[scale == 0] = 1.0
    U, S, Vt = np.linalg.svd(A / scale, full_matrices=False)
    # What is told less sharply than this is left as described.
    kept = S > 1e-3 * S[0]
    best = None
    for delay in DELAYS:
        y = ((lowpass(late_torque(log, gains, delay)) - Y) * weights).ravel()
        along = U.T @ y
        left = y @ y - np.sum(along[kept] ** 2)
        if best is None or left < best[0]:
            best = left, delay, along
    _, delay, along = best
    theta = (Vt[kept].T @ (along[kept] / S[kept])) / scale
    return Found(numbers=_free_numbers(described, theta, delay), deviations={})


def described_bodies(described, gains, log, delay, held, motion, real):
    """Posterior means and deviations of who knows states, delay and noise."""
    q, v, a = motion
    nv, base = described.nv, vectors(described)
    X, rigid = _free_system(described, q, v, a)
    rows = moving(v)
    Y = lowpass(late_torque(log, gains, delay, held)) - rigid
    centre, precision = np.zeros(14 * nv), np.zeros((14 * nv, 14 * nv))
    for k in range(nv):
        own, away = slice(10 * k, 10 * k + 10), real[:, k] - base[k]
        centre[own] = away.mean(axis=0)
        precision[own, own] = np.linalg.inv(np.cov(away.T))
    weight = np.ones(nv)
    for _ in range(5):
        # The noise of each joint is that of its residual.
        H, b = precision.copy(), precision @ centre
        for j in range(nv):
            A, y = X[rows[:, j], j], Y[rows[:, j], j]
            H += weight[j] / FEWER * A.T @ A
            b += weight[j] / FEWER * A.T @ y
        scale = 1 / np.sqrt(np.diag(H))
        inverse = np.linalg.inv(H * np.outer(scale, scale)) * np.outer(scale, scale)
        theta = inverse @ b
        left = [Y[rows[:, j], j] - X[rows[:, j], j] @ theta for j in range(nv)]
        weight = np.array([1 / r.var() for r in left])
    deviations = np.sqrt(np.diag(inverse)[10 * nv :]).reshape(nv, 4)
    return Found(
        numbers=_free_numbers(described, theta, delay),
        deviations=dict(zip(VALUES, deviations.T)),
    )


def _free_numbers(described, theta, delay):
    """Numbers of changes of the bodies and of terms, (14 nv,)."""
    nv = described.nv
    bodies = vectors(described) + theta[: 10 * nv].reshape(nv, 10)
    return numbers_of(described, theta[10 * nv :].reshape(nv, 4), delay, bodies)


def _free_system(described, q, v, a):
    """Columns (n, nv, 14 nv) of bodies and terms, and the described bodies' torque."""
    nv = described.nv
    bodies = regressor(described, q, v, a)
    terms = np.zeros((len(q), nv, nv, 4))
    own = own_columns(v, a)
    for j in range(nv):
        terms[:, j, j] = own[:, j]
    X = np.concatenate([bodies, terms.reshape(len(q), nv, -1)], axis=2)
    return lowpass(X), lowpass(inverse_dynamics(described, q, v, a))


# -- instrumental variables ------------------------------------------------------------


def instruments(described, gains, log, *, rounds=3):
    """Least squares through the motion that is simulated from the commands (IDIM-PIV).

    It begins with least squares and its delay of the grid. In each round the closed
    loop is simulated with what was found, and the four terms of every joint and one
    change of the delay are found with simulated columns as instruments; the command is
    its own.

    Parameters
    ----------
    described : pinocchio.Model
        Robot.
    gains : Gains
        Drive.
    log : Log
        Recording.
    rounds : int, default=3
        Rounds.

    Returns
    -------
    Found
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
    deviations = np.sqrt(FEWER) * two_stage.coef_std_
    by_name = dict(zip(VALUES, deviations[:-1].reshape(nv, 4).T))
    by_name["delay"] = deviations[-1]
    final = numbers_of(described, terms, delay, vectors(described))
    return Found(numbers=final, deviations=by_name)


def _physical_terms(numbers):
    """Numbers that can be simulated: none of the terms negative."""
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
        return Found(numbers=numbers, deviations={})


def evolution(described, gains, log, *, population, generations, seed=0):
    """Armature, damping, friction loss and delay whose simulated positions are closest.

    Every joint has a constant shift of its position beside these, in closed form, which
    becomes a torque: it takes what gravity does to bodies that are not as described.

    Parameters
    ----------
    described : pinocchio.Model
        Robot.
    gains : Gains
        Drive.
    log : Log
        Recording.
    population, generations : int
        Budget: their product is the number of simulated recordings.
    seed : int, default=0
        Random state.

    Returns
    -------
    Found
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


def output_error(described, gains, log, *, steps=25):
    """Least squares of the same simulated positions, as mujoco.sysid has it."""
    loop = ClosedLoop(described, gains, vectors(described), SLOW_STEP)
    box = Box(described)
    ends = np.cumsum(box.sizes)[:-1]
    scale = 1 / log.q.std(axis=0)

    def missed(points):
        robots = [box.robot(np.split(x, ends)) for x in points]
        away = (loop.positions(robots, log)[:, 0] - log.q) * scale
        return away - away.mean(axis=1, keepdims=True)

    def slopes(x):
        step, nv = 1e-3, len(scale)
        towards = np.where(x > 0.5, -step, step)
        points = [x]
        for i in range(max(box.sizes)):
            moved = [part.copy() for part in np.split(x, ends)]
            for part, way in zip(moved, np.split(towards, ends)):
                if i < len(part):
                    part[i] += way[i]
            points.append(np.concatenate(moved))
        here, *others = missed(points)
        J = np.zeros((*here.shape, len(x)))
        for first, size, leg in zip(np.r_[0, ends], box.sizes, box.legs):
            for i in range(size):
                change = (others[i] - here)[:, leg] / towards[first + i]
                J[:, leg, first + i] = change
        return J.reshape(len(here) * nv, -1)

    start = np.full(sum(box.sizes), 0.5)
    fit = optimize.least_squares(
        lambda x: missed([x])[0].ravel(),
        start,
        slopes,
        bounds=(0.0, 1.0),
        max_nfev=steps,
    )
    best = np.split(fit.x, ends)
    shift = (loop.positions([box.robot(best)], log)[0, 0] - log.q).mean(axis=0)
    return box.found(best, gains, shift)
