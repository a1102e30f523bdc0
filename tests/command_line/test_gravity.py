"""identify and design --for gravity: from a log to a corrected description."""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
from _posed_arms import DT, Arm, gravity, pin, record, visit

from sklearn_vbjfa._cli import main

RNG = np.random.default_rng(0)
ARM = Arm.drawn(3, RNG)


def test_a_log_of_designed_poses_corrects_the_description(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    true = ARM.write("true.urdf")
    described = ARM.misdescribed(RNG).write("described.urdf")
    assert main(["design", "--urdf", "described.urdf", "--for", "gravity"]) == 0
    assert "identify LOG --urdf described.urdf --for gravity" in capsys.readouterr().out
    table = pd.read_csv("poses.csv")
    poses = table.loc[table["hold"] > 0, ["q_joint1", "q_joint2", "q_joint3"]]
    assert len(poses) == 40
    log = record(true, visit(poses.to_numpy()[::8]), np.array([1.0, 1.0, 4.0]), RNG)
    # Static friction of the third joint differs between poses.
    stuck = np.repeat(RNG.normal(0.0, 2.0, len(log.q) // 100 + 1), 100)
    log.tau[:, 2] += stuck[: len(log.q)]
    columns = {"t": np.arange(len(log.q)) * DT}
    columns |= {f"q{k + 1}": x for k, x in enumerate(log.q.T)}
    columns |= {f"tau{k + 1}": x for k, x in enumerate(log.tau.T)}
    pd.DataFrame(columns).to_csv("log.csv", index=False)
    words = ["identify", "log.csv", "--urdf", "described.urdf", "--for", "gravity"]
    for option in (["--gain", "unknown"], ["--bodies", "free"], ["--no-search"]):
        assert main([*words, *option]) == 2
        assert f"leave out {option[0]};" in capsys.readouterr().err
    assert main([*words, "--gain", "10,10,10", "-o", "wrong"]) == 3
    printed = capsys.readouterr().out
    assert "Do not use for: gravity compensation (All torques together" in printed
    assert "The poses are enough" not in printed
    assert main([*words, "-o", "out"]) == 0
    printed = capsys.readouterr().out
    assert re.search("joint1 .* no gravity torque", printed)
    assert "Use for: gravity compensation." in printed
    assert "Not checked: joint3 (gravity torque below" in printed
    report = json.loads(Path("out/report.json").read_text())
    words = report["command"].split()[3:]
    assert main([*words, "-o", "next.csv"]) == 0
    count = len(pd.read_csv("next.csv"))
    more = report["poses_enough"]
    assert ("The poses are enough" in printed) == ("next pose" not in printed)
    assert count == 4 * (20 if more is None else max(more, 1))
    joints = report["joints"]
    assert joints[1]["error corrected"] < joints[1]["error described"]
    q = RNG.uniform(-2, 2, (50, 3))
    after = gravity(pin.buildModelFromUrdf("out/identified.urdf"), q)
    error, before = after - gravity(true, q), gravity(described, q) - gravity(true, q)
    assert np.sqrt((error**2).mean()) < 0.2 * np.sqrt((before**2).mean())
