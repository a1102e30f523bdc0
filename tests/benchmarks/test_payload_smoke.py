"""The payload study runs at small size, and its robots carry what they say."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import bench_payload as payload


@pytest.fixture(scope="module")
def case():
    return payload.draw(3, duration=20.0)


def test_the_payload_is_where_it_is_said_to_be(case):
    """Seed 3: in the first half of the first recording, put down then."""
    assert case.place == "start of the first"
    assert case.change == -case.mass
    n = len(case.q) // 4
    difference = np.abs(case.loaded - case.tau).max(axis=1) > 0
    assert difference[: n - 1].all()
    assert not difference[n + 1 :].any()
    lower, upper = payload.SHARES
    assert lower <= case.share <= upper
    places = [payload.draw(seed, duration=20.0).place for seed in range(4)]
    assert places == list(payload.PLACES)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_it_is_named_with_its_mass_and_only_where_it_is(case):
    row, (named, inside, alarm, _) = payload.judge(case)
    assert len(row) == len(payload.HEADERS) - 1
    assert named
    assert inside
    assert not alarm
