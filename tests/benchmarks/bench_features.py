"""Time of an identification beside a bare loop over Pinocchio's regressor.

Run as ``python tests/benchmarks/bench_features.py [--rounds N] [--write]``. A robot of
ten joints is identified from half a million samples, from given states and from
positions, in turns with a loop that calls ``computeJointTorqueRegressor`` in as many
processes as cores and keeps nothing; ratios are taken within a round, so that a busy
machine slows both.
"""

import time
import warnings
from multiprocessing import Process

import numpy as np
from _report import parser, publish, rst_table
from _undeclared_robots import inverse_dynamics, nominal_robot
from threadpoolctl import threadpool_limits

from sklearn_vbjfa import RobotIdentifier

DT, SEED = 1e-3, 0
JOINTS, SAMPLES = 10, 500_000
HEADERS = ["cores", "", "time [s]", "by sample [us]", "over the bare loop"]


def motion(n_samples, n_joints, rng):
    """States (n, 3 nv) of sums of slow sines."""
    t = np.arange(n_samples) * DT
    states = np.zeros((3, n_samples, n_joints))
    for j in range(n_joints):
        for _ in range(5):
            w = 2 * np.pi * rng.uniform(0.1, 2.0)
            size, phase = rng.uniform(1.0, 3.0) / w, rng.uniform(0, 2 * np.pi)
            sine, cosine = np.sin(w * t + phase), np.cos(w * t + phase)
            states[:, :, j] += size * np.array([sine, w * cosine, -w * w * sine])
    return np.hstack(list(states))


def bare_loop(model, X, cores=1):
    """Call Pinocchio once for each state, in as many processes as cores."""
    import pinocchio as pin

    if cores > 1:
        rows = [(model, part) for part in np.array_split(X, cores)]
        several = [Process(target=bare_loop, args=own) for own in rows]
        for one in several:
            one.start()
        for one in several:
            one.join()
        return
    data = model.createData()
    for row in zip(*np.split(X, 3, axis=1)):
        pin.computeJointTorqueRegressor(model, data, *row)


def fit(model, X, tau, cores):
    """Identify the robot."""
    robot = RobotIdentifier(model, dt=DT, friction=("viscous",), n_jobs=cores)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        robot.fit(X, tau)


def report(n_joints=JOINTS, n_samples=SAMPLES, rounds=5, cores=(1, 2)):
    """Table of fits beside the bare loop."""
    rng = np.random.default_rng(SEED)
    model = nominal_robot("serial", rng, n_joints)
    X = motion(n_samples, n_joints, rng)
    q, v, a = np.split(X, 3, axis=1)
    tau = inverse_dynamics(model, q, v, a) + 0.1 * v + 0.1 * rng.normal(size=v.shape)
    noisy = q + 1e-4 * rng.normal(size=q.shape)
    tasks, bare = {}, []
    for n in cores:
        bare.append(len(tasks))
        tasks[str(n), "bare loop"] = lambda n=n: bare_loop(model, X, n)
        for words, given in (("states given", X), ("from positions", noisy)):
            label = str(n), f"RobotIdentifier.fit, {words}"
            tasks[label] = lambda given=given, n=n: fit(model, given, tau, n)
    seconds = np.empty((rounds, len(tasks)))
    with threadpool_limits(1):
        for k in range(rounds):
            for j, task in enumerate(tasks.values()):
                started = time.perf_counter()
                task()
                seconds[k, j] = time.perf_counter() - started
    own = np.repeat(bare, len(tasks) // len(cores))
    ratios = np.median(seconds / seconds[:, own], axis=0)
    rows = [
        [*label, f"{taken:.2f}", f"{1e6 * taken / n_samples:.2f}", f"{ratio:.2f}"]
        for label, taken, ratio in zip(tasks, np.median(seconds, axis=0), ratios)
    ]
    return (
        f"{rst_table(rows, HEADERS, n_labels=2)}\n\n{n_samples} samples of {n_joints} "
        "joints, as states, or as positions with 0.1 mrad of noise, of which the "
        "regressors are made twice, from the even and from the odd samples. Medians of "
        f"{rounds} rounds, in turns."
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__)
    arguments.add_argument("--rounds", type=int, default=5)
    arguments = arguments.parse_args(argv)
    if arguments.quick:
        text = report(2, 5_000, 1, (1,))
    else:
        text = report(rounds=arguments.rounds)
    publish("features", text, arguments)


if __name__ == "__main__":
    main()
