"""How each measured set is evaluated: split, filter, mask, friction columns.

Taken from what is published about the sets and their quick fits, not tuned on the
held-out part.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from sklearn_vbjfa.datasets._fetch_benches import fetch_emps, fetch_tflex_1dof
from sklearn_vbjfa.datasets._fetch_industrial import (
    fetch_kuka_kr300,
    fetch_staubli_tx40,
    fetch_ur5,
)
from sklearn_vbjfa.datasets._fetch_pendulums import (
    fetch_bam_xl330,
    fetch_dfki_double_pendulum,
)
from sklearn_vbjfa.datasets._fetch_research import (
    fetch_franka_panda,
    fetch_kuka_lbr_med7,
    fetch_tiago,
)
from sklearn_vbjfa.datasets._robots import load_demo_recording

_ALL = ("viscous", "coulomb", "offset", "rotor_inertia")


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """Evaluation of one recording.

    Attributes
    ----------
    load : callable
        Loader; takes `data_home` (but for the demo).
    train, test : tuple of str
        Names of the recordings to fit and to test; empty for a split in time.
    share : float
        With a split in time: this first share of every recording of `train` (all
        without names) is fitted, the rest of those is tested.
    cutoff : float or "auto"
        Low-pass [Hz].
    standstill : float or "auto"
        Speed [rad/s or m/s] at or below which a joint counts as standing still.
    friction : tuple of str
        Friction columns.
    """

    load: Callable
    train: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    share: float = 0.7
    cutoff: float | str = "auto"
    standstill: float | str = "auto"
    friction: tuple[str, ...] = _ALL
    options: dict = field(default_factory=dict)

    def split(self, recording):
        """Return the row numbers of the training and of the held-out part."""
        names = np.array(recording.group_names)[recording.groups]
        if self.test:
            fitted = np.isin(names, self.train)
            return np.flatnonzero(fitted), np.flatnonzero(np.isin(names, self.test))
        train, test = [], []
        for label, name in enumerate(recording.group_names):
            if self.train and name not in self.train:
                continue
            rows = np.flatnonzero(recording.groups == label)
            border = int(self.share * rows.size)
            train.append(rows[:border])
            test.append(rows[border:])
        return np.concatenate(train), np.concatenate(test)

    def describe(self, recording):
        """Say in words what was fitted and what was tested."""
        if self.test:
            return f"fitted: {', '.join(self.train)}; held out: {', '.join(self.test)}"
        names = ", ".join(self.train or recording.group_names)
        return f"first {100 * self.share:.0f} % of {names} fitted, the rest held out"


def protocols():
    """Return name -> `Protocol` of every set that the command line knows."""
    return {
        "demo": Protocol(load=load_demo_recording, friction=("viscous", "coulomb")),
        "emps": Protocol(
            load=fetch_emps,
            train=("DATA_EMPS",),
            cutoff=60.0,
            friction=("viscous", "coulomb", "offset"),
        ),
        "ur5": Protocol(
            load=fetch_ur5,
            train=("No6", "No4"),
            test=("No9", "No8"),
            cutoff=8.0,
            standstill=0.03,
        ),
        "staubli_tx40": Protocol(load=fetch_staubli_tx40, share=0.72, cutoff=25.0),
        "kuka_kr300": Protocol(
            load=fetch_kuka_kr300,
            train=("A",),
            test=("B",),
            cutoff=12.0,
            standstill=0.02,
        ),
        "franka_panda": Protocol(load=fetch_franka_panda, cutoff=10.0),
        # A flexure hinge: practically no dry friction.
        "tflex_1dof": Protocol(
            load=fetch_tflex_1dof, cutoff=40.0, friction=("viscous", "offset")
        ),
        "bam_xl330": Protocol(load=fetch_bam_xl330, cutoff=12.0, standstill=0.05),
        "kuka_lbr_med7": Protocol(load=fetch_kuka_lbr_med7, cutoff=4.0),
        "dfki_double_pendulum": Protocol(load=fetch_dfki_double_pendulum, cutoff=12.0),
        "tiago": Protocol(load=fetch_tiago, cutoff=5.0),
    }
