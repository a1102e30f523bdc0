"""What type checkers see of the package, as ``py.typed`` promises."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.test_docs import PUBLIC_MODULES

ROOT = Path(__file__).resolve().parents[1]


def checked(*arguments, cwd=ROOT):
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *arguments],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.slow
def test_every_public_name_has_a_type(tmp_path):
    pytest.importorskip("mypy")
    names = [(m.__name__, name) for m in PUBLIC_MODULES for name in m.__all__]
    lines = [
        f"from {module} import {name} as n{k}" for k, (module, name) in enumerate(names)
    ]
    lines += [f"reveal_type(n{k})" for k in range(len(names))]
    lines += [
        "from sklearn_vbjfa.datasets import load_demo_recording, read_recording",
        "reveal_type(load_demo_recording().q)",
        "reveal_type(read_recording('arm.csv').select(0).dt)",
    ]
    (tmp_path / "use.py").write_text("\n".join(lines), encoding="utf-8")
    code, said = checked(
        f"--config-file={ROOT / 'pyproject.toml'}",
        "--cache-dir",
        str(tmp_path / "cache"),
        str(tmp_path / "use.py"),
    )
    assert code == 0, said
    revealed = [line for line in said.splitlines() if "Revealed type" in line]
    assert len(revealed) == len(names) + 2
    unknown = [line for line in revealed if line.endswith('"Any"')]
    assert unknown == []
