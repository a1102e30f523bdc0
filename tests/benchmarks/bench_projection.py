"""Projection on physically consistent parameters: time, and distance to the optimum.

Run as ``python tests/benchmarks/bench_projection.py``. Robots are made of point
masses and then spoiled by noise of the order of their parameters; the optimum comes
from cvxopt's cone solver, which shares nothing with the package. Then the certified gap
that clarabel reaches by itself, whatever the form that the programme is given in.
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


def _rods(seed, noise):
    """Bodies of two point masses each, hardly spoiled, and a metric."""
    add_root_to_path()
    from tests.physical._problems import metric, parameters_of, point_masses

    rng = np.random.default_rng(seed)
    bodies = [parameters_of(*point_masses(rng, 2)) for _ in range(3)]
    theta = np.concatenate([np.r_[phi, 0.1] for phi in bodies])
    theta = theta + noise * rng.normal(size=theta.size) * (np.abs(theta) + 0.2)
    return theta, metric(rng, theta.size, 1e4)


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


def report_forms(sizes=(1, 6, 10), condition=1e8, noise=1e-5, n_problems=6):
    """Table of certified gaps by form and settings of a conic solver."""
    from _conic_forms import FORMS, SETTINGS, programme, smallest_gap

    seeds = range(_SEED, _SEED + n_problems)
    groups = {
        f"{n} bodies": [_problem(n, seed, condition) for seed in seeds] for n in sizes
    }
    groups["3 rods"] = [_rods(seed, noise) for seed in seeds]
    stated = [
        [one for theta, A in group if (one := programme(theta, A))]
        for group in groups.values()
    ]
    rows = []
    for form in FORMS:
        for settings in SETTINGS:
            gaps = [
                np.max([smallest_gap(one, form, settings) for one in group])
                for group in stated
            ]
            rows.append([form, settings, *(f"{gap:.0e}" for gap in gaps)])
    own = [
        max(project(theta, A).relative_gap for theta, A in group)
        for group in groups.values()
    ]
    rows.append(["package", "", *(f"{gap:.0e}" for gap in own)])
    table = rst_table(rows, ["form", "settings", *groups], n_labels=2)
    return (
        f"{table}\n\nLargest certified gap, relative to the squared distance, of "
        f"{n_problems} problems; metrics of condition {condition:.0e}, that of the "
        f"rods 1e+04 with noise of {noise:.0e}. clarabel solves each problem twice, "
        "the second time in units of the distance found. Forms of the distance "
        "(the norm of T x - c): the quadratic form T'T, the residual as unknowns of "
        "its own, a second-order cone, a rotated one, and the unknowns T x - c. The "
        "settings: its "
        "tolerances of 1e-8; 1e-13; with its iterative refinement to 1e-15 besides; "
        "without equilibration; with a regularisation of 1e-12 instead of 1e-8. nan is "
        "no answer."
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0]).parse_args(argv)
    text = f"{report()}\n\n{report_forms()}"
    publish("projection", text, write=arguments.write)


if __name__ == "__main__":
    main()
