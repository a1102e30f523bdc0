"""Importing the package takes little longer than scikit-learn's linear models."""

import json
import statistics
import subprocess
import sys

import pytest

OURS, THEIRS = "sklearn_vbjfa", "sklearn.linear_model"
# Of the modules, and of the processor time.
MOST = 1.5


def imported(module, what):
    """Value of an expression in a process that has imported all names of a module."""
    # Names of the package are imported when they are asked for.
    code = f"from {module} import *; import json, sys, time; print(json.dumps({what}))"
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stderr == ""
    return json.loads(result.stdout)


def test_few_modules_more_than_the_linear_models_have():
    ours, theirs = (
        set(imported(module, "sorted(sys.modules)")) for module in (OURS, THEIRS)
    )
    assert len(ours) < MOST * len(theirs)
    more = {name.split(".")[0] for name in ours} - sys.stdlib_module_names
    more -= {name.split(".")[0] for name in theirs}
    # tabulate takes wcwidth where something else has installed it
    assert more - {"wcwidth"} == {"sklearn_vbjfa", "clarabel", "tabulate"}
    # Trees and filters are loaded by the fits that need them.
    parts = {".".join(name.split(".")[:2]) for name in ours - theirs}
    assert not [name for name in parts if name.startswith(("sklearn.", "scipy."))]


@pytest.mark.slow
def test_importing_takes_little_longer_than_the_linear_models():
    # In turn, so that what else the machine does hits both.
    times = {OURS: [], THEIRS: []}
    for _ in range(6):
        for module, measured in times.items():
            measured.append(imported(module, "time.process_time()"))
    # The first of each reads from the disk.
    ours, theirs = (statistics.median(x[1:]) for x in times.values())
    assert ours < MOST * theirs, f"{ours:.2f} s, {theirs:.2f} s"
