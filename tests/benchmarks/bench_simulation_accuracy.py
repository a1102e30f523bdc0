"""Simulated motion beside closed forms and literal integrations of high accuracy.

Run as ``python tests/benchmarks/bench_simulation_accuracy.py``. The references share no
code with the package: closed forms of a sliding mass, of a mass on a spring and of a
pendulum; SciPy's integrators at a relative tolerance of 1e-11 for the equations of one
and two joints written out here, with the instants at which a joint sticks or slips as
events; and the energy of random chains without friction.
"""

import itertools
import time
import warnings
from dataclasses import dataclass

import numpy as np
from _report import parser, publish, rst_table
from _simulated_models import chain, pendulum, simulated, slide, torque_model
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk

GRAVITY = 9.81
PERIODS = (0.001, 0.01)  # s
TIGHT = {"rtol": 1e-11, "atol": 1e-13}
ENERGY = 1e-6  # asked for, of the largest kinetic energy
SEED = 0
ROUNDS = 3


@dataclass(frozen=True, kw_only=True)
class Answer:
    """One figure of one case.

    Attributes
    ----------
    case, figure, unit : str
        What was simulated, what is compared, in which unit.
    dt : float
        Sample period [s].
    error : float
        Error; nan if the simulation failed.
    asked : float
        Largest that was asked for; nan where nothing was.
    work : float
        Time for one row [s].
    message : str
        What the simulation ended in.
    """

    case: str
    dt: float
    figure: str
    unit: str
    error: float
    asked: float = np.nan
    work: float = np.nan
    message: str = ""


def timed(robot, tau, q0, v0, rounds=ROUNDS):
    """Simulate; return states (n, 3 nv) and the time for one row [s]."""
    taken = []
    for _ in range(rounds):
        started = time.process_time()
        states = simulated(robot, tau, np.array(q0), np.array(v0))
        taken.append(time.process_time() - started)
    # the first one compiles
    return states, min(taken) / len(tau)


