"""Projection on physically consistent parameters: time, and distance to the optimum.

Run as ``python tests/benchmarks/bench_projection.py``. Robots are made of point
masses and then spoiled by noise of the order of their parameters; the optimum comes
from cvxopt's cone solver, which shares nothing with the package.
"""

import time

import numpy as np
from _report import add_root_to_path, fixed, parser, publish, rst_table

from sklearn_vbjfa.physical import project

_SEED = 0
_FLOOR = 1e-6


def _problem(n_bodies, seed, condition):
    """Inconsistent parameters of a robot, and a metric."""
    add_root_to_path()
    from tests.physical._problems import metric, robot

    rng = np.random.default_rng([seed, n_bodies])
    theta = robot(rng, n_bodies)
    theta = theta + 0.5 * rng.normal(size=theta.size) * (np.abs(theta) + 0.2)
    return theta, metric(rng, theta.size, condition)


def measure(n_bodies, *, n_problems, condition=1e4):
    """Median time [ms], and the largest excess over cvxopt's squared distance."""
    add_root_to_path()
    from tests.physical._problems import cvxopt_projection

    times, other_times, excesses, certified = [], [], [], []
    for seed in range(_SEED, _SEED + n_problems):
        theta, A = _problem(n_bodies, seed, condition)
        started = time.perf_counter()
        result = project(
            theta,
            A,
            parameters_per_joint=11,
            margin=_FLOOR,
            mass_scale=1.0,
            length_scale=1.0,
        )
        times.append(1e3 * (time.perf_counter() - started))
        friction = np.arange(10, theta.size, 11)
        started = time.perf_counter()
        _, optimum = cvxopt_projection(
            theta,
            A,
            "pseudo-inertia",
            np.arange(0, theta.size, 11),
            friction,
            floor=_FLOOR,
        )
        other_times.append(1e3 * (time.perf_counter() - started))
        step = result.theta - theta
        excesses.append((step @ A @ step) / optimum - 1)
        certified.append(result.relative_gap)
    return [
        n_bodies,
        f"{condition:.0e}",
        float(np.median(times)),
        float(np.median(other_times)),
        float(np.max(excesses)),
        float(np.max(certified)),
    ]


def report(sizes=(1, 6, 10), conditions=(1e4, 1e8, 1e11), n_problems=20):
    """Table of all sizes and conditions."""
    rows = [
        measure(n_bodies, n_problems=n_problems, condition=condition)
        for n_bodies in sizes
        for condition in conditions
    ]
    for row in rows:
        row[2:4] = fixed(row[2:4])
        row[4:] = [f"{value:.1e}" for value in row[4:]]
    table = rst_table(
        rows,
        [
            "bodies",
            "condition",
            "project [ms]",
            "cvxopt, two passes [ms]",
            "largest excess",
            "largest certified gap",
        ],
    )
    return (
        f"{table}\n\n{n_problems} problems a row, eleven parameters a body, "
        "pseudo-inertia constraint, metric of full rank and the condition number "
        f"given, seeds from {_SEED}. Times are medians. The excess is that of "
        "the squared distance over cvxopt's, relative; a negative one is cvxopt's own "
        "tolerance. The certified gap is the package's own bound on it."
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0]).parse_args(argv)
    publish("projection", report(), write=arguments.write)


if __name__ == "__main__":
    main()
