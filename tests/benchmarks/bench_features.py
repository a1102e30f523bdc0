"""Time of the regressor matrices and of inverse dynamics, beside Pinocchio in a loop.

Run as ``python tests/benchmarks/bench_features.py``. Both see the same motion of the
same robot in the same process, on one core, in turns; ratios are taken within a round,
so that a busy machine slows both sides.
"""

import time

import numpy as np
from _report import parser, publish, rst_table
from threadpoolctl import threadpool_limits

from sklearn_vbjfa import RigidBodyFeatures
from sklearn_vbjfa.model._regressor import TreeRegressor

_SEED = 0
_JOINTS = (1, 6, 7, 10, 20, 50)
# Numbers in an array of regressor matrices.
_OUTPUT = 4_000_000
_MAX_SAMPLES = 10_000
# Which task is compared with which.
RIVALS = ((0, 1), (0, 2), (3, 4))
HEADERS = [
    "joints",
    "samples",
    "regressor, loop [us]",
    "NumPy [us]",
    "ratio",
    "compiled [us]",
    "ratio",
    "torques, loop [us]",
    "NumPy [us]",
    "ratio",
]


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
    """Seconds (rounds, 5) of regressors (loop, NumPy, compiled), torques (two)."""
    rng = np.random.default_rng(_SEED)
    model = chain(n_joints, rng)
    X = rng.normal(size=(n_samples, 3 * n_joints))
    states = np.split(X, 3, axis=1)
    plain = RigidBodyFeatures(model, friction=()).fit(X)
    features = RigidBodyFeatures(model, friction=()).fit(X)
    plain._regressor = TreeRegressor(model, compiled=False)
    features._regressor = TreeRegressor(model, compiled=True)
    tree = TreeRegressor(model)
    inertial = np.array([body.toDynamicParameters() for body in model.inertias[1:]])
    tasks = (
        lambda: loop_regressor(model, features._zeros, X),
        lambda: plain.transform(X),
        lambda: features.transform(X),
        lambda: loop_torques(model, X),
        lambda: tree.torques(*states, inertial),
    )
    for reference, k in RIVALS:
        expected, actual = tasks[reference](), tasks[k]()
        size = np.abs(expected).max()
        np.testing.assert_allclose(actual, expected, rtol=0, atol=1e-10 * size)
        del expected, actual
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
            row += [f"{each[reference]:.2f}"] if k == reference + 1 else []
            row += [f"{each[k]:.2f}", f"{ratio:.1f}"]
        rows.append(row)
    return (
        f"{rst_table(rows, HEADERS)}\n\nMicroseconds for each sample on one core; arms "
        f"of revolute joints, seed {_SEED}. The loops call Pinocchio once for each "
        "sample: ``computeJointTorqueRegressor``, with what ``RigidBodyFeatures`` adds "
        "to it, and ``rnea``. The compiled loop needs Numba and is used where that is "
        "installed; its first use after an installation takes some seconds more. Times "
        f"and ratios are medians of {rounds} rounds in one process; both include the "
        "memory of the result."
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--rounds", type=int, default=9)
    arguments = arguments.parse_args(argv)
    publish("features", report(rounds=arguments.rounds), write=arguments.write)


if __name__ == "__main__":
    main()
