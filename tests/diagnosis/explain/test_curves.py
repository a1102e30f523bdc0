"""Numbers behind the pictures: means, laws and curves of what is known."""

from types import SimpleNamespace

import numpy as np
import pytest

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.diagnosis.explain import (
    FinalFit,
    added_effects,
    extremes,
    torque_curves,
)
from sklearn_vbjfa.diagnosis.search import RecordingView
from sklearn_vbjfa.effects import Coulomb, Spring
from sklearn_vbjfa.recording import take_arrays


def test_a_thinned_curve_keeps_its_peaks_and_its_gaps():
    values = np.sin(np.arange(100_000) / 50.0)
    values[12_345], values[60_000], values[70_000] = 9.0, -9.0, np.nan
    rows = extremes(values, 500)
    assert rows.size <= 502
    assert {12_345, 60_000, 70_000} <= set(rows.tolist())
    assert (np.diff(rows) > 0).all()
    np.testing.assert_array_equal(extremes(values[:300], 500), np.arange(300))
    # nothing known in a whole interval
    assert np.isnan(extremes(np.full(1000, np.nan), 10)).sum() == 0


def test_torques_over_time_have_gaps_between_the_stretches():
    # rows 20 to 39 and 100 to 119 are held out
    rows = np.r_[20:40, 100:120]
    torque = np.column_stack([rows, -rows]).astype(float)
    before, after = (
        SimpleNamespace(
            index=rows, torque=torque, predicted=torque + k, weight=torque % 7
        )
        for k in (1.0, 2.0)
    )
    clock = 0.1 * np.arange(120)
    other, one = torque_curves(before, after, clock, [1, 0])
    assert (other.joint, one.joint) == (1, 0)
    (gap,) = one.seconds[np.isnan(one.measured)]
    assert gap == pytest.approx(2.0)
    known = np.isfinite(one.measured)
    np.testing.assert_array_equal(one.measured[known], rows)
    np.testing.assert_allclose(np.diff(one.seconds), 0.1)
    np.testing.assert_allclose(one.before[known], one.measured[known] + 1.0)
    np.testing.assert_allclose(other.after[known], other.measured[known] + 2.0)
    # Where the joint stands still errors do not count, nor where nothing is known.
    np.testing.assert_array_equal(one.counts[known], one.measured[known] % 7 > 0)
    assert not one.counts[~known].any()


@pytest.fixture(scope="module")
def fitted():
    """Fit a robot with a spring that was not declared."""
    data = make_robot_recording(
        duration=15.0, dt=0.01, undeclared={"spring": (1, 6.0)}, random_state=3
    )
    robot = RobotIdentifier(data.robot_model(), dt=data.dt, friction=("viscous",))
    declared = robot.fit(data.q, data.tau, data.groups)
    effects = [Spring(joint=1), Coulomb(joint=0)]
    whole = RobotIdentifier(
        data.robot_model(), dt=data.dt, friction=("viscous",), effects=effects
    ).fit(data.q, data.tau, data.groups)
    recording = take_arrays(
        data.q,
        data.tau,
        data.groups,
        np.ones(data.tau.shape),
        np.arange(len(data.q)) * data.dt,
        dt=data.dt,
        joint_names=data.joint_names,
    )
    view = RecordingView(declared, recording)
    return FinalFit(declared, whole, view, added_effects(whole, 2))


def test_torques_of_effects_and_residuals_add_up(fitted):
    """Without its effects a model predicts what is left of the whole prediction."""
    torques = fitted.effect_torques()
    theta = fitted.identifier.theta_.copy()
    n = fitted.view.equations.Phi.shape[2]
    rest = fitted.view.equations.Phi @ theta[:n]
    after = fitted.residuals()[1]
    np.testing.assert_allclose(rest + sum(torques), after.predicted, atol=1e-9)