def case(name, dt, figures):
    """Answers of one case, whose `figures` simulates and compares.

    Parameters
    ----------
    name : str
        Case.
    dt : float
        Sample period [s].
    figures : callable
        () -> list of (figure, unit, error) or (figure, unit, error, asked), and the
        time for one row.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            found, work = figures()
    except (ValueError, ArithmeticError, RuntimeError) as error:
        message = f"{type(error).__name__}: {error}".splitlines()[0]
        return [
            Answer(case=name, dt=dt, figure="–", unit="", error=np.nan, message=message)
        ]
    return [
        Answer(
            case=name,
            dt=dt,
            figure=figure,
            unit=unit,
            error=float(error),
            asked=asked[0] if asked else np.nan,
            work=work,
        )
        for figure, unit, error, *asked in found
    ]


def largest(x):
    """Largest absolute value."""
    return np.abs(x).max()


# -- one mass --------------------------------------------------------------------------


def stopping(dt, mass=2.0, dry=3.0, speed=0.7, seconds=1.0):
    """Mass that Coulomb friction stops: parabola, then rest."""
    n = round(seconds / dt) + 1
    t = dt * np.arange(n)
    stop = mass * speed / dry
    run = np.minimum(t, stop)
    exact = speed * run - 0.5 * dry / mass * run**2
    robot = torque_model(slide(mass), friction={"coulomb": dry}, dt=dt)
    states, work = timed(robot, np.zeros((n, 1)), [0.0], [speed])
    q, v, _ = states.T
    after = t >= stop + dt
    moving = np.flatnonzero(np.abs(v) > 1e-9)
    stopped = t[moving[-1] + 1] if moving[-1] + 1 < n else np.inf
    return [
        ("position on the way", "m", largest(q - exact)),
        ("place of rest", "m", abs(q[-1] - 0.5 * speed * stop)),
        # rows know the instant to a period
        ("time of rest beyond its row", "s", max(abs(stopped - stop) - dt, 0.0)),
        ("speed at rest", "m/s", largest(v[after])),
    ], work


def turning_points(mass, stiffness, dry, start):
    """Where a mass on a spring with Coulomb friction turns, the last one at rest."""
    band = dry / stiffness
    places = [start]
    while abs(places[-1]) > band:
        places.append(-places[-1] + 2 * band * np.sign(places[-1]))
    return np.array(places)


def on_a_spring(t, mass, stiffness, dry, start):
    """Position (n,) of a mass on a spring with Coulomb friction, released at rest."""
    places = turning_points(mass, stiffness, dry, start)
    w = np.sqrt(stiffness / mass)
    half = np.minimum((t * w / np.pi).astype(int), len(places) - 1)
    at = places[half]
    # on the way from a turning point, friction shifts the middle towards it
    middle = np.sign(at) * dry / stiffness
    moved = middle + (at - middle) * np.cos(w * t - np.pi * half)
    return np.where(half == len(places) - 1, at, moved)


def ringing(dt, mass=1.0, stiffness=50.0, dry=0.4, start=0.1, seconds=4.0):
    """Mass on a spring with Coulomb friction: turning points fall by 2 Fc / k each."""
    from sklearn_vbjfa.effects import Spring

    n = round(seconds / dt) + 1
    t = dt * np.arange(n)
    exact = on_a_spring(t, mass, stiffness, dry, start)
    robot = torque_model(
        slide(mass),
        friction={"coulomb": dry},
        effects={Spring(joint=0): (stiffness, 0.0)},
        dt=dt,
    )
    states, work = timed(robot, np.zeros((n, 1)), [start], [0.0])
    q, v, _ = states.T
    places = turning_points(mass, stiffness, dry, start)
    rest = t > (len(places) - 1) * np.pi * np.sqrt(mass / stiffness) + dt
    return [
        ("position on the way", "m", largest(q - exact)),
        ("place of rest", "m", abs(q[-1] - places[-1])),
        ("speed at rest", "m/s", largest(v[rest])),
    ], work


def sticking(dt, dry=3.0, share=0.97, seconds=10.0):
    """Mass at rest under a load below breakaway."""
    n = round(seconds / dt) + 1
    robot = torque_model(slide(2.0), friction={"coulomb": dry}, dt=dt)
    tau = np.full((n, 1), share * dry)
    states, work = timed(robot, tau, [0.3], [0.0])
    q, v, a = states.T
    return [
        ("creep", "m", largest(q - 0.3)),
        ("speed", "m/s", largest(v)),
        ("acceleration", "m/s^2", largest(a)),
    ], work


def breaking_away(dt, mass=2.0, dry=3.0, share=1.03, seconds=2.0):
    """Mass at rest under a load just above breakaway."""
    n = round(seconds / dt) + 1
    t = dt * np.arange(n)
    exact = 0.5 * (share - 1.0) * dry / mass * t**2
    robot = torque_model(slide(mass), friction={"coulomb": dry}, dt=dt)
    states, work = timed(robot, np.full((n, 1), share * dry), [0.0], [0.0])
    return [("position", "m", largest(states[:, 0] - exact))], work


def carried(dt, push=5.0, seconds=1.0):
    """Two slides, the second driven, the first held by its friction or carried away.

    Held while the reaction m2 a2 is below its Coulomb friction, else both slide.
    """
    masses, held, dry = (3.0, 2.0), 6.0, 1.0
    n = round(seconds / dt) + 1
    t = dt * np.arange(n)
    M = np.array([[sum(masses), masses[1]], [masses[1], masses[1]]])
    reaction = push - dry
    if reaction <= held:
        acceleration = np.array([0.0, reaction / masses[1]])
    else:
        acceleration = np.linalg.solve(M, [held, reaction])
    exact = 0.5 * np.outer(t**2, acceleration)
    robot = torque_model(
        slide(*masses), friction={"coulomb": np.array([held, dry])}, dt=dt
    )
    tau = np.tile([0.0, push], (n, 1))
    states, work = timed(robot, tau, [0.0, 0.0], [0.0, 0.0])
    return [
        (f"position {j + 1}", "m", largest(states[:, j] - exact[:, j]))
        for j in range(2)
    ], work


def decaying(dt, rate, mass=1.0, speed=1.0, seconds=1.0):
    """Speed that decays by viscous friction at `rate` [1/s]."""
    n = round(seconds / dt) + 1
    t = dt * np.arange(n)
    exact = speed * np.exp(-rate * t)
    robot = torque_model(slide(mass), friction={"viscous": rate * mass}, dt=dt)
    states, work = timed(robot, np.zeros((n, 1)), [0.0], [speed])
    way = speed / rate
    return [
        ("speed", "m/s", largest(states[:, 1] - exact)),
        ("way, over its length", "", largest(states[:, 0] / way + exact / speed - 1)),
    ], work


def creeping(dt, rate, force=0.1, seconds=1.0):
    """Mass at its steady speed under viscous friction at `rate` [1/s]."""
    n = round(seconds / dt) + 1
    t = dt * np.arange(n)
    robot = torque_model(slide(1.0), friction={"viscous": rate}, dt=dt)
    tau = np.full((n, 1), force * rate)
    states, work = timed(robot, tau, [0.0], [0.0])
    exact = force * (t - (1.0 - np.exp(-rate * t)) / rate)
    return [("position", "m", largest(states[:, 0] - exact))], work


def stiff(dt, mass=1.0, stiffness=50.0, dry=0.4, start=0.1, seconds=1.0):
    """Mass on a spring with friction Fc tanh(v / w), w = 1e-4 of its speed."""
    from sklearn_vbjfa.effects import Coulomb, Spring

    n = round(seconds / dt) + 1
    t = dt * np.arange(n)
    width = 1e-4 * start * np.sqrt(stiffness / mass)

    def rate(_, x):
        friction = dry * np.tanh(x[1] / width)
        return [x[1], (-stiffness * x[0] - friction) / mass]

    def slope(_, x):
        steep = -dry / width / np.cosh(min(abs(x[1]) / width, 300.0)) ** 2
        return [[0.0, 1.0], [-stiffness / mass, steep / mass]]

    exact = solve_ivp(
        rate, (0.0, t[-1]), [start, 0.0], "Radau", t_eval=t, jac=slope, **TIGHT
    ).y[0]
    robot = torque_model(
        slide(mass),
        effects={
            Coulomb(joint=0, smoothing=width): (dry,),
            Spring(joint=0): (stiffness, 0.0),
        },
        dt=dt,
    )
    states, work = timed(robot, np.zeros((n, 1)), [start], [0.0])
    return [("position", "m", largest(states[:, 0] - exact))], work


# -- pendulums -------------------------------------------------------------------------


def swinging(dt, amplitude=170.0, seconds=10.0):
    """Pendulum released at rest: Jacobi's elliptic functions, and its period."""
    mass, lever, inertia = 1.3, 0.4, 0.02
    n = round(seconds / dt) + 1
    t = dt * np.arange(n)
    start = np.deg2rad(amplitude)
    k = np.sin(0.5 * start)
    w = np.sqrt(mass * GRAVITY * lever / (inertia + mass * lever**2))
    _, cn, dn, _ = ellipj(w * t, k**2)
    exact = 2 * np.arcsin(k * cn / dn)
    robot = torque_model(pendulum((mass, lever, inertia, 0.0)), dt=dt)
    states, work = timed(robot, np.zeros((n, 1)), [start], [0.0])
    q = states[:, 0]
    down = np.flatnonzero((q[:-1] > 0) & (q[1:] <= 0))
    crossings = t[down] + dt * q[down] / (q[down] - q[down + 1])
    period = np.diff(crossings).mean()
    return [
        ("angle", "rad", largest(q - exact)),
        ("period, over its length", "", abs(period * w / (4 * ellipk(k**2)) - 1)),
    ], work


