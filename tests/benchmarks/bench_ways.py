"""How much of the package a reader meets who follows one value through it.

Run ``python tests/benchmarks/bench_ways.py``. The ways: positions through
`RobotIdentifier.fit`, X through `VBJFARegressor.fit`, a recording through
`EffectDiscovery.fit`, a CSV through the command line; beside them scikit-learn's
`BayesianGaussianMixture.fit`, `BayesianRidge.fit`, and skglm's `Lasso.fit` if it is
installed. Counted are the files of the package that are entered, the functions of
theirs that run, and the lines of these functions with their docstrings; of others the
files of their own package.
"""

import contextlib
import importlib.util
import io
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import sklearn
from sklearn.linear_model import BayesianRidge
from sklearn.mixture import BayesianGaussianMixture
from tabulate import tabulate

import sklearn_vbjfa
from sklearn_vbjfa import EffectDiscovery, RobotIdentifier, VBJFARegressor, datasets


def walk(function, root):
    """Run a function; return the code objects of files under `root` that it entered."""
    entered = set()

    def profile(frame, event, _):
        if event == "call":
            code = frame.f_code
            if code.co_filename.startswith(root):
                entered.add(code)

    sys.setprofile(profile)
    try:
        function()
    finally:
        sys.setprofile(None)
    return entered


def figures(entered):
    """Files, functions and lines of what was entered."""
    lines = set()
    for code in entered:
        numbers = [line for *_, line in code.co_lines() if line]
        if code.co_name != "<module>":
            first = code.co_firstlineno
            lines |= {(code.co_filename, i) for i in range(first, max(numbers) + 1)}
    files = {code.co_filename for code in entered}
    functions = sum(not code.co_name.startswith("<") for code in entered)
    return len(files), functions, len(lines), sorted(files)


def ways():
    """Name -> (function, root of the package)."""
    recording = datasets.load_demo_recording()
    identifier = RobotIdentifier(
        recording.robot_model(), dt=recording.dt, friction=("viscous", "coulomb")
    )
    arrays = recording.q, recording.tau, recording.groups
    data = datasets.make_noisy_regression(300, random_state=0)
    folder = Path(tempfile.mkdtemp())
    path = folder / "log.csv"
    first = recording.groups == recording.groups[0]
    nv = recording.q.shape[1]
    names = ["t", *(f"q{j}" for j in range(nv)), *(f"tau{j}" for j in range(nv))]
    table = np.column_stack([recording.t, recording.q, recording.tau])[first]
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="")

    def command_line():
        from sklearn_vbjfa._cli import main

        files = ["--urdf", str(recording.urdf), "--out", str(folder / "report")]
        with contextlib.redirect_stdout(io.StringIO()):
            main(["close-loop", str(path), *files])

    own, other = str(Path(sklearn_vbjfa.__file__).parent), Path(sklearn.__file__).parent
    found = {
        "RobotIdentifier.fit": (lambda: identifier.fit(*arrays), own),
        "VBJFARegressor.fit": (lambda: VBJFARegressor().fit(data.X, data.y), own),
        "EffectDiscovery.fit": (lambda: EffectDiscovery(identifier).fit(*arrays), own),
        "command line, a CSV": (command_line, own),
        "BayesianGaussianMixture.fit": (
            lambda: BayesianGaussianMixture(n_components=3, random_state=0).fit(data.X),
            str(other),
        ),
        "BayesianRidge.fit": (lambda: BayesianRidge().fit(data.X, data.y), str(other)),
    }
    if importlib.util.find_spec("skglm"):
        import skglm

        root = str(Path(skglm.__file__).parent)
        found["skglm Lasso.fit"] = (lambda: skglm.Lasso().fit(data.X, data.y), root)
    return found


def main():
    """Print the table."""
    rows = []
    for name, (function, root) in ways().items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            function()  # imports and caches are no part of the way
            *counts, files = figures(walk(function, root))
        rows.append([name, *counts])
        if "--files" in sys.argv:
            print(name, *(Path(file).relative_to(root) for file in files), sep="\n  ")
    print(tabulate(rows, headers=["way", "files", "functions", "lines of these"]))


if __name__ == "__main__":
    main()
