"""No input causes a traceback, crash, hang, memory exhaustion or partial report."""

import contextlib
import json
import re
import shutil
import sys
import threading
import warnings
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

if sys.platform != "linux":
    pytest.skip("processes with limits are Linux's here", allow_module_level=True)

from tests.hostile import _known, _mutations
from tests.hostile._case import URDF, argv, clean_text
from tests.hostile._runner import MEMORY, SECONDS, Runner

CASES = [*_known.cases(), *_mutations.cases()]
# Maximum number of cases in the quick sample.
MAX_QUICK = 66
FILES = {"parameters.csv", "report.html", "report.json"}
FILES |= {"identified.json", "identified.urdf", "identified.xml"}
# Maximum length of a message.
MAX_LENGTH = 1200


@pytest.fixture(scope="module")
def runner(tmp_path_factory):
    folder = tmp_path_factory.mktemp("first")
    with Runner() as server:
        # The first run is valid; the other runs inherit its imports.
        run(server, _clean_recording, folder)
        yield server


def _clean_recording(folder):
    (folder / "arm.csv").write_text(clean_text())
    return argv()


def run(runner, build, folder, command="close-loop"):
    """Write the input and run the command line; return arguments and outcome."""
    (folder / "arm.urdf").write_text(URDF)
    arguments = build(folder)
    return arguments, runner.run([command, *arguments], folder)


def verdict(report):
    """Return the effects of probability above 99 % and the status of each joint.

    At 95 %, one file in twenty has a false effect.
    """
    content = json.loads(Path(report).read_text(encoding="utf-8"))
    certain = [x for x in content["effects"] if x["probability"] > 0.99]
    effects = sorted((x["name"], x["joint"]) for x in certain)
    return effects, [joint["status"] for joint in content["errors"]]


@pytest.fixture(scope="module")
def clean(runner, tmp_path_factory):
    """Return the verdict on the valid recording."""
    folder = tmp_path_factory.mktemp("clean")
    _, outcome = run(runner, _clean_recording, folder)
    assert outcome.code == 0, outcome.err
    result = verdict(folder / "out" / "report.json")
    assert result == ([("spring", 0)], ["floor", "floor"])
    return result


def folder_of(arguments, folder):
    """Return the folder of the report."""
    command = " ".join(arguments).replace("--out ", "--out=").split("--out=")[-1]
    return folder / (command.split(" ")[0] or "arm-report")


def check_refusal(outcome):
    """Check that there is one line of error; return it."""
    lines = [
        x for x in outcome.err.splitlines() if not x.startswith(("note: ", "warning: "))
    ]
    if any(line.startswith("usage: ") for line in lines):
        lines = lines[-1:]
    assert len(lines) == 1, outcome.err[-3000:]
    assert lines[0].startswith("sklearn-vbjfa"), lines
    assert len(lines[0]) < MAX_LENGTH, lines[0][:300]
    return lines[0]


def check_code(outcome):
    """Check the exit code; with code 3, the last line must be a warning."""
    message = outcome.err[-2000:]
    assert outcome.code in (0, 2, 3), f"{outcome.code}: {message}"
    last = "".join(outcome.err.splitlines()[-1:])
    assert last.startswith("warning: ") == (outcome.code == 3), message


def check_report(out):
    """Check that all files exist and are complete."""
    assert FILES <= {path.name for path in out.iterdir()}
    assert verdict(out / "report.json")
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.endswith("</html>\n")
    for name in ("identified.urdf", "identified.xml"):
        ElementTree.parse(out / name)
    assert json.loads((out / "identified.json").read_text(encoding="utf-8"))


def params(cases):
    """Return parameters; cases outside the quick sample are marked as slow."""
    return [
        pytest.param(case, id=case.name, marks=[pytest.mark.slow] * case.slow)
        for case in cases
    ]


def test_quick_sample_is_small_and_contains_each_kind():
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names) >= 400
    quick = [case for case in CASES if not case.slow]
    assert len(quick) <= MAX_QUICK
    # Names are those of the mutation and a number.
    of_bytes = (*_mutations.BYTES, *_mutations.TEXT, *_mutations.XML)
    for mutate in (*of_bytes, *_mutations.COLUMNS, *_mutations.STAMPS):
        assert any(f"{mutate.__name__} " in case.name for case in quick), mutate
    assert {case.expect for case in quick} == {"refused", "read", "same", "either"}