@dataclass(frozen=True, kw_only=True)
class TwoLinks:
    """Pendulum of two links with friction under torques that rise in time, literally.

    Attributes
    ----------
    mass, lever, inertia : tuple of float
        Of the links, inertias about their centres of mass.
    length : float
        Of the first link [m].
    viscous, dry : tuple of float
        Friction.
    torque, rise : tuple of float
        Torques at the start [N m], and what they gain in a second.
    """

    mass: tuple = (1.2, 0.8)
    lever: tuple = (0.2, 0.15)
    inertia: tuple = (0.02, 0.01)
    length: float = 0.4
    viscous: tuple = (0.15, 0.05)
    dry: tuple = (0.9, 0.35)
    torque: tuple = (0.0, 0.0)
    rise: tuple = (1.5, -0.4)

    def torques(self, t):
        """Torques at times t, (..., 2)."""
        return np.add(self.torque, np.multiply.outer(t, self.rise))

    def equations(self, t, x):
        """Mass matrix, and torques without dry friction that would accelerate it."""
        (m1, m2), (r1, r2), (i1, i2) = self.mass, self.lever, self.inertia
        l1 = self.length
        (q1, q2), v = x[:2], x[2:]
        c, s = np.cos(q2), np.sin(q2)
        M12 = i2 + m2 * (r2**2 + l1 * r2 * c)
        M11 = i1 + m1 * r1**2 + i2 + m2 * (l1**2 + r2**2 + 2 * l1 * r2 * c)
        M = np.array([[M11, M12], [M12, i2 + m2 * r2**2]])
        h = m2 * l1 * r2 * s
        turning = np.array([-h * (2 * v[0] * v[1] + v[1] ** 2), h * v[0] ** 2])
        low = m2 * GRAVITY * r2 * np.sin(q1 + q2)
        high = (m1 * r1 + m2 * l1) * GRAVITY * np.sin(q1)
        gravity = np.array([high + low, low])
        return M, self.torques(t) - turning - gravity - np.multiply(self.viscous, v)

    def accelerations(self, t, x, mode):
        """Accelerations, and what holds the joints at rest, of a mode of signs.

        mode : two of -1, 0, 1, the direction of each joint, 0 at rest.
        """
        M, force = self.equations(t, x)
        slips = np.not_equal(mode, 0)
        a, held = np.zeros(2), np.zeros(2)
        driven = force - np.multiply(self.dry, mode)
        if slips.any():
            a[slips] = np.linalg.solve(M[np.ix_(slips, slips)], driven[slips])
        held[~slips] = (force - M @ a)[~slips]
        return a, held

    def next_mode(self, t, x, moving):
        """Mode in which the joints that do not move (`moving` 0) go on."""
        options = [(m,) if m else (0, 1, -1) for m in moving]
        for mode in itertools.product(*options):
            a, held = self.accelerations(t, x, mode)
            rests = np.equal(mode, 0)
            starts = ~rests & np.equal(moving, 0)
            if (np.abs(held[rests]) <= np.array(self.dry)[rests]).all() and (
                a[starts] * np.array(mode)[starts] > 0
            ).all():
                return np.array(mode)
        raise RuntimeError(f"No joint may move or rest at {t} s.")

    def solve(self, t, q0, v0):
        """Positions (n, 2) at times t, from event to event."""
        out = np.empty((len(t), 2))
        now, x = t[0], np.concatenate([q0, v0]).astype(float)
        mode = self.next_mode(now, x, np.sign(x[2:]).astype(int))
        done = 0
        while done < len(t):
            events = [self._ends(j, mode) for j in range(2)]
            found = solve_ivp(
                lambda s, y, mode=mode: np.r_[y[2:], self.accelerations(s, y, mode)[0]],
                (now, t[-1]),
                x,
                "DOP853",
                dense_output=True,
                events=events,
                **TIGHT,
            )
            until = found.t[-1]
            rows = np.arange(done, np.searchsorted(t, until, side="right"))
            out[rows] = found.sol(t[rows])[:2].T
            done += len(rows)
            if found.status == 0:
                break
            now, x = until, found.y[:, -1].copy()
            joint = next(j for j in range(2) if len(found.t_events[j]))
            moving = mode.copy()
            if mode[joint]:
                x[2 + joint] = 0.0
                moving[joint] = 0
            else:
                # it slips from here on, in the direction in which it was pushed
                held = self.accelerations(now, x, mode)[1][joint]
                moving[joint] = np.sign(held)
            mode = self.next_mode(now, x, moving)
        return out

    def _ends(self, joint, mode):
        """Event at which a joint stops, or breaks away."""
        if mode[joint]:

            def event(t, x):
                return mode[joint] * x[2 + joint]

        else:

            def event(t, x):
                held = self.accelerations(t, x, mode)[1]
                return self.dry[joint] - abs(held[joint])

        event.terminal, event.direction = True, -1
        return event


