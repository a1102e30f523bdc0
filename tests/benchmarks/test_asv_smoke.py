"""Benchmarks of growth run at their smallest, and their errors are what they must be.

Errors are held against what second moments of the generator say: the limit of least
squares under noise in the inputs, and the deviation of an estimate from its own limit.
"""

import inspect
import json
import re
from pathlib import Path

import _growth_problems as problems
import _report
import bench_growth as bench
import numpy as np
import pytest
from asv_benchmarks import growth

from sklearn_vbjfa.datasets import make_robot_recording

HERE = Path(__file__).resolve().parent
CLASSES = [
    value
    for name, value in vars(growth).items()
    if inspect.isclass(value) and not name.startswith("_")
]
# Standard deviations that a drawn value may be away from its limit.
DEVIATIONS = 4.0
# Largest share of noise that the default takes an input to have, see its Notes.
LARGEST_SHARE = 0.3


def smallest(benchmark):
    """Every method at the smallest size."""
    sizes, methods = benchmark.params
    return [(benchmark, sizes[0], method) for method in methods]


CASES = [case for benchmark in CLASSES for case in smallest(benchmark)]


class Limit:
    """What an estimate tends to with many samples, and how far chance takes it.

    For an estimate that corrects for noise N in the inputs, (S_hat - N)^-1 s_xy, with
    the covariance S of the observed inputs. Its estimating equation
    x (y - x'b) + N b has the covariance S q + N b b' N with q the variance of y - x'b.

    Parameters
    ----------
    problem : LinearProblem
    noise : ndarray of shape (d,)
        Variances that the estimate takes the noise to have.
    """

    def __init__(self, problem, noise):
        self.problem, self.noise = problem, noise
        self.signal = problem.signal_covariance
        self.S = self.signal + np.diag(problem.input_noise)
        self.inverse = np.linalg.inv(self.S - np.diag(noise))
        self.coef = self.inverse @ self.signal @ problem.coef

    def deviations(self):
        """Return the standard deviations of the coefficients."""
        gap = self.coef - self.problem.coef
        own = self.coef**2 @ self.problem.input_noise
        q = self.problem.output_noise + gap @ self.signal @ gap
        # gap' T gap + b' Psi b is the variance of t'gap + e'b.
        product = self.noise * self.coef
        meat = self.S * (q + own) + np.outer(product, product)
        covariance = self.inverse @ meat @ self.inverse
        return np.sqrt(np.diagonal(covariance) / self.problem.n_samples)

    def error(self):
        """Largest relative error that chance explains."""
        spread = np.linalg.norm(self.deviations()) / np.linalg.norm(self.problem.coef)
        return self.problem.error(self.coef) + DEVIATIONS * spread

    def error_without(self, j):
        """Relative error, with many samples, of an estimate that lacks input j."""
        rest = np.arange(self.coef.size) != j
        coef = np.zeros_like(self.coef)
        matrix = (self.S - np.diag(self.noise))[np.ix_(rest, rest)]
        coef[rest] = np.linalg.solve(matrix, (self.signal @ self.problem.coef)[rest])
        return self.problem.error(coef)


def selected(problem, noise):
    """Largest error of an estimate that leaves out inputs by their noisy coefficients.

    An input is left out when that is less than two deviations away from zero; all for
    which this may happen are taken to be left out.
    """
    noisy = Limit(problem, np.zeros_like(noise))
    near = np.abs(noisy.coef) < (2.0 + DEVIATIONS) * noisy.deviations()
    limit = Limit(problem, noise)
    left_out = [
        limit.error_without(j) for j in np.flatnonzero(near & (problem.coef != 0.0))
    ]
    return limit.error() + sum(left_out)


def bound(study, method, size):
    """Largest error that chance explains."""
    if study == "joints":
        # What one sample of the torque says; there are thousands. The projection's
        # set is convex and holds the truth.
        noise = inspect.signature(make_robot_recording).parameters["torque_noise"]
        return {
            problems.PROJECTION: 1.0,
            # Two components, fewer than there are base parameters.
            "PLSRegression": 1.0,
            problems.DISCOVERY: noise.default / problems.UNDECLARED,
        }.get(method, noise.default)
    problem = problems.STUDIES[study][2](method, size).problem
    if method == problems.NOISE_GIVEN:
        return selected(problem, problem.input_noise)
    if method == "LinearRegression":
        return Limit(problem, np.zeros_like(problem.input_noise)).error()
    if method == "VB-JFA":
        variance = np.diagonal(problem.signal_covariance) + problem.input_noise
        shares = np.linspace(0.0, LARGEST_SHARE, 7)
        return max(selected(problem, share * variance) for share in shares)
    # What zero coefficients have.
    return 1.0


