"""The table of hypotheses: what may have been done to a log."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa.inspection import _numbers as number
from sklearn_vbjfa.inspection import _positions as positions
from sklearn_vbjfa.inspection import _scene as scene
from sklearn_vbjfa.inspection import _torques as torques
from sklearn_vbjfa.inspection._sentences import finding


@dataclass(frozen=True)
class Hypothesis:
    """One row of the table; its sentence, with the remedy, is that of its name."""

    name: str
    severity: str
    propose: Callable  # returns the best `Candidate` for a reading, or None
    needs: str = ""  # property of a reading that can show it
    # When it is looked for: always, only if torques agree badly with the description
    # or another hypothesis is probable, after all others, or if nothing was found.
    when: str = "always"
    unclear: str = ""  # kind of the note if a candidate is probable but not clear
    prior: float = number.PRIOR  # log odds against the log as it is

    def candidate(self, reading):
        """Return the best candidate and its log odds if it is probable, or None."""
        applies = not self.needs or getattr(reading, self.needs)
        found = self.propose(reading) if applies else None
        odds = found.log_odds + self.prior if found else -np.inf
        return (found, odds) if odds > number.DECISIVE else None

    def finding(self, reading, candidate, odds, rivals=(), unclear=False):
        """Return the finding; rivals: names of hypotheses that are as probable."""
        evidence = f"log odds {odds:.0f}"
        if candidate.fall > 0:
            fall = np.exp(candidate.fall / reading.robot.joints.size)
            evidence = f"squared errors fall by the factor {fall:.3g}, {evidence}"
        return finding(
            self.unclear if unclear else candidate.kind or self.name,
            reading.names,
            candidate.joints,
            "note" if unclear else candidate.severity or self.severity,
            value=candidate.value,
            remedy=None if unclear else candidate.remedy,
            rivals=rivals,
            evidence=evidence,
            **candidate.facts,
        )


# fmt: off
TABLE = (
    # -- positions and time
    Hypothesis("position_unit", "error", positions.units, "turns"),
    Hypothesis("position_zeros", "error", positions.zeros, "zeroed",
               unclear="unverified:zeros"),
    Hypothesis("swapped_torques", "error", positions.torque_orders, "several", "poor"),
    Hypothesis("swapped_positions", "error", positions.position_orders, "several",
               "poor"),
    Hypothesis("swapped_joints", "error", positions.joint_orders, "several", "poor"),
    Hypothesis("flipped_joint", "error", positions.flipped, when="poor"),
    Hypothesis("position_sign", "error", positions.mirrored, when="poor"),
    # A warning: another mounting or tool looks the same, with a wrong geometry only.
    Hypothesis("position_zero", "warning", positions.zero, when="poor"),
    Hypothesis("wrong_dt", "error", positions.periods),
    # -- torques
    Hypothesis("torque_sign", "error", torques.signs, "measured"),
    Hypothesis("torque_unit", "warning", torques.scaled, "measured"),
    Hypothesis("torque_factors", "warning", torques.scaled_each, "measured"),
    Hypothesis("gear_factor", "warning", torques.commanded_size, "commanded"),
    Hypothesis("computed_torque", "warning", torques.computed, "measured"),
    Hypothesis("silent_torque", "error", torques.silent, "measured"),
    # -- scene
    Hypothesis("no_gravity", "error", scene.weightless, "weighs"),
    Hypothesis("gravity_only", "error", scene.weight_alone, "weighs"),
    Hypothesis("base_orientation", "error", scene.turned, "weighs"),
    Hypothesis("external_force", "warning", scene.contact, "unexplained", "last"),
    Hypothesis("delay", "note", scene.late, "measured", "last"),
    Hypothesis("torque_unit", "warning", torques.beyond_limits, "measured", "last"),
    Hypothesis("other_robot", "warning", torques.of_another, "unexplained",
               "nothing else"),
)
# fmt: on