def two_links(dt, dry=True, seconds=3.0):
    """Two links that swing, stick and break away."""
    truth = TwoLinks() if dry else TwoLinks(dry=(0.0, 0.0))
    n = round(seconds / dt) + 1
    t = dt * np.arange(n)
    q0, v0 = np.array([0.9, -0.4]), np.zeros(2)
    # without dry friction there is nothing to wait for
    exact = truth.solve(t, q0, v0) if dry else _smooth(truth, t, q0, v0)
    links = [
        (m, r, i, truth.length)
        for m, r, i in zip(truth.mass, truth.lever, truth.inertia)
    ]
    friction = {"viscous": np.array(truth.viscous)}
    if dry:
        friction["coulomb"] = np.array(truth.dry)
    robot = torque_model(pendulum(*links), friction=friction, dt=dt)
    states, work = timed(robot, truth.torques(t), q0, v0)
    return [
        (f"angle {j + 1}", "rad", largest(states[:, j] - exact[:, j])) for j in range(2)
    ], work


def _smooth(truth, t, q0, v0):
    """Positions (n, 2) without dry friction."""

    def rate(s, x):
        return np.r_[x[2:], np.linalg.solve(*truth.equations(s, x))]

    start = np.concatenate([q0, v0])
    return solve_ivp(rate, (t[0], t[-1]), start, "DOP853", t_eval=t, **TIGHT).y[:2].T


