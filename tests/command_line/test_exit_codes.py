"""Exit codes: 0 success, 2 refused, 3 finished with warnings."""

import io
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier, effects
from sklearn_vbjfa._cli import main
from sklearn_vbjfa._cli._parser import EXIT_CODES
from tests.command_line import _running
from tests.hostile._case import DT, LINK, URDF, N, columns, csv_text

COMMANDS = ("identify", "inspect")
WRIST = {"name": "tip", "joint": "wrist", "parent": "lower", "origin": 0.3}
HAND = URDF.replace("</robot>", LINK.format(**WRIST, centre=0.1, mass=1) + "</robot>")
# Options that keep the runs short.
SHORT = {"identify": ("--effects", "none", "--out", "out")}


def run(capsys, command, *argv):
    """Return the exit code, stdout, and the lines on stderr of a command."""
    code, out, err = _running.run(capsys, command, *argv, *SHORT.get(command, ()))
    return code, out, err.splitlines()


def write(table, name="arm.csv"):
    Path(name).write_text(csv_text(table), encoding="utf-8")
    return name


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Working folder with two robots."""
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(URDF)
    Path("hand.urdf").write_text(HAND)
    return tmp_path


def quantise(column, share):
    """Round to steps of a share of the standard deviation."""
    step = share * column.std()
    return np.round(column / step) * step


def drop_rows(table, rows):
    return {name: np.delete(column, rows) for name, column in table.items()}


def name_by_joint(table):
    names = {"1": "_shoulder", "2": "_elbow"}
    return {name[:-1] + names.get(name[-1], name[-1]): x for name, x in table.items()}


# Encoder noise at rest.
NOISE = 1e-4 * np.random.default_rng(0).normal(size=N)


def late(table):
    return np.arange(N) >= N // 2


# Change to a valid recording, exit code, and pattern of the last line; the key "" holds
# for all commands without an entry.
RECORDINGS = {
    "valid": (lambda x: x, {"": (0, "")}),
    "a clipped torque": (
        lambda x: x | {"tau1": np.clip(x["tau1"], *np.quantile(x["tau1"], [0.2, 0.8]))},
        {"": (3, "The torque of shoulder is clipped at .* % of its samples lie there")},
    ),
    "lost readings": (
        lambda x: x | {"tau1": x["tau1"] * (np.arange(N) % 200 >= 20)},
        {"": (3, "The torque of shoulder stays at 0 ")},
    ),
    "torques without signs": (
        lambda x: x | {k: np.abs(x[k]) for k in ("tau1", "tau2")},
        {
            "": (2, "have one sign only.*--drive 'current signed=no'$"),
            "inspect": (3, "have one sign only.*--drive 'current signed=no'"),
        },
    ),
    "a lower rate": (
        lambda x: x | {"tau1": np.repeat(x["tau1"][::4], 4)},
        {"": (3, "The torque of shoulder has a new value only every 4 rows")},
    ),
    "a coarse torque": (
        lambda x: x | {"tau1": quantise(x["tau1"], 1.5)},
        {"": (3, "The torque of shoulder goes in steps of ")},
    ),
    "a joint at rest": (
        lambda x: x | {"q2": np.full(N, 0.3)},
        {
            "": (3, "elbow never moves"),
            # Once in the last line and otherwise only in the findings.
            "identify": (3, r"(?s); elbow never moves \(exit(?!(.*elbow never){3})"),
        },
    ),
    "a gap": (
        lambda x: drop_rows(x, slice(700, 800)),
        {"": (3, r"1 gap\(s\) of 5 periods or more")},
    ),
    "interpolated rows": (lambda x: drop_rows(x, [700, 900]), {"": (0, "")}),
    "no columns of a joint": (
        name_by_joint,
        {"": (3, r"no columns of joint\(s\) wrist: held at zero")},
    ),
    "two robots": (
        lambda x: x | {"segment": 1 * late(x), "tau1": x["tau1"] + 12 * late(x)},
        {
            "": (0, ""),
            "identify": (3, "Recordings 0 and 1 contradict each other on joint 1"),
        },
    ),
    "another unit in one recording": (
        lambda x: (
            {k: y * 100 ** (late(x) * ("tau" in k)) for k, y in x.items()}
            | {"segment": 1 * late(x)}
        ),
        {
            "": (3, "Recording . alone: All torques"),
            "identify": (3, "^warning: Recording . alone: All torques .*contradict"),
        },
    ),
    "half a second": (
        lambda x: {name: column[:100] for name, column in x.items()},
        {"": (0, ""), "identify": (3, r"noise floor unknown \(joint 1 \(shoulder\)\)")},
    ),
    "a robot at rest": (
        lambda x: x | dict.fromkeys(("q1", "q2"), NOISE),
        {"": (2, "No joint moves"), "inspect": (3, "No joint moves")},
    ),
    "no positions": (
        lambda x: {"t": x["t"], "tau1": x["tau1"]},
        {"": (2, "no positions")},
    ),
}
# Of each recording, only one command runs in the quick tests.
CASES = [
    pytest.param(kind, command, marks=[] if (i + k) % 2 == 0 else pytest.mark.slow)
    for i, kind in enumerate(RECORDINGS)
    for k, command in enumerate(COMMANDS)
]


@pytest.mark.parametrize(("kind", "command"), CASES)
def test_exit_codes_of_recordings(kind, command, here, capsys):
    change, expected = RECORDINGS[kind]
    urdf = "hand.urdf" if kind == "no columns of a joint" else "arm.urdf"
    source = write(change(columns()))
    exit_code, message = expected.get(command, expected[""])
    code, out, err = run(capsys, command, source, "--urdf", urdf)
    assert code == exit_code, err
    if code == 2:
        (line,) = [x for x in err if not x.startswith(("note: ", "warning: "))]
        assert line.startswith("sklearn-vbjfa: ")
        assert out == ""
        assert not Path("out").exists()
    else:
        assert all(x.startswith(("note: ", "warning: ")) for x in err)
        assert out
    warned = [x for x in err if x.startswith("warning: ")]
    assert warned == err[-1:] * (code == 3)
    shown = "".join(err[-1:])
    if command == "identify" and code == 3:
        # The last line may be shortened, the report is not.
        shown += Path("out/report.json").read_text(encoding="utf-8")
    assert re.search(message, shown), err


def test_a_fault_of_a_file_with_a_space_is_named(here, capsys):
    source = write(drop_rows(columns(), slice(700, 800)), "my log.csv")
    argv = "identify", source, "--urdf", "arm.urdf", "--no-search"
    code, _, err = run(capsys, *argv)
    assert code == 3
    assert re.search(r"my log.csv: \d gap\(s\) of 5 periods", err[-1])


def test_characters_unknown_to_the_terminal_are_escaped(here, monkeypatch):
    source, terminal = write(columns(), "lög.csv"), io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(terminal, encoding="ascii"))
    assert main(["inspect", source, "--urdf", "arm.urdf"]) == 0
    assert b"'l\\xf6g'" in terminal.getvalue()


def test_close_loop_is_an_alias_of_identify(here, capsys):
    source = write(columns())
    argv = ("close-loop", source, "--urdf", "arm.urdf", "--no-search", "-o", "found")
    assert main(argv) == 0
    assert (here / "found" / "parameters.csv").exists()


def test_unexplained_torque_suggests_a_search(here, capsys):
    log = columns()
    source = write(log | {"tau1": log["tau1"] + 8.0 * log["q1"] ** 3})
    out = run(capsys, "identify", source, "--urdf", "arm.urdf", "--no-search")[1]
    assert "unexplained" in out
    assert "Next: identify without --no-search" in out


def test_omitted_joints_give_no_warning(here, capsys):
    source = write(columns())
    argv = (source, "--urdf", "hand.urdf", "--joints", "shoulder,elbow")
    assert run(capsys, "inspect", *argv)[0] == 0


def test_unused_velocity_columns_give_no_warning(here, capsys):
    speeds = {f"arm_{j}.vel": np.gradient(columns()[f"q{j}"], DT) for j in (1, 2)}
    source = write(columns() | speeds)
    code, out, err = run(capsys, "identify", source, "--urdf", "arm.urdf")
    assert (code, err) == (0, [])
    assert out.count("Channel:") == 1
    assert "Channel: Column(s) 'arm_1.vel', 'arm_2.vel' are not used" in out


def test_a_file_with_different_motion_is_named_with_the_joint(here, capsys):
    table = columns()
    speed = np.gradient(table["q2"], DT)
    table["tau2"] = table["tau2"] * (1 + 0.2 * np.sign(speed * table["tau2"]))
    argv = ["identify", write(table), "--urdf", "arm.urdf", "--out", "out"]
    assert main([*argv, "--effects", "load_friction"]) == 3
    captured = capsys.readouterr()
    assert "MuJoCo file is an approximation" in " ".join(captured.out.split())
    line = r"identified.xml moves differently from the identified robot \(.*elbow \d+ %"
    assert re.search(f"warning: .*{line}.*exit code 3", captured.err.splitlines()[-1])
    report = json.loads(Path("out/report.json").read_text(encoding="utf-8"))
    assert any(re.match(line, one) for one in report["warnings"])
    assert "moves differently" in Path("out/report.html").read_text(encoding="utf-8")


def test_a_simulation_without_an_effect_gives_a_warning(here, capsys):
    table = columns()
    q, tau = (np.column_stack([table[f"{x}{j}"] for j in (1, 2)]) for x in ("q", "tau"))
    left_out = [effects.Jerk(joint=0)]
    robot = RobotIdentifier("arm.urdf", dt=DT, effects=left_out).fit(q, tau)
    robot.save("arm.json")
    code, _, err = run(capsys, "simulate", write(table), "--model", "arm.json")
    assert code == 3
    assert "The simulation leaves out jerk on shoulder" in err[-1]


@pytest.mark.slow
def test_designing_for_an_unidentifiable_effect_gives_a_warning(here, capsys):
    argv = ("--urdf", "arm.urdf", "--duration", "4", "--acceleration", "20")
    code, out, err = run(capsys, "design", *argv, "--effects", "rotor_inertia")
    assert code == 3
    assert "Not identifiable by any motion: " in out
    assert re.search(
        "warning: .*on joint 1 .shoulder. is not identifiable by any motion", err[-1]
    )


@pytest.mark.parametrize("command", ["", *COMMANDS, "simulate", "design", "effects"])
def test_help_lists_exit_codes(command, capsys):
    with pytest.raises(SystemExit) as stop:
        main([*filter(None, [command]), "--help"])
    assert stop.value.code == 0
    text = " ".join(capsys.readouterr().out.split())
    assert EXIT_CODES in text
    # The default of --out depends on the command.
    assert ("motion.csv" in text) == (command == "design")
    assert ("plus -simulation" in text) == (command == "simulate")
