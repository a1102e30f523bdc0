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
    repairs: bool = True  # whether its change undoes what was done
    unclear: str = ""  # kind of the warning if a candidate is probable but not clear
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
            "warning" if unclear else candidate.severity or self.severity,
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
    # A doubt: another mounting or tool looks the same, with a wrong geometry only.
    Hypothesis("position_zero", "doubt", positions.zero, when="poor"),
    Hypothesis("wrong_dt", "error", positions.periods),
    # -- torques
    Hypothesis("torque_sign", "error", torques.signs, "measured"),
    Hypothesis("torque_unit", "doubt", torques.scaled, "measured"),
    Hypothesis("torque_factors", "doubt", torques.scaled_each, "measured"),
    Hypothesis("gear_factor", "doubt", torques.commanded_size, "commanded"),
    Hypothesis("computed_torque", "doubt", torques.computed, "measured", repairs=False),
    Hypothesis("silent_torque", "error", torques.silent, "measured", repairs=False),
    # -- scene
    Hypothesis("no_gravity", "error", scene.weightless, "weighs", repairs=False),
    Hypothesis("gravity_only", "error", scene.weight_alone, "weighs", repairs=False),
    Hypothesis("base_orientation", "error", scene.turned, "weighs"),
    Hypothesis("external_force", "doubt", scene.contact, "unexplained", "last",
               repairs=False),
    Hypothesis("delay", "warning", scene.late, "measured", "last", repairs=False),
    Hypothesis("torque_unit", "doubt", torques.beyond_limits, "measured", "last",
               repairs=False),
    Hypothesis("other_robot", "doubt", torques.of_another, "unexplained",
               "nothing else", repairs=False),
)
# fmt: on