# -- many joints -----------------------------------------------------------------------


def inverse(dt, inertia=0.1, n_joints=6, seconds=2.0, seeds=4):
    """Inverse dynamics of the simulated states of chains with dry friction.

    Where a joint moves, they are the driving torques; where it rests, what dry
    friction has to hold is within its limit. Without the `inertia` of rotors the last
    bodies are so light that friction and torque decide their motion within
    milliseconds. The worst of as many chains as `seeds` says.
    """
    import pinocchio as pin

    moved, held, taken = [], [], []
    for seed in range(SEED, SEED + seeds):
        rng = np.random.default_rng(seed)
        model = chain(n_joints, rng)
        n = round(seconds / dt) + 1
        # corners fall on rows, so that torques are straight between them
        corners = np.linspace(0.0, seconds, 5)
        t = dt * np.arange(n)
        tau = np.column_stack(
            [np.interp(t, corners, 12.0 * rng.normal(size=5)) for _ in range(n_joints)]
        )
        viscous, dry, rotor = (np.full(n_joints, x) for x in (1.0, 4.0, inertia))
        friction = {"viscous": viscous, "coulomb": dry, "rotor_inertia": rotor}
        robot = torque_model(model, friction=friction, dt=dt)
        q0, v0 = rng.uniform(-1, 1, n_joints), np.zeros(n_joints)
        states, work = timed(robot, tau, q0, v0, rounds=1)
        data = model.createData()
        q, v, a = np.split(states, 3, axis=1)
        rest = tau - [pin.rnea(model, data, *row) for row in zip(q, v, a)]
        rest -= viscous * v + rotor * a
        moving = v != 0
        moved.append(largest((rest - dry * np.sign(v))[moving]))
        held.append(np.max((np.abs(rest) - dry)[~moving], initial=0.0))
        taken.append(work)
    return [
        ("torque where a joint moves", "N m", max(moved)),
        ("torque beyond what holds", "N m", max(held)),
    ], min(taken)


# -- energy ----------------------------------------------------------------------------