def test_classes_are_found():
    assert {benchmark.__name__ for benchmark in CLASSES} == {
        "ChunksHeld",
        "ChunksPassing",
        "Columns",
        "Joints",
        "Rows",
    }


def test_settings_name_what_is_there():
    text = (HERE / "asv.conf.json").read_text(encoding="utf-8")
    settings = json.loads(re.sub(r"^\s*//.*$", "", text, flags=re.M))
    assert (HERE / settings["benchmark_dir"] / "growth.py").is_file()
    assert (HERE / settings["repo"] / "pyproject.toml").is_file()
    ignored = (HERE / settings["repo"] / ".gitignore").read_text(encoding="utf-8")
    for name in ("env_dir", "results_dir", "html_dir"):
        assert settings[name].startswith(".asv/")
    assert "tests/benchmarks/.asv/" in ignored.splitlines()


@pytest.mark.parametrize(
    ("benchmark_class", "size", "method"),
    CASES,
    ids=[f"{c.__name__}-{size}-{method}" for c, size, method in CASES],
)
def test_every_benchmark_at_its_smallest(benchmark_class, size, method, monkeypatch):
    monkeypatch.setattr(problems, "DURATION", 10.0)
    if method.startswith("ODR"):
        pytest.importorskip("odrpack")
    study = getattr(benchmark_class, "study", "rows")
    if study == "joints":
        pytest.importorskip("pinocchio")
    instance = benchmark_class()
    instance.setup(size, method)
    for name in dir(instance):
        if name.startswith(("time_", "peakmem_")):
            getattr(instance, name)(size, method)
    if hasattr(instance, "track_error"):
        error = instance.track_error(size, method)
        assert 0.0 < error < bound(study, method, size)
        assert instance.track_error.unit == "relative error"


def test_problem_has_the_moments_it_says():
    problem = problems.LinearProblem(200_000, 6, 0.2)
    X, y = problem.arrays()
    S = problem.signal_covariance + np.diag(problem.input_noise)
    # Four deviations of a covariance: sqrt((S_ii S_jj + S_ij^2) / n) each.
    size = np.sqrt((np.outer(S.diagonal(), S.diagonal()) + S**2) / len(y))
    assert (np.abs(np.cov(X.T) - S) < DEVIATIONS * size).all()
    assert problem.input_noise == pytest.approx(0.2 * np.diagonal(S))
    expected = problem.coef @ problem.signal_covariance @ problem.coef
    assert problem.output_noise == pytest.approx(0.25 * expected)
    parts = list(problem.chunks())
    assert len(parts) == 2
    np.testing.assert_array_equal(np.vstack([part for part, _ in parts]), X)


def test_only_what_can_take_chunks_is_streamed():
    for method in problems.LINEAR:
        task = problems.LinearTask(method, problems.MOST_ROWS + 1, 2)
        assert task.streamed == (method in problems.STREAMED)
        assert not problems.LinearTask(method, problems.MOST_ROWS, 2).streamed


def test_least_squares_is_where_theory_puts_it():
    problem = problems.LinearProblem(100_000, 6, 0.2)
    X, y = problem.arrays()
    limit = Limit(problem, np.zeros(6))
    found = np.linalg.lstsq(X, y, rcond=None)[0]
    gap = np.abs(found - limit.coef)
    assert (gap < DEVIATIONS * limit.deviations()).all()
    assert problem.error(found) > 10 * np.linalg.norm(limit.deviations())


def test_extrapolation_follows_a_power_law():
    assert bench.extrapolate([10, 100], [1e-3, 1.0], 200) == pytest.approx(8.0)
    # Start-up hides the growth of small sizes; it is taken as linear at least.
    assert bench.extrapolate([10, 100], [1.0, 1.0], 200) == pytest.approx(2.0)
    assert bench.extrapolate([10], [3.0], 20) == pytest.approx(6.0)


