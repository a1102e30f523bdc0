"""Time of the regressor matrices and of inverse dynamics, beside Pinocchio in a loop.

Run as ``python tests/benchmarks/bench_features.py``. Both see the same motion of the
same robot in the same process, on one core, in turns; ratios are taken within a round,
so that a busy machine slows both sides. Then a robot of ten joints is identified from
half a million samples, on one core and on two, and the embedded recording in processes
of their own; ``--fit`` does the former alone.
"""

import itertools
import multiprocessing
import subprocess
import sys
import time
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from _report import parser, publish, rst_table
from threadpoolctl import threadpool_limits

from sklearn_vbjfa import RigidBodyFeatures, RobotIdentifier
from sklearn_vbjfa.model import TreeRegressor

_SEED = 0
_JOINTS = (1, 6, 7, 10, 20, 50)
# Numbers in an array of regressor matrices.
_OUTPUT = 4_000_000
_MAX_SAMPLES = 10_000
# Which task is compared with which.
RIVALS = ((0, 1), (2, 3))
HEADERS = [
    "joints",
    "samples",
    "regressor, loop [us]",
    "compiled [us]",
    "ratio",
    "torques, loop [us]",
    "compiled [us]",
    "ratio",
]
FIT_HEADERS = ["cores", "", "time [s]", "by sample [us]", "over the bare loop"]
_FIT_JOINTS, _FIT_SAMPLES, _FIT_ROUNDS, _FIT_CORES = 10, 500_000, 5, (1, 2)
ENTERS = ("sklearn_vbjfa.datasets.load_demo_recording",)  # by the next text
# One fit of the embedded recording; without Numba where it is told so.
_DEMO = """
import sys, warnings
if {hidden}:
    sys.modules["numba"] = None
from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import load_demo_recording
warnings.simplefilter("ignore")
recording = load_demo_recording()
RobotIdentifier(recording.urdf, dt=recording.dt).fit(recording.q, recording.tau)
"""


def chain(n_joints, rng):
    """Arm of revolute joints about x, y and z in turn, placed at random."""
    import pinocchio as pin

    model = pin.Model()
    kinds = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)
    for j in range(n_joints):
        rotation = pin.Quaternion(*rng.normal(size=4)).normalized()
        placement = pin.SE3(rotation, 0.3 * rng.normal(size=3))
        number = model.addJoint(j, kinds[j % 3](), placement, f"joint_{j}")
        model.inertias[number] = pin.Inertia.FromSphere(1.0, 0.1)
    return model


def loop_regressor(model, zeros, X):
    """Regressor matrices as transform returns them, sample by sample."""
    import pinocchio as pin

    n, nv = X.shape[0], model.nv
    q, v, a = X[:, :nv], X[:, nv : 2 * nv], X[:, 2 * nv :]
    data = model.createData()
    Phi = np.zeros((n, nv, nv, 10))
    for i in range(n):
        regressor = pin.computeJointTorqueRegressor(model, data, q[i], v[i], a[i])
        Phi[i] = regressor.reshape(nv, nv, 10)
    Phi[:, zeros] = 0.0
    return Phi.reshape(n, -1)


def loop_torques(model, X):
    """Inverse dynamics sample by sample."""
    import pinocchio as pin

    nv = model.nv
    q, v, a = X[:, :nv], X[:, nv : 2 * nv], X[:, 2 * nv :]
    data = model.createData()
    tau = np.empty(q.shape)
    for i in range(q.shape[0]):
        tau[i] = pin.rnea(model, data, q[i], v[i], a[i])
    return tau


def measure(n_joints, n_samples, rounds):
    """Seconds (rounds, 4) of regressors (loop, compiled) and torques (the same)."""
    rng = np.random.default_rng(_SEED)
    model = chain(n_joints, rng)
    X = rng.normal(size=(n_samples, 3 * n_joints))
    states = np.split(X, 3, axis=1)
    features = RigidBodyFeatures(model, friction=()).fit(X)
    tree = TreeRegressor(model)
    inertial = np.array([body.toDynamicParameters() for body in model.inertias[1:]])
    tasks = (
        lambda: loop_regressor(model, ~tree.support, X),
        lambda: features.transform(X),
        lambda: loop_torques(model, X),
        lambda: tree.torques(*states, inertial),
    )
    for reference, k in RIVALS:
        expected, actual = tasks[reference](), tasks[k]()
        size = np.abs(expected).max()
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-10 * size)
        del expected, actual
    return timed(tasks, rounds)


