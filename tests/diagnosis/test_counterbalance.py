"""Discovery of a gas spring and the parameters of its linkage."""

import numpy as np
import pytest

from tests.diagnosis._recordings import named, record

# Distances of the attachment points on the frame and on the link [m], and the angle of
# the shortest spring [rad].
FRAME, LINK, NEAREST = 0.5, 0.3, -2.0
RECORDING = record("ZY", seed=3, duration=30.0, size=0.9, noise=0.01)
LIBRARY = ["spring", "counterbalance", "ripple", "stribeck"]


def gas_spring(r):
    """Drive torque that balances a gas spring, from the work of its force."""
    q = r.q[:, 1]

    def length(q):
        corner = LINK * np.exp(1j * (q - NEAREST))
        return np.abs(corner - FRAME)

    def energy(q):
        # Force: 60 N at 0.8 m, stiffness 50 N/m.
        return 60.0 * (0.8 - length(q)) + 25.0 * (0.8 - length(q)) ** 2

    return (energy(q + 1e-5) - energy(q - 1e-5)) / 2e-5


@pytest.mark.slow
def test_a_gas_spring_is_found_with_its_linkage():
    discovery = RECORDING.discover(RECORDING.torque(joint_2=gas_spring), LIBRARY)
    assert named(discovery) == [("counterbalance", 1)]
    values = discovery.effects_[0].parameters
    assert values["form"] == "linkage"
    assert values["ratio"] == pytest.approx(LINK / FRAME, abs=0.1)
    assert values["angle"] == pytest.approx(NEAREST % (2 * np.pi), abs=0.1)
    # Compressive force: 100 N - 50 N/m * length.
    truth = {
        "Fr": -100.0 * LINK,
        "krL": 50.0 * LINK * FRAME,
        "ratio": LINK / FRAME,
        "angle": NEAREST % (2 * np.pi),
    }
    for name, value in truth.items():
        low, high = discovery.effects_[0].intervals[name]
        assert low < value < high