def test_what_would_take_too_long_or_too_much_is_not_run():
    def run(study, method, size, most_seconds):
        asked.append(size)
        return {
            "seconds": 1e-9 * size**2,
            "megabytes": 100.0 + 1e-2 * size,
            "megabytes_before": 100.0,
            "error": 0.1,
        }

    asked = []
    done = bench.measure("columns", "Ridge", (10**4, 10**5, 10**6, 10**7), run)
    assert asked == [10**4, 10**5]
    assert done[10**6] == {"skipped": "about 1000 s"}
    assert done[10**7] == {"skipped": "too large"}
    done = bench.measure("rows", "Ridge", (10**4, 10**5, 10**6), run, 1e9)
    assert done[10**6] == {"skipped": "about 9.9 GB"}
    # What was not run is when the limit is higher, the rest is not again.
    asked.clear()
    few = bench.measure("rows", "Ridge", (10**4, 10**5), run, 0.5)
    assert few[10**5] == {"skipped": "about 1 s"}
    more = bench.measure("rows", "Ridge", (10**4, 10**5), run, 60.0, few)
    assert asked == [10**4, 10**5]
    assert more[10**5]["seconds"] == pytest.approx(10.0)
    # In chunks memory does not grow.
    done = bench.measure("rows", "VB-JFA", (10**5, 10**7), run, 1e9)
    assert "skipped" not in done[10**7]
    text = bench.table({"VB-JFA": done})
    assert "10 %" in text


def test_a_process_that_takes_too_long_is_stopped(monkeypatch):
    monkeypatch.setattr(bench, "START_SECONDS", 0.8)
    stopped = bench.measure_apart("rows", "ODR (odrpack)", 10**5, 0.1)
    assert stopped == {"skipped": "stopped after 0.2 s"}


def test_a_process_measures_what_this_one_does():
    apart = bench.measure_apart("rows", "Ridge", 2000)
    here = bench.measure_here("rows", "Ridge", 2000)
    assert apart["error"] == pytest.approx(here["error"], rel=1e-9)
    assert apart["seconds"] > 0
    # The arrays of 2,000 rows are 0.3 MB; Python with scikit-learn is most of it.
    assert 30 < apart["megabytes_before"] <= apart["megabytes"] < 1000


def test_growth_is_measured_kept_and_drawn(tmp_path, monkeypatch, capsys):
    pytest.importorskip("pinocchio")
    small = {"rows": (100, 200), "columns": (10, 12), "joints": (1,)}
    names = {
        "rows": ("VB-JFA", "Ridge"),
        "columns": ("VB-JFA", "LinearRegression"),
        "joints": ("Ridge", problems.PROJECTION),
    }
    studies = {
        study: (small[study], names[study], task)
        for study, (_, _, task) in problems.STUDIES.items()
    }
    monkeypatch.setattr(bench, "STUDIES", studies)
    monkeypatch.setattr(bench, "MOST_RUNS", 2)
    monkeypatch.setattr(_report, "TABLES", tmp_path)
    runs = []

    def run(study, method, size, most_seconds):
        runs.append((study, method, size))
        return bench.measure_here(study, method, size)

    kept = tmp_path / "kept.json"
    bench.main(["--results", str(kept), "--write"], run)
    assert len(runs) == 10
    text = (tmp_path / "growth.rst").read_text(encoding="utf-8")
    for title in bench.TITLES.values():
        assert f"{title}\n{'~' * len(title)}" in text
    assert "not run: " not in text
    bench.main(["--results", str(kept), "--missing", "--study", "joints"], run)
    bench.main(["--results", str(kept), "--report-only"], run)
    assert len(runs) == 10
    assert f"{bench.TITLES['rows']}" in capsys.readouterr().out
    bench.main(["--results", str(kept), "--study", "rows", "--method", "Ridge"], run)
    assert runs[10:] == [("rows", "Ridge", 100), ("rows", "Ridge", 200)]
    assert set(bench.load(kept)["rows"]["Ridge"]) == {100, 200}


def test_targets_are_judged_on_the_right_side():
    import bench_speed

    seconds = np.ones((3, len(bench_speed.models())))
    seconds[:, list(bench_speed.models()).index(bench_speed.LASSO)] = 41.0
    wide = np.ones((1, len(bench_speed.wide_models())))
    memory = [5000.0] * len(bench_speed.wide_models())
    rows = bench_speed.target_table(seconds, wide, memory).splitlines()
    verdicts = {line[:25].strip(): line.split()[-1] for line in rows[3:-1]}
    assert list(verdicts.values()) == ["yes", "no", "no", "yes", "yes", "no"]