def energy(dt, n_joints, seconds=10.0):
    """Energy of a random chain without friction or torque."""
    import pinocchio as pin

    rng = np.random.default_rng(SEED + n_joints)
    model = chain(n_joints, rng)
    for j in range(n_joints):
        # with a lever, so that the last body too has a weight to lift
        lever = 0.2 * rng.normal(size=3)
        model.inertias[j + 1] = pin.Inertia(1.0, lever, 0.004 * np.eye(3))
    n = round(seconds / dt) + 1
    robot = torque_model(model, dt=dt)
    q0, v0 = rng.uniform(-1, 1, size=(2, n_joints))
    states, work = timed(robot, np.zeros((n, n_joints)), q0, v0, rounds=2)
    data = model.createData()
    kinetic, total = np.array(
        [
            (
                pin.computeKineticEnergy(model, data, q, v),
                pin.computeMechanicalEnergy(model, data, q, v),
            )
            for q, v in zip(states[:, :n_joints], states[:, n_joints : 2 * n_joints])
        ]
    ).T
    change = largest(total - total[0]) / kinetic.max()
    return [("energy, over the largest kinetic one", "", change, ENERGY)], work


# -- table -----------------------------------------------------------------------------

# Case -> function of the period.
CASES = {
    "mass stopped by Coulomb friction": stopping,
    "spring and Coulomb friction": ringing,
    "at rest, 97 % of breakaway": sticking,
    "at rest, 103 % of breakaway": breaking_away,
    "slide held on a driven one": carried,
    "slide carried away": lambda dt: carried(dt, push=12.0),
    "viscous decay, 5/s": lambda dt: decaying(dt, 5.0),
    "viscous decay, 1e5/s": lambda dt: decaying(dt, 1e5),
    "viscous creep, 1e5/s": lambda dt: creeping(dt, 1e5),
    "spring and friction of tanh, 1e-4 wide": stiff,
    "pendulum from 170 degrees": swinging,
    "two links, viscous friction": lambda dt: two_links(dt, dry=False),
    "two links, Coulomb friction": two_links,
    "six joints, dry friction, inverse dynamics": inverse,
    "the same without rotors": lambda dt: inverse(dt, inertia=0.0),
    **{
        f"{n} joints without friction, 10 s": lambda dt, n=n: energy(dt, n)
        for n in range(1, 8)
    },
}
HEADERS = ["case", "error of", "unit", "period [ms]", "error", "asked", "met", "us/row"]


def run(chosen=None, periods=PERIODS):
    """Yield the answers of the cases whose names hold `chosen`."""
    for name, figures in CASES.items():
        if chosen and not any(word in name for word in chosen):
            continue
        for dt in periods:
            yield from case(name, dt, lambda figures=figures, dt=dt: figures(dt))


def row(answer):
    """Row of the table."""
    asked = np.isfinite(answer.asked)
    return [
        answer.case,
        answer.message or answer.figure,
        answer.unit,
        f"{1e3 * answer.dt:g}",
        f"{answer.error:.1e}" if np.isfinite(answer.error) else "failed",
        f"{answer.asked:g}" if asked else "–",
        ("yes" if answer.error <= answer.asked else "no") if asked else "–",
        f"{1e6 * answer.work:.1f}" if np.isfinite(answer.work) else "–",
    ]


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--cases", nargs="*", default=None, help="words of names")
    arguments = arguments.parse_args(argv)
    answers = []
    for answer in run(arguments.cases):
        answers.append(answer)
        print(" | ".join(row(answer)), flush=True)
    text = "\n\n".join(
        [
            "Largest error over all rows of each simulation. Torques that change do so "
            "along a straight line. Chains have random axes, placements and starts, "
            f"seeds from {SEED} on; microseconds a row are processor time, the fastest "
            f"of up to {ROUNDS} runs.",
            rst_table([row(answer) for answer in answers], HEADERS, n_labels=3),
        ]
    )
    publish("simulation_accuracy", text, write=arguments.write)


if __name__ == "__main__":
    main()
