"""What the frozen protocols fit and judge: sets, filters, masks, declared models.

The numbers are written down here and not taken from the package, so that a later
version of the package is judged by the same ones. They change only together with a
line in ``README.md`` that says why, and with all figures made anew.
"""

from collections.abc import Callable
from dataclasses import dataclass

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import (
    fetch_bam_xl330,
    fetch_dfki_double_pendulum,
    fetch_emps,
    fetch_franka_panda,
    fetch_kuka_kr300,
    fetch_staubli_tx40,
    fetch_ur5,
    load_demo_recording,
)
from sklearn_vbjfa.robot import FitOptions

ALL_FRICTION = ("viscous", "coulomb", "offset", "rotor_inertia")
STAGES = ("development", "confirmation")


@dataclass(frozen=True, kw_only=True)
class FrozenSet:
    """One measured set under a protocol."""

    stage: str
    load: Callable
    cutoff: float
    standstill: float | tuple | str
    friction: tuple = ALL_FRICTION
    leave_out: Callable | None = None
    recordings: tuple = ()

    def recording(self, data_home):
        """Load the recording, with those of its parts that are in use."""
        found = self.load(data_home=data_home)
        return found.select(*self.recordings) if self.recordings else found

    def identifier(self, model, dt):
        """Set up the declared model, not fitted."""
        return RobotIdentifier(
            model,
            dt=dt,
            friction=self.friction,
            cutoff=self.cutoff,
            options=FitOptions(standstill=self.standstill),
        )

    def describe(self):
        """Say filter, mask and declared model in words."""
        speeds = (
            "2 % of the fastest speed"
            if self.standstill == "auto"
            else f"{self.standstill} rad/s or m/s"
        )
        return (
            f"low-pass {self.cutoff:g} Hz, standstill at or below {speeds} left out, "
            f"declared friction {', '.join(self.friction)}"
        )


def pairs(names, leave_out):
    """Return (label, names fitted, names judged) of every label left out once."""
    labels = list(dict.fromkeys(leave_out(name) for name in names))
    return [
        (
            label,
            tuple(name for name in names if leave_out(name) != label),
            tuple(name for name in names if leave_out(name) == label),
        )
        for label in labels
    ]


def own_name(name):
    """Every recording is left out by itself."""
    return name


def gain_of_name(name):
    """All recordings of one position gain are left out together: "kp100_sin_sin"."""
    return name.partition("_")[0]


def load_demo(data_home):
    """Load the embedded recording, for quick runs."""
    return load_demo_recording()


DEMO = FrozenSet(
    stage="quick", load=load_demo, cutoff=20.0, standstill="auto", leave_out=own_name
)

PAIRED_SETS = {
    "demo": DEMO,
    "emps": FrozenSet(
        stage="development",
        load=fetch_emps,
        cutoff=60.0,
        standstill=0.0025,
        # The rotor of a slide cannot be told from its mass.
        friction=("viscous", "coulomb", "offset"),
        leave_out=own_name,
    ),
    "ur5": FrozenSet(
        stage="development",
        load=fetch_ur5,
        cutoff=8.0,
        standstill=0.03,
        leave_out=own_name,
    ),
    "bam_xl330": FrozenSet(
        stage="development",
        load=fetch_bam_xl330,
        cutoff=12.0,
        standstill=0.05,
        leave_out=gain_of_name,
    ),
    "kuka_kr300": FrozenSet(
        stage="confirmation",
        load=fetch_kuka_kr300,
        cutoff=12.0,
        standstill=0.02,
        leave_out=own_name,
    ),
    "dfki_double_pendulum": FrozenSet(
        stage="confirmation",
        load=fetch_dfki_double_pendulum,
        cutoff=12.0,
        standstill=(0.15, 0.33),
        leave_out=own_name,
    ),
}

# Recordings into which a known fault is put. The Panda is on the list of confirmation
# sets; here it is judged by what is put in, not by how well it is predicted.
MANIPULATED_SETS = {
    "demo": DEMO,
    "staubli_tx40": FrozenSet(
        stage="development", load=fetch_staubli_tx40, cutoff=25.0, standstill="auto"
    ),
    "ur5": FrozenSet(
        stage="development",
        load=fetch_ur5,
        cutoff=8.0,
        standstill=0.03,
        recordings=("No4", "No6"),
    ),
    "franka_panda": FrozenSet(
        stage="confirmation",
        load=fetch_franka_panda,
        cutoff=10.0,
        standstill="auto",
    ),
}
