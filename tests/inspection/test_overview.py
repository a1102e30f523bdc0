"""Summary of motions: reversals, ranges, speeds, identifiable effects."""

import numpy as np
import pinocchio
import pytest

from sklearn_vbjfa.datasets import Recording
from sklearn_vbjfa.inspection import motion_of
from tests.effects._arms import inverse_dynamics
from tests.hostile._case import URDF


@pytest.fixture(scope="module")
def urdf(tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(URDF)
    return str(path)


def recording(urdf, q, dt=0.01):
    """Return a recording of positions and their inverse dynamics."""
    v = np.gradient(q, dt, axis=0)
    states = np.hstack([q, v, np.gradient(v, dt, axis=0)])
    tau = inverse_dynamics(pinocchio.buildModelFromUrdf(urdf), states)
    return Recording(
        name="arm",
        q=q,
        tau=tau,
        t=None,
        dt=dt,
        groups=np.zeros(len(q), dtype=int),
        group_names=("all",),
        joint_names=("shoulder", "elbow"),
        position_units=("rad", "rad"),
        torque_units=("N m", "N m"),
        urdf=urdf,
    )


T = 0.01 * np.arange(3000)


def test_reversals_ranges_and_speeds_of_a_sine(urdf):
    """Turning points of a sine of 0.5 Hz over 30 s: one each second."""
    q = np.column_stack([0.8 * np.sin(np.pi * T), 0.2 * np.cos(np.pi * T)])
    first, second = motion_of(recording(urdf, q))
    assert first.name == "shoulder"
    assert abs(first.reversals - 30) <= 2
    assert first.fastest == pytest.approx(0.8 * np.pi, rel=0.01)
    assert (first.lowest, first.highest) == pytest.approx((-0.8, 0.8), abs=1e-6)
    assert first.resting < 0.1
    assert "position-dependent effects" in first.shows
    (hidden,) = [x for x in second.hides if "position" in x]
    assert hidden.endswith("(range of 22.9 degrees, at least 60 needed)")


@pytest.mark.parametrize("noise", [0.0, 3e-5])
def test_constant_velocity_and_standstill_hide_friction(urdf, noise):
    rest = noise * np.random.default_rng(0).normal(size=T.size)
    q = np.column_stack([0.7 * T, rest])
    turning, still = motion_of(recording(urdf, q))
    assert turning.reversals == 0
    hidden = " ".join(turning.hides)
    assert "Coulomb friction, separate from offset (it never reverses)" in hidden
    assert "viscous friction, separate from Coulomb friction (one speed only)" in hidden
    assert still.hides == ("everything (it does not move)",)
    assert still.shows == ()
    assert still.resting == 1.0


def test_motion_of_a_short_recording_is_empty(urdf):
    q = np.column_stack([np.sin(T), np.cos(T)])[:12]
    assert motion_of(recording(urdf, q)) == ()
