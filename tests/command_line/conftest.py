"""The arm of most commands, and a recording of it, as files."""

import pytest

from sklearn_vbjfa.datasets import make_robot_recording
from tests.command_line._running import write_csv
from tests.hostile._case import URDF


@pytest.fixture(scope="session")
def urdf(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(URDF)
    return path


@pytest.fixture(scope="session")
def recording(urdf):
    """Two joints, 15 s; a spring on the shoulder is missing from the model."""
    return make_robot_recording(
        str(urdf),
        duration=15.0,
        n_harmonics=8,
        undeclared={"spring": (0, 4.0)},
        random_state=0,
    )


@pytest.fixture
def good(tmp_path, recording, monkeypatch):
    """Path of a valid recording, in the working folder."""
    monkeypatch.chdir(tmp_path)
    return write_csv(tmp_path / "arm.csv", recording)
