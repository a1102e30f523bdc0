"""Rotor inertias near the one that is described, and never negative."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import lognorm

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.fit import rotor_posterior
from sklearn_vbjfa.robot import FitOptions
from tests.robot.test_drives import ARM, ARMATURE, DT, EXACT, KD, KP, PDDrive, record


def test_described_values_or_defaults():
    """The moments by quadrature; a default far below an uncertain estimate."""
    y, S = np.array([-0.02, 0.3]), np.array([[4e-3, 1e-3], [1e-3, 2e-3]])
    references, W = np.array([0.05, 0.2]), np.linalg.inv(S)
    x = np.linspace(1e-4, 0.6, 2000)
    away = np.stack(np.meshgrid(x, x, indexing="ij"), axis=-1) - y
    density = np.exp(-0.5 * np.einsum("abi,ij,abj->ab", away, W, away))
    limit = np.maximum(y, 0.0) + 2.0 * np.sqrt(np.diagonal(S))
    near = [lognorm.pdf(x, np.log(2.0), scale=reference) for reference in references]
    first, second = near + (x < limit[:, None]) / limit[:, None]
    density *= np.outer(first, second)
    exact = [np.average(x, weights=density.sum(axis=k)) for k in (1, 0)]
    assert_allclose(rotor_posterior(y, S, references)[0], exact, rtol=0.03)
    wide = np.array([[18.0**2]])
    mean, covariance, *_ = rotor_posterior(np.array([31.0]), wide, np.array([1e-3]))
    assert abs(mean - 31.0) < np.sqrt(covariance)


def described(armature):
    """Return the arm with a description of its rotor inertias."""
    model = ARM.copy()
    model.armature = np.array(armature)
    return model


def rotors(model, recording, drive):
    """Return the rotor inertias of a fit, and their deviations."""
    settings = EXACT | {"options": FitOptions(standstill=None, alike=None)}
    robot = RobotIdentifier(model, drive=drive, dt=DT, **settings)
    robot.fit_recording(recording)
    at = [robot.parameter_names_.index(f"joint_{k}:rotor_inertia") for k in (1, 2, 3)]
    return robot.theta_unconstrained_[at], robot.theta_std_[at]


@pytest.mark.parametrize("factor", [0.6, 1.5])
def test_what_torques_do_not_tell_is_near_the_description(factor):
    """Noise that hides a rotor: without the description it would be negative."""
    drive = PDDrive(KP, KD)
    recording = drive.driven(record(0.008))
    a = recording.states[:, 6:]
    # As if the rotors turned against the joints.
    noise = np.random.default_rng(0).normal(size=a.shape)
    wrong = replace(recording, tau=recording.tau - 1.5 * ARMATURE * a + 2.0 * noise)
    plain, std = rotors(ARM, wrong, drive)
    near, less = rotors(described(factor * ARMATURE), wrong, drive)
    assert plain.min() < 0
    assert (near > 0).all()
    assert (less <= std * (1 + 1e-9)).all()


def test_torques_that_tell_a_rotor_are_believed():
    drive = PDDrive(KP, KD)
    recording = drive.driven(record(0.008))
    found, _ = rotors(described(3 * ARMATURE), recording, drive)
    # That of the first joint is told only together with the inertia about its axis.
    assert_allclose(found[1:], ARMATURE[1:], rtol=1e-3)
