"""A gas spring is named, and its torque known at angles that were not visited."""

import functools

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from sklearn_vbjfa import effects
from tests.diagnosis._recordings import named, record

# Attachment points of the spring: on the frame and on the link [m], and where they are
# nearest [rad].
FRAME, LINK, NEAREST = 0.5, 0.3, -2.0
FITTED = record("ZY", seed=3, duration=30.0, size=0.9, noise=0.01)
WIDER = record("ZY", seed=5, duration=20.0, size=1.5, noise=0.0, encoder=0.0)
LIBRARY = ["spring", "counterbalance", "ripple", "stribeck"]


def gas_spring(r):
    """Torque of the drive against a gas spring, from the work of its force."""
    q = r.q[:, 1]

    def length(q):
        corner = LINK * np.exp(1j * (q - NEAREST))
        return np.abs(corner - FRAME)

    def energy(q):
        # A force of 60 N at 0.8 m that grows by 50 N for each metre less.
        return 60.0 * (0.8 - length(q)) + 25.0 * (0.8 - length(q)) ** 2

    return (energy(q + 1e-5) - energy(q - 1e-5)) / 2e-5


class Harmonics(effects.Counterbalance):
    """The counterbalance of two harmonics alone."""

    def shapes(self, motion):
        return [{"form": "harmonics"}]


@functools.cache
def found(kind):
    library = [n for n in LIBRARY if n != "counterbalance"]
    torque = FITTED.torque(joint_2=gas_spring)
    loop = FITTED.discover(torque, [*library, kind()])
    truth = WIDER.torque(joint_2=gas_spring)
    with pytest.warns(UserWarning, match="Prediction outside the range of the fit"):
        predicted = loop.identifier_.predict(WIDER.position)
    error = (predicted - truth)[:, 1]
    return loop, float(error.std() / truth[:, 1].std())


@pytest.mark.slow
def test_a_gas_spring_is_a_linkage():
    loop, _ = found(effects.Counterbalance)
    assert named(loop) == [("counterbalance", 1)]
    values = loop.effects_[0].parameters
    assert values["form"] == "linkage"
    assert values["ratio"] == pytest.approx(LINK / FRAME, abs=0.1)
    assert values["angle"] == pytest.approx(NEAREST % (2 * np.pi), abs=0.1)
    # It pushes, the harder the shorter it is: with 100 N less 50 N for each metre.
    truth = {
        "Fr": -100.0 * LINK,
        "krL": 50.0 * LINK * FRAME,
        "ratio": LINK / FRAME,
        "angle": NEAREST % (2 * np.pi),
    }
    for name, value in truth.items():
        low, high = loop.effects_[0].intervals[name]
        assert low < value < high


@pytest.mark.slow
def test_it_is_known_beyond_the_angles_of_the_fit():
    reach = [np.ptp(r.q[:, 1]) for r in (FITTED, WIDER)]
    assert reach[1] > 1.3 * reach[0]
    _, linkage = found(effects.Counterbalance)
    loop, harmonics = found(Harmonics)
    assert "counterbalance" in {name for name, _ in named(loop)}
    assert linkage < 0.05
    assert linkage < 0.3 * harmonics
