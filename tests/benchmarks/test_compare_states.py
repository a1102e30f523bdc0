"""The comparison of two states reports differences, and tolerates rounding."""

import importlib
import json
import sys
from pathlib import Path

import pytest

TORQUE = [[1.0, -2.0], [0.5, float("nan")]]
REPORT = {"/error": 0.0123456, "/effects/0/name": "spring", "/floor": 1e-17}
FIGURES = {
    "torque": TORQUE,
    "metric": [[1.0, 0.0], [0.0, 0.0]],
    "theta|parameters": [3.0, 4.0],
    "names": ["link:m", "link:mx"],
    "exit code": 3,
    "files": ["report.html", "report.json"],
    "possible": [],
    "file|report.json": REPORT,
    "seconds|fit": 1.0,
}


@pytest.fixture
def states(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    yield importlib.import_module("compare_states")
    del sys.modules["compare_states"]


@pytest.mark.parametrize(
    "figures",
    [
        {},
        {"torque": [[1.0 + 1e-11, -2.0], [0.5, float("nan")]]},
        # a direction that nothing was fitted to
        {"theta|parameters": [3.0, 5.0]},
        {"file|report.json": REPORT | {"/error": 0.01234560004, "/floor": -3e-17}},
        # a feature that was dropped
        {"file|report.json": {"/error": 0.0123456}},
        {"seconds|fit": 3.0},
    ],
)
def test_what_counts_as_the_same(states, figures):
    assert states.differences(FIGURES, FIGURES | figures) == {}


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("torque", [[1.0 + 1e-7, -2.0], [0.5, float("nan")]]),
        ("torque", [[1.0, -2.0], [0.5, 0.0]]),
        ("torque", TORQUE[:1]),
        ("theta|parameters", [3.0 + 1e-7, 4.0]),
        ("names", ["link:m", "link:my"]),
        ("exit code", 0),
        ("files", ["report.html"]),
        ("file|report.json", REPORT | {"/error": 0.0123466}),
        ("file|report.json", REPORT | {"/effects/0/name": "ripple"}),
    ],
)
def test_what_counts_as_different(states, key, value):
    assert list(states.differences(FIGURES, FIGURES | {key: value})) == [key]


def test_files_are_compared(states, tmp_path, capsys):
    part = {"seconds": 1.0, "megabytes": 100, "figures": FIGURES}
    other = part | {"figures": FIGURES | {"names": ["link:m", "arm:mx"]}}
    fewer = {k: v for k, v in FIGURES.items() if k != "possible"}
    contents = {
        "one": {"demo": part},
        "fewer": {"demo": part | {"figures": fewer}},
        "other": {"demo": other},
        "more": {"demo": part, "emps": part},
    }
    paths = {name: str(tmp_path / name) for name in contents}
    for name, content in contents.items():
        Path(paths[name]).write_text(json.dumps(content))
    codes = {k: states.main(["compare", paths["one"], paths[k]]) for k in contents}
    assert codes == {"one": 0, "fewer": 0, "other": 1, "more": 1}
    text = capsys.readouterr().out
    assert "demo: 8 of 8 equal; 1.0 s and 100 MB -> 1.0 s and 100 MB" in text
    assert "demo: only in the first: possible" in text
    assert "demo: names: ['link:m', 'link:mx'] -> ['link:m', 'arm:mx']" in text
    assert f"emps: only in {paths['more']}" in text


def test_a_part_is_frozen_and_equals_itself(states, tmp_path):
    pytest.importorskip("pinocchio")
    path = str(tmp_path / "state.json")
    assert states.main(["freeze", path, "--only", "tables"]) == 0
    stored = json.loads(Path(path).read_text())["tables"]
    assert stored["megabytes"] > 0
    assert "default 2, coef_" in stored["figures"]
    assert states.main(["compare", path, path]) == 0
