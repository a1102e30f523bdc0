"""Time stamps against the sample period."""

import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.recording import check_time_stamps

DT = 0.01
PARTS = [slice(0, 60), slice(60, 100)]


def stamps():
    """Two recordings whose time restarts."""
    return DT * np.r_[np.arange(60), np.arange(40)]


@pytest.mark.filterwarnings("error")
def test_regular_stamps_pass():
    rng = np.random.default_rng(0)
    check_time_stamps(None, DT, PARTS)
    check_time_stamps(stamps(), DT * (1 + 1e-5), PARTS)
    check_time_stamps(np.round(stamps() + 17.0, 4), DT, PARTS)
    check_time_stamps(stamps() + 2e-4 * rng.normal(size=100), DT, PARTS)
    # Rows that nothing differentiates may stand at any time.
    check_time_stamps(np.cumsum(rng.uniform(0.1, 9.0, 100)), None, PARTS)


def test_jitter_is_told():
    t = stamps()
    t[[20, 70]] += [0.3 * DT, -0.2 * DT]
    with pytest.warns(UserWarning, match="row 0 on vary .* rows count as") as said:
        check_time_stamps(t, DT, PARTS)
    assert len(said) == 2


def test_gaps_are_refused_and_named():
    t = stamps()
    t[30:60] += 4 * DT
    message = r"lacks samples after row 29: steps are at most 0\.05 s, but dt=0\.01 s"
    with pytest.raises(ValueError, match=message):
        check_time_stamps(t, DT, PARTS)
    # a border there is what is asked for
    check_time_stamps(t, DT, [slice(0, 30), slice(30, 60), slice(60, 100)])


def test_stamps_that_do_not_rise():
    t = stamps()
    t[40] = t[39]
    for dt in (DT, None):
        with pytest.raises(ValueError, match=r"repeats 0\.39 s in row 40"):
            check_time_stamps(t, dt, PARTS)
    with pytest.raises(ValueError, match=r"time runs backwards to 0 s in row 60"):
        check_time_stamps(stamps(), DT, [slice(0, 100)])


@pytest.mark.parametrize("factor", [0.5, 0.99, 1.01, 2.0, 100.0])
def test_another_sample_period(factor):
    t = np.arange(1000) * DT * factor
    with pytest.raises(ValueError, match=r"time steps by .* s but dt = 0\.01 s"):
        check_time_stamps(t, DT, [slice(0, 1000)])


def test_what_is_no_time():
    arm = make_robot_recording(duration=1.0, dt=DT, random_state=0)
    robot = RobotIdentifier(arm.urdf, dt=DT)
    with pytest.raises(ValueError, match=r"t must have shape \(100,\)"):
        robot.fit(arm.q, arm.tau, t=stamps()[:-1])
    with pytest.raises(ValueError, match=r"t must be .* finite numbers"):
        robot.fit(arm.q, arm.tau, t=np.where(np.arange(100) == 5, np.nan, stamps()))
