"""Forward kinematics of all rows at once, against Pinocchio row by row."""

import numpy as np
import pytest

pin = pytest.importorskip("pinocchio")

from sklearn_vbjfa.model import JointPoses  # noqa: E402
from tests.model._robots import random_tree  # noqa: E402


@pytest.mark.parametrize("seed", range(5))
def test_frames_and_screws_are_those_of_pinocchio(seed):
    rng = np.random.default_rng(seed)
    model, _ = random_tree(rng, 7)
    q = rng.normal(size=(4, model.nv))
    poses = JointPoses(model)(q)
    data = model.createData()
    for row in range(len(q)):
        jacobian = pin.computeJointJacobians(model, data, q[row])
        for body in range(model.nv + 1):
            np.testing.assert_allclose(
                poses.axes[row, body], data.oMi[body].rotation, atol=1e-12
            )
            np.testing.assert_allclose(
                poses.origins[row, body], data.oMi[body].translation, atol=1e-12
            )
        np.testing.assert_allclose(poses.linear[row], jacobian[:3].T, atol=1e-12)
        np.testing.assert_allclose(poses.angular[row], jacobian[3:].T, atol=1e-12)
