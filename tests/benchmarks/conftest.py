"""The tests of the benchmarks are slow tests: they check scripts, not the package."""

from pathlib import Path

import pytest


def pytest_ignore_collect(config):
    """Do not even import the scripts where no slow test is wanted."""
    return True if config.option.markexpr == "not slow" else None


def pytest_collection_modifyitems(items):
    """Mark what is collected in this folder, before tests are chosen by marks."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.slow)
