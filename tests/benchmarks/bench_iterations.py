"""Iterations of the plain and of the accelerated solvers to the same bound.

Run ``python tests/benchmarks/bench_iterations.py [--trials 1] [--write]``. The cells
are those of the synthetic study. An iteration is one evaluation of the bound with its
expectations, also where the step that asked for it is not kept.
"""

import functools
import warnings
from unittest import mock

import numpy as np
from _report import parser, publish, rst_table
from bench_synthetic import CELLS

from sklearn_vbjfa import JFARegressor, VBJFARegressor
from sklearn_vbjfa._core import _correlated, _solver
from sklearn_vbjfa.datasets import make_noisy_regression

# Both count until they are this close, per sample, to the lower of their last bounds.
CLOSE = 1e-6
# The plain iteration ends where it gains less than this per sample.
PLAIN_GAIN = 1e-10
PLAIN_MOST = 30_000

MODELS = {
    "JFA": JFARegressor(),
    "VB, independent": VBJFARegressor(latent="independent"),
    "VB, paper": VBJFARegressor(latent="independent", prior="paper"),
    "VB, correlated": VBJFARegressor(latent="correlated"),
}


def first_at(evaluations, history, target):
    """Return the evaluations after which the bound has reached the target."""
    return int(np.asarray(evaluations)[np.flatnonzero(history >= target)[0]])


def compare_independent(moments, state, prior, **options):
    """(plain, accelerated) evaluations to the common bound, and those until the end."""
    used = []
    evaluate = _solver.evaluate

    def counted(*args):
        point = evaluate(*args)
        used.append(point.value)
        return point

    with mock.patch.object(_solver, "evaluate", counted):
        fast = _solver.solve(moments, state, prior, **options)
    # The evaluation at which each kept bound was found.
    values = np.array(used)
    at = [int(np.flatnonzero(values == value)[0]) + 1 for value in fast.history]
    goal = fast.history[-1] - CLOSE * moments.n
    plain = []
    while len(plain) < PLAIN_MOST:
        point = _solver.evaluate(moments, state, prior)
        gain = point.value - plain[-1] if plain else np.inf
        plain.append(point.value)
        if point.value >= goal or gain <= PLAIN_GAIN * moments.n:
            break
        state = _solver.plain_step(moments, point, prior)
    plain = np.array(plain)
    target = min(goal, plain[-1] - CLOSE * moments.n)
    assert np.diff(fast.history).min() >= 0
    assert np.diff(plain).min() >= -1e-9 * abs(plain[-1])
    counts = (
        first_at(np.arange(plain.size) + 1, plain, target),
        first_at(at, fast.history, target),
    )
    higher = (fast.history[-1] - plain[-1]) / moments.n
    return fast, (*counts, fast.n_iter, higher)


def compare_correlated(*args, solver, **options):
    """Compare like `compare_independent`, for one fit of the correlated model."""
    n = args[0].n
    fast = solver(*args, **options)
    options |= {"tol": PLAIN_GAIN, "max_iter": PLAIN_MOST, "accelerate": False}
    plain = solver(*args, **options)
    target = min(fast.history[-1], plain.history[-1]) - CLOSE * n
    assert np.diff(fast.history).min(initial=0.0) >= -1e-9 * n
    lost = fast.n_iter - fast.history.size  # joint steps that were not kept
    counts = (
        first_at(np.arange(plain.history.size) + 1, plain.history, target),
        lost + first_at(np.arange(fast.history.size) + 1, fast.history, target),
    )
    higher = (fast.history[-1] - plain.history[-1]) / n
    return fast, (*counts, fast.n_iter, higher)


def measure(model, data):
    """Return sums over the fits: plain, accelerated, to its end; and the bounds."""
    found = []

    def spy(compare, *args, **options):
        solution, counts = compare(*args, **options)
        found.append(counts)
        return solution

    correlated = functools.partial(
        spy, compare_correlated, solver=_correlated.solve_correlated
    )
    solve = _solver.solve

    def independent(moments, state, prior, **options):
        with mock.patch.object(_solver, "solve", solve):
            return spy(compare_independent, moments, state, prior, **options)

    with (
        mock.patch.object(_solver, "solve", independent),
        mock.patch.object(_correlated, "solve_correlated", correlated),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        model.fit(data.X, data.y)
    counts = np.array(found)
    return (*counts[:, :3].sum(axis=0), counts[:, 3].min())


def run(trials, cells=CELLS, n_samples=1000):
    """Return cell -> model -> array (trials, 4)."""
    results = {}
    for snr, redundant in cells:
        rows = {name: [] for name in MODELS}
        for seed in range(trials):
            data = make_noisy_regression(
                n_samples,
                n_redundant=redundant,
                n_irrelevant=90 - redundant,
                input_snr=snr,
                random_state=seed,
            )
            for name, model in MODELS.items():
                rows[name].append(measure(model, data))
        results[snr, redundant] = {name: np.array(r) for name, r in rows.items()}
    return results


def report(results, trials):
    """Table of all cells."""
    rows = []
    for (snr, redundant), cell in results.items():
        for name, values in cell.items():
            plain, fast, end, higher = values.T
            rows.append(
                [
                    f"{snr:.0f}",
                    f"{redundant}/{90 - redundant}",
                    name,
                    f"{np.median(plain):.0f}",
                    f"{np.median(fast):.0f}",
                    f"{np.median(plain / fast):.1f}",
                    f"{np.min(plain / fast):.1f}",
                    f"{np.median(end):.0f}",
                    f"{higher.min():.1e}",
                ]
            )
    headers = ["SNR", "r/u", "model", "plain", "accelerated", "ratio", "lowest ratio"]
    headers += ["until it stops", "lowest difference of bounds"]
    smallest = min(
        np.min(values[:, 0] / values[:, 1])
        for cell in results.values()
        for values in cell.values()
    )
    return (
        f"{rst_table(rows, headers, n_labels=3)}\n\n"
        f"Medians of {trials} trial(s), seeds from 0, 1,000 samples. "
        f"Evaluations of the bound until it is within {CLOSE:.0e} per sample of the "
        "lower of the two last bounds; the plain iteration runs until it is that close "
        f"to the accelerated one, gains less than {PLAIN_GAIN:.0e} per sample or has "
        f"done {PLAIN_MOST:,} iterations. The correlated model does two fits, the "
        "second on the relevant inputs; their evaluations are added. Until it stops: "
        "accelerated, with the default tolerance. Difference of bounds: accelerated "
        "less plain, per sample; the plain one is cut off when it is close enough. "
        f"Smallest ratio of all fits: {smallest:.1f}."
    )


def main():
    """Run the comparison from the command line."""
    arguments = parser(__doc__)
    arguments.add_argument("--trials", type=int, default=1)
    arguments = arguments.parse_args()
    text = report(run(arguments.trials), arguments.trials)
    publish("iterations", text, write=arguments.write)


if __name__ == "__main__":
    main()
