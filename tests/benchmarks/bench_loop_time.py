"""How long the loop takes: six joints for 60 s, and 60 joints that fit poorly.

Run ``python tests/benchmarks/bench_loop_time.py [--cases NAME ...] [--write]``.

Data, all at 200 Hz, seeds as given:

- ``demo``: one motion of 60 s of the demo arm with an undeclared load friction
  (``make_robot_recording``, seed 0); viscous and Coulomb friction declared.
- ``whole robot``: two recordings of 30 s of six joints with friction and further
  effects everywhere (``_undeclared_whole.py``, seed 0); viscous friction declared.
- ``12 joints``, ``60 joints``: two and ten arms of six joints on one base for 15 s
  (seed 0), viscous friction declared. Every joint also has Coulomb friction, and two
  torques that no effect of the library has, each five times the noise of 3 %: a product
  of its speed with the neighbour's angle, and a sine in time whose frequency rises.

All effects of the library are looked for. The time is that of ``EffectDiscovery.fit``
alone, in a process that has fitted a short recording before, the smallest of
``--repeat``. Beside it
stand the processor time, which a busy machine leaves as it is, and how much of the time
the check of the channels took, which looks for swapped and misplaced ones where a model
fits poorly. Targets on two cores: 10 s for six joints, 60 s for 60 joints.
"""

import functools
import sys
import time
import warnings
from dataclasses import dataclass
from unittest import mock

import numpy as np
from _report import parser, publish, rst_table
from _undeclared_robots import Motion, inverse_dynamics, nominal_robot, true_robot
from _undeclared_whole import whole_robot

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.diagnosis import _discovery

DT = 0.005
SEED = 0
NOISE = 0.03
STRANGE = 5.0
TARGET, MANY_TARGET = 10.0, 60.0


@dataclass(frozen=True, eq=False)
class Timed:
    """A recording to close the loop on.

    Attributes
    ----------
    model : pinocchio.Model
        Robot as declared.
    q, tau : ndarray of shape (n, nv)
        Positions and torques.
    groups : ndarray of shape (n,)
        Labels.
    friction : tuple of str
        Declared friction.
    """

    model: object
    q: np.ndarray
    tau: np.ndarray
    groups: np.ndarray
    friction: tuple


def demo(seconds=60.0):
    """Return the demo arm in one motion."""
    recording = make_robot_recording(
        duration=seconds,
        dt=DT,
        frequency=1.0,
        undeclared={"load_friction": (1, 0.11)},
        random_state=SEED,
    )
    declared = ("viscous", "coulomb")
    model = recording.robot_model()
    return Timed(model, recording.q, recording.tau, recording.groups, declared)


def whole(seconds=60.0):
    """Return a whole robot in two motions."""
    robot = whole_robot(SEED, seconds / 2)
    return Timed(robot.model, robot.q, robot.tau, robot.groups, ("viscous",))


def _arms(count, rng):
    """Return a robot of several serial arms of six joints on one base."""
    import pinocchio as pin

    model = pin.Model()
    for k in range(count):
        arm = nominal_robot("serial", rng, 6)
        last = 0
        for i in range(1, arm.njoints):
            last = model.addJoint(
                last, arm.joints[i], arm.jointPlacements[i], f"arm_{k}_{arm.names[i]}"
            )
            inertia = arm.inertias[i]
            model.appendBodyToJoint(last, inertia, pin.SE3.Identity())
    return model


def many(seconds=15.0, arms=10):
    """Return many joints with torques that no effect explains."""
    rng = np.random.default_rng(SEED)
    nominal = _arms(arms, rng)
    model, nv = true_robot(nominal, rng), nominal.nv
    t = DT * np.arange(round(seconds / DT))
    frequency = rng.uniform(0.2, 1.0, size=(nv, 5))
    amplitude = 0.25 / frequency * rng.uniform(0.5, 1.0, size=(nv, 5))
    phase = rng.uniform(0.0, 2.0 * np.pi, size=(nv, 5))
    motion = Motion(rng.uniform(-1, 1, size=nv), amplitude, frequency, phase)
    q, v, a = motion.at(t)
    tau = inverse_dynamics(model, q, v, a)
    spread = tau.std(axis=0)
    tau = tau + 0.15 * spread * (v / v.std(axis=0) + np.tanh(v / 0.01))
    sweep = np.sin(2 * np.pi * (0.3 + 2.0 * t / seconds) * t)
    strange = v * (np.roll(q, 1, axis=1) - q.mean(axis=0)), np.tile(sweep, (nv, 1)).T
    noise = NOISE * spread
    for torque in strange:
        tau = tau + STRANGE * noise * torque / torque.std(axis=0)
    tau = tau + noise * rng.normal(size=tau.shape)
    q = q + 1e-4 * rng.normal(size=q.shape)
    return Timed(nominal, q, tau, np.zeros(t.size, dtype=int), ("viscous",))


CASES = {
    "demo": demo,
    "whole robot": whole,
    "12 joints": functools.partial(many, arms=2),
    "60 joints": many,
}


def measure(case, repeat=1, **settings):
    """Return the loop, its time, its processor time and that of the channels [s].

    Parameters
    ----------
    case : Timed
        Recording.
    repeat : int, default=1
        The smallest of so many times is taken.
    **settings
        Further parameters of `EffectDiscovery`.
    """
    times = []
    for _ in range(repeat):
        identifier = RobotIdentifier(case.model, dt=DT, friction=case.friction)
        loop = EffectDiscovery(identifier, random_state=0, **settings)
        inspected = []

        inspects = _discovery.inspect_channels

        def timed(*given, inspected=inspected, inspects=inspects, **known):
            begun = time.perf_counter()
            found = inspects(*given, **known)
            inspected.append(time.perf_counter() - begun)
            return found

        started, used = time.perf_counter(), time.process_time()
        with (
            warnings.catch_warnings(),
            mock.patch.object(_discovery, "inspect_channels", timed),
        ):
            warnings.simplefilter("ignore", UserWarning)
            loop.fit(case.q, case.tau, groups=case.groups)
        seconds = time.perf_counter() - started
        times.append((seconds, time.process_time() - used, sum(inspected)))
    return loop, *min(times)


def row(name, case, loop, seconds, processor, channels):
    """Row of the table."""
    nv = case.q.shape[1]
    target = TARGET if nv <= 6 else MANY_TARGET
    return [
        name,
        nv,
        f"{len(case.q) * DT:.0f}",
        len(loop.effects_),
        len(loop.unexplained_),
        f"{100 * np.mean(loop.error_before_):.1f}",
        f"{100 * np.mean(loop.error_after_):.1f}",
        f"{seconds:.1f}",
        f"{processor:.1f}",
        f"{channels:.1f}",
        f"{target:.0f}",
    ]


HEADERS = [
    "robot",
    "joints",
    "recording [s]",
    "effects found",
    "joints above floor",
    "mean before [%]",
    "mean after",
    "time [s]",
    "processor time",
    "channels",
    "target",
]


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    arguments.add_argument("--repeat", type=int, default=1)
    arguments = arguments.parse_args(argv)
    # what is imported or compiled once is not the loop's time
    measure(demo(4.0), effects=["coulomb"], max_effects=1)
    rows = []
    for name in arguments.cases:
        case = CASES[name]()
        rows.append(row(name, case, *measure(case, arguments.repeat)))
        print(" | ".join(map(str, rows[-1])), file=sys.stderr, flush=True)
    publish("loop_time", rst_table(rows, HEADERS, n_labels=1), write=arguments.write)


if __name__ == "__main__":
    main()
