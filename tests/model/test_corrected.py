"""The corrected model is what a person would build by hand."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

pin = pytest.importorskip("pinocchio")

from sklearn_vbjfa.model import CorrectedModel  # noqa: E402
from tests.model._trees import build  # noqa: E402

KINDS = ("RZ", "RevoluteUnaligned", "PX", "HY", "PrismaticUnaligned")


def robot(kinds=KINDS, seed=0):
    rng = np.random.default_rng(seed)
    model = build(rng, kinds, [*range(len(kinds))])
    for i in range(1, model.njoints):
        model.inertias[i] = pin.Inertia.Random()
    return model


def torques(model, states):
    data = model.createData()
    return np.array([pin.rnea(model, data, *x) for x in zip(*states)])


def motion(nv, n=4, seed=1):
    return np.random.default_rng(seed).uniform(-2.0, 2.0, size=(3, n, nv))


@pytest.mark.parametrize("joint", range(len(KINDS)))
def test_a_zero_is_what_the_encoder_reads_too_much(joint):
    """True torques at q are those of the corrected model at q + zero."""
    model = robot()
    states = motion(model.nv)
    found = CorrectedModel(model)
    found.move_zero(joint, 0.2)
    read = states.copy()
    read[0, :, joint] += 0.2
    assert_allclose(torques(found.model, read), torques(model, states), atol=1e-9)
    assert np.abs(torques(model, read) - torques(model, states)).max() > 1e-3


@pytest.mark.parametrize("kind", ["PX", "PrismaticUnaligned"])
def test_a_slide_whose_axis_is_turned_has_its_zero_along_the_axis(kind):
    """The body is where the encoder, less its zero, says along the turned axis."""
    model = robot((kind, "RZ"))
    axis = CorrectedModel(model).axis(0)
    turned = pin.exp3(np.array([0.1, 0.2, -0.1]))
    found = CorrectedModel(model)
    found.move_zero(0, 0.3)
    found.turn(0, turned)
    data = found.model.createData()
    pin.forwardKinematics(found.model, data, np.array([0.7, 0.0]))
    nominal = model.jointPlacements[1]
    expected = nominal.translation + nominal.rotation @ turned @ axis * (0.7 - 0.3)
    assert_allclose(data.oMi[1].translation, expected, atol=1e-14)
    assert_allclose(data.oMi[1].rotation, nominal.rotation @ turned, atol=1e-14)
