"""The arm of most commands, as a file."""

import pytest

from tests.hostile._case import URDF


@pytest.fixture(scope="module")
def urdf(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(URDF)
    return path
