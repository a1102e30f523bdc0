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
_ANCHOR_WEIGHT = 1e-8


def _problem(n_bodies, seed, condition):
    """Inconsistent parameters of a robot, and a metric."""
    add_root_to_path()
    from tests.physical._problems import metric, robot

    rng = np.random.default_rng([seed, n_bodies])
    theta = robot(rng, n_bodies)
    theta = theta + 0.5 * rng.normal(size=theta.size) * (np.abs(theta) + 0.2)
    return theta, metric(rng, theta.size, condition)


def _regularised(A, n_features):
    """Add the anchor's share to the metric, in the documented units."""
    diagonal = np.diag(A)
    friction = np.arange(10, n_features, 11)
    bodies = np.setdiff1d(np.arange(n_features), friction)
    largest = diagonal[bodies].max()
    units = np.ones(n_features)
    units[friction] = np.sqrt(largest / diagonal[friction])
    return A + _ANCHOR_WEIGHT * np.diag(largest / units**2), friction


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
        full, friction = _regularised(A, theta.size)
        started = time.perf_counter()
        _, optimum = cvxopt_projection(
            theta,
            full,
            "pseudo-inertia",
            np.arange(0, theta.size, 11),
            friction,
            floor=_FLOOR,
        )
        other_times.append(1e3 * (time.perf_counter() - started))
        step = result.theta - theta
        excesses.append((step @ full @ step) / optimum - 1)
        certified.append(result.relative_gap)
    return [
        n_bodies,
        11 * n_bodies,
        float(np.median(times)),
        float(np.median(other_times)),
        float(np.max(excesses)),
        float(np.max(certified)),
    ]


def report(sizes=(1, 6, 10), n_problems=20):
    """Table of all sizes."""
    rows = [measure(n_bodies, n_problems=n_problems) for n_bodies in sizes]
    for row in rows:
        row[2:4] = fixed(row[2:4])
        row[4:] = [f"{value:.1e}" for value in row[4:]]
    table = rst_table(
        rows,
        [
            "bodies",
            "parameters",
            "project [ms]",
            "cvxopt, two passes [ms]",
            "largest excess",
            "largest certified gap",
        ],
    )
    return (
        f"{table}\n\n{n_problems} problems a row, pseudo-inertia constraint, metric of "
        f"condition 1e4, seeds from {_SEED}. Times are medians. The excess is that of "
        "the squared distance over cvxopt's, relative; a negative one is cvxopt's own "
        "tolerance. The certified gap is the package's own bound on it."
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0]).parse_args(argv)
    publish("projection", report(), write=arguments.write)


if __name__ == "__main__":
    main()
