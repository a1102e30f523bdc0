"""Fixtures that several folders of tests share."""

import os
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits


@pytest.fixture(scope="session")
def measured_data_home() -> Path:
    """Folder of the measured sets, as `data_home` of the loaders expects it.

    The environment variable SKLEARN_VBJFA_DATA names it; without one, the
    folder ``shared/data`` next to the repository is tried, else the test is
    skipped.
    """
    named = os.environ.get("SKLEARN_VBJFA_DATA")
    if named:
        assert Path(named).is_dir(), f"SKLEARN_VBJFA_DATA is no folder: {named}"
        return Path(named)
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not beside.is_dir():
        pytest.skip("no measured sets; name their folder in SKLEARN_VBJFA_DATA")
    return beside


# Each worker has a processor to itself: threads of the linear algebra would only get
# in each other's way.
_ONE_THREAD = threadpool_limits(limits=1)