@pytest.mark.parametrize("case", params(CASES))
def test_hostile_input(case, runner, clean, tmp_path):
    before = {}

    def build(folder):
        arguments = case.build(folder, case.rng())
        if case.expect == "either" and "--effects" not in case.name:
            # The search is not tested here.
            arguments += ["--effects", "none"]
        before.update((p, p.is_file()) for p in folder.rglob("*"))
        return arguments

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        arguments, outcome = run(runner, build, tmp_path)
    message = outcome.err[-2000:]
    assert "Traceback" not in outcome.err, message
    check_code(outcome)
    assert outcome.seconds < SECONDS
    assert outcome.memory < MEMORY
    if outcome.code == 2:
        assert case.expect in ("refused", "either"), message
        line = check_refusal(outcome)
        assert re.search(case.message, line), line
        new_files = {p for p in tmp_path.rglob("*") if p not in before}
        assert {path.name for path in new_files} <= {".stdout", ".stderr"}
        return
    assert case.expect in ("read", "same", "either"), outcome.out[:1000]
    out = folder_of(arguments, tmp_path)
    check_report(out)
    for line in outcome.err.splitlines():
        assert line.startswith(("note: ", "warning: ")), message
        assert len(line) < MAX_LENGTH, line[:300]
    if case.expect == "same":
        assert verdict(out / "report.json") == clean, outcome.out + message
    if case.message:
        # Notes are in the report.
        report = json.loads((out / "report.json").read_text(encoding="utf-8"))
        warned = report["provenance"]["warnings"]
        # Exclude warnings of the exported descriptions.
        noted = [f"note: {x}" for x in warned if not x.startswith("identified.")]
        noted += [x["message"] for x in report["channels"]]
        assert re.search(case.message, "\n".join([outcome.err, *noted])), message


def _grows(folder):
    with (folder / "arm.csv").open("a") as file:
        file.write("1,2,3\n")


def _is_rewritten(folder):
    text = clean_text()
    (folder / "arm.csv").write_text(text[: len(text) // 2])
    (folder / "arm.csv").write_text(text)


def _is_deleted(folder):
    (folder / "arm.csv").unlink(missing_ok=True)
    (folder / "arm.csv").write_text(clean_text())


def _out_disappears(folder):
    shutil.rmtree(folder / "out", ignore_errors=True)


def _out_becomes_a_file(folder):
    with contextlib.suppress(OSError):
        shutil.rmtree(folder / "out", ignore_errors=True)
        (folder / "out").touch()


def _report_appears(folder):
    with contextlib.suppress(OSError):
        (folder / "out").mkdir()
        (folder / "out" / "report.json").write_text("of another run")


CHANGES = [_grows, _is_rewritten, _is_deleted, _out_disappears, _out_becomes_a_file]
CHANGES += [_report_appears]


@pytest.mark.parametrize("change", CHANGES)
def test_files_that_change_during_a_run_give_an_error_or_a_complete_report(
    change, runner, tmp_path
):
    ended = threading.Event()

    def keep_changing():
        while not ended.wait(0.002):
            change(tmp_path)

    def build(folder):
        (folder / "arm.csv").write_text(clean_text())
        other.start()
        return argv("arm.csv", "--effects", "none")

    other = threading.Thread(target=keep_changing)
    try:
        _, outcome = run(runner, build, tmp_path)
    finally:
        ended.set()
        other.join()
    told = outcome.err[-2000:]
    assert "Traceback" not in outcome.err, told
    check_code(outcome)
    if outcome.code == 2:
        check_refusal(outcome)
        assert not list(tmp_path.glob("**/.writing-*"))
    if change is _grows:
        assert "was written to while it was read" in outcome.err
    if change is _report_appears and (tmp_path / "out").is_dir():
        text = (tmp_path / "out" / "report.json").read_text()
        assert text == "of another run"
