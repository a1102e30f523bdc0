"""Robots as files."""

import pytest


@pytest.fixture
def write(tmp_path):
    """Write the text of a robot; return its path, whose ending says the format."""

    def to_file(text, name=None):
        path = tmp_path / (name or f"robot.{'urdf' if '<robot' in text else 'xml'}")
        path.write_text(text)
        return path

    return to_file