def timed(tasks, rounds):
    """Seconds (rounds, n_tasks) of tasks that take turns."""
    seconds = np.empty((rounds, len(tasks)))
    for k in range(rounds):
        for i, task in enumerate(tasks):
            started = time.perf_counter()
            task()
            seconds[k, i] = time.perf_counter() - started
    return seconds


def report(joints=_JOINTS, max_samples=_MAX_SAMPLES, rounds=9):
    """Table over numbers of joints."""
    rows = []
    for n_joints in joints:
        n_samples = min(_OUTPUT // (10 * n_joints**2), max_samples)
        with threadpool_limits(1):
            seconds = measure(n_joints, n_samples, rounds)
        each = 1e6 * np.median(seconds, axis=0) / n_samples
        row = [n_joints, n_samples]
        for reference, k in RIVALS:
            ratio = np.median(seconds[:, reference] / seconds[:, k])
            row += [f"{each[reference]:.2f}", f"{each[k]:.2f}", f"{ratio:.1f}"]
        rows.append(row)
    return (
        f"{rst_table(rows, HEADERS)}\n\nMicroseconds for each sample on one core; arms "
        f"of revolute joints, seed {_SEED}. The loops call Pinocchio once for each "
        "sample: ``computeJointTorqueRegressor``, with what ``RigidBodyFeatures`` adds "
        "to it, and ``rnea``. The compiled loop needs Numba and is used where that is "
        "installed, else Pinocchio's; its first use after an installation takes some "
        f"seconds more. Times and ratios are medians of {rounds} rounds in one "
        "process; both include the memory of the result."
    )


def motion(n_samples, n_joints, rng, dt=1e-3):
    """Positions, velocities, accelerations (n, nv) of sums of slow sines."""
    t = np.arange(n_samples) * dt
    states = np.zeros((3, n_samples, n_joints))
    for j in range(n_joints):
        for _ in range(5):
            f = rng.uniform(0.1, 2.0)
            size, phase = rng.uniform(0.1, 0.5) / f, rng.uniform(0, 2 * np.pi)
            w = 2 * np.pi * f
            sine, cosine = np.sin(w * t + phase), np.cos(w * t + phase)
            states[0, :, j] += size * sine
            states[1, :, j] += size * w * cosine
            states[2, :, j] -= size * w * w * sine
    return states


def call_loop(model, states):
    """Call Pinocchio once for each of some states (n, 3 nv), and keep nothing."""
    import pinocchio as pin

    data = model.createData()
    for row in zip(*np.split(states, 3, axis=1)):
        pin.computeJointTorqueRegressor(model, data, *row)


class Loops:
    """The bare loop over some states, divided among one or two processes."""

    # A loop keeps the interpreter to itself: threads would take turns. The processes
    # have the states before a clock runs, and nothing comes back.
    _made = None

    def __init__(self, model, X, cores):
        Loops._made = model, np.array_split(X, cores)
        self.cores = cores
        self._pool = multiprocessing.get_context("fork").Pool(cores)

    @staticmethod
    def _run(k):
        model, parts = Loops._made
        call_loop(model, parts[k])

    def __enter__(self):
        return lambda: self._pool.map(self._run, range(self.cores), chunksize=1)

    def __exit__(self, *_):
        self._pool.terminate()
        self._pool.join()


def recorded(model, n_samples, rng):
    """States and torques of drawn states, and positions and torques of a motion."""
    n_joints = model.nv
    X = rng.normal(size=(n_samples, 3 * n_joints))
    matrices = TreeRegressor(model)
    inertial = np.array([body.toDynamicParameters() for body in model.inertias[1:]])

    def torque(q, v, a):
        clean = matrices.torques(q, v, a, inertial) + 0.1 * v
        return clean + 0.1 * rng.normal(size=v.shape)

    given = X, torque(*np.split(X, 3, axis=1))
    moved = motion(n_samples, n_joints, rng)
    q = moved[0] + 1e-4 * rng.normal(size=moved[0].shape)
    return given, (q, torque(*moved))


def measure_fit(model, given, moved, cores, rounds):
    """Seconds (rounds, 4) of the loop, the regressors and two fits, on some cores."""
    X, n_joints = given[0], model.nv
    matrices = TreeRegressor(model)
    states = np.split(X, 3, axis=1)
    # As many rows at a time as a fit makes.
    count = max(1, (4 << 20) // (80 * n_joints**2))

    def regressor(rows):
        for i in range(*rows.indices(X.shape[0])[:2], count):
            matrices(*(x[i : min(i + count, rows.stop)] for x in states))

    ends = np.linspace(0, X.shape[0], cores + 1).astype(int).tolist()
    shares = [slice(*pair) for pair in itertools.pairwise(ends)]

    def fit(X, torque):
        with warnings.catch_warnings():
            # The rows of given states are no motion.
            warnings.simplefilter("ignore", UserWarning)
            RobotIdentifier(model, dt=1e-3, friction=("viscous",), n_jobs=cores).fit(
                X, torque
            )

    with (
        Loops(model, X, cores) as loop,
        ThreadPoolExecutor(cores) as threads,
        threadpool_limits(1),
    ):
        tasks = (
            loop,
            lambda: list(threads.map(regressor, shares)),
            lambda: fit(*given),
            lambda: fit(*moved),
        )
        return timed(tasks, rounds)


def report_fit(
    n_joints=_FIT_JOINTS, n_samples=_FIT_SAMPLES, rounds=_FIT_ROUNDS, cores=_FIT_CORES
):
    """Table of a whole fit beside the bare loop over its samples."""
    rng = np.random.default_rng(_SEED)
    model = chain(n_joints, rng)
    recordings = recorded(model, n_samples, rng)
    names = (
        "bare loop",
        "regressor matrices",
        "RobotIdentifier.fit, states given",
        "RobotIdentifier.fit, from positions",
    )
    rows = []
    for used in cores:
        seconds = measure_fit(model, *recordings, used, rounds)
        for k, name in enumerate(names):
            taken = np.median(seconds[:, k])
            ratio = np.median(seconds[:, k] / seconds[:, 0])
            each = 1e6 * taken / n_samples
            label = "" if k else used
            rows.append([label, name, f"{taken:.2f}", f"{each:.2f}", f"{ratio:.2f}"])
    return (
        f"{rst_table(rows, FIT_HEADERS, n_labels=2)}\n\n{n_samples} samples of "
        f"{n_joints} joints, as states, or as positions with 0.1 mrad of noise, of "
        "which the regressors are made twice, from the even and from the odd samples; "
        "the bare loop only calls Pinocchio's ``computeJointTorqueRegressor``, in one "
        "process for each core. On several cores ``n_jobs`` is as many; the linear "
        "algebra has one thread. "
        f"Medians of {rounds} rounds in one process, in turns."
    )


def report_demo(rounds=5):
    """Sentence on processes that identify the embedded recording, start to end."""
    seconds = timed(
        [
            lambda hidden=hidden: subprocess.run(
                [sys.executable, "-c", _DEMO.format(hidden=hidden)], check=True
            )
            for hidden in (False, True)
        ],
        rounds,
    )
    fast, slow = np.median(seconds, axis=0)
    return (
        f"A process that identifies the embedded recording of 8000 samples of 6 joints "
        f"takes {fast:.1f} s from start to end with Numba and {slow:.1f} s without, "
        f"medians of {rounds}."
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--rounds", type=int, default=9)
    arguments.add_argument("--fit", action="store_true", help="time the fit alone")
    arguments = arguments.parse_args(argv)
    if arguments.fit:
        print(report_fit())
        return
    parts = report(rounds=arguments.rounds), report_fit(), report_demo()
    publish("features", "\n\n".join(parts), write=arguments.write)


if __name__ == "__main__":
    main()
