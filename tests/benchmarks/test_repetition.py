"""The study of repeated motion runs, and a disturbance that repeats has no name."""

import pytest

pytest.importorskip("pinocchio")

import bench_repetition as study

ONE = "1 joint, harmonics 1-30, 60 s"


def test_a_disturbance_that_repeats_with_the_motion_has_no_name():
    found = study.judge(ONE, 1)
    assert found["repeats"]
    assert found["names"] == []


def test_an_effect_on_repeated_motion_is_named():
    found = study.judge("power, 1 joint, 60 s", 2)
    assert found["repeats"]
    assert found["truth"]
    assert found["found"]


def test_a_motion_that_does_not_repeat_is_not_said_to():
    assert not study.judge("control, 1 joint, harmonics 1-30, 60 s", 0)["repeats"]


def test_the_table_has_a_row_for_each_kind():
    results = [study.judge(ONE, 1), study.judge("power, 1 joint, 60 s", 2)]
    text = study.report(results)
    assert ONE in text
    assert "100.0" in text
