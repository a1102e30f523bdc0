"""Projection of the bodies while the effects' coefficients follow."""

import numpy as np
import pytest

pin = pytest.importorskip("pinocchio")

from sklearn_vbjfa.datasets import make_robot_recording  # noqa: E402
from sklearn_vbjfa.fit._estimate import project_beside  # noqa: E402
from sklearn_vbjfa.robot._spreads import min_eigenvalues  # noqa: E402


def problem(extra):
    """Return model, estimate and metric with further columns beside the bodies'."""
    recording = make_robot_recording(duration=4.0, dt=0.02, random_state=0)
    model = recording.robot_model()
    p = 10 * model.nv
    rng = np.random.default_rng(3)
    data = pin.Model.createData(model)
    states = rng.normal(size=(60, 3, model.nv))
    Phi = np.concatenate(
        [pin.computeJointTorqueRegressor(model, data, *state) for state in states]
    )
    rows = np.hstack([Phi, extra(Phi, rng)])
    theta = np.r_[recording.inertial.ravel() + rng.normal(scale=0.3, size=p), 1.0]
    return model, theta, rows.T @ rows, p


def test_effects_follow_to_the_minimum():
    """Beside the projected bodies no other coefficient is nearer to the estimate."""
    model, theta, metric, p = problem(lambda Phi, rng: rng.normal(size=(len(Phi), 1)))
    _, projected = project_beside("default", model, theta, metric, ())
    assert (min_eigenvalues(projected[:p].reshape(model.nv, 10)) > 0).all()
    change = projected - theta
    gradient = metric[p:] @ change
    assert (np.abs(gradient) < 1e-9 * np.abs(metric[p:]) @ np.abs(change)).all()


def test_a_column_that_bodies_explain_leaves_no_negative_metric():
    """The Schur complement of a copied column is zero up to rounding."""
    model, theta, metric, p = problem(lambda Phi, rng: 1e3 * Phi[:, [9]])
    _, projected = project_beside("default", model, theta, metric, ())
    assert np.isfinite(projected).all()
    assert (min_eigenvalues(projected[:p].reshape(model.nv, 10)) > 0).all()
