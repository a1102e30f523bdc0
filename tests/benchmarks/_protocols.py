"""How the measured sets are evaluated."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa import datasets


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """How one recording is evaluated."""

    load: Callable  # loader; takes `data_home` (but for the demo)
    # names of the recordings to fit and to test; empty for a split in time
    train: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    # with a split in time: the first share of every recording of `train`, by default of
    # all, is fitted, and the rest of those is tested
    share: float = 0.7
    cutoff: float | str = "auto"  # low-pass [Hz]
    # speed [rad/s or m/s] at or below which a joint counts as standing still
    standstill: float | str = "auto"
    friction: tuple[str, ...] = ("viscous", "coulomb", "offset", "rotor_inertia")

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
        """Describe what was fitted and what was tested."""
        if self.test:
            return f"fitted: {', '.join(self.train)}; held out: {', '.join(self.test)}"
        names = ", ".join(self.train or recording.group_names)
        return f"first {100 * self.share:.0f} % of {names} fitted, the rest held out"


def protocols():
    """Return name -> `Protocol` of the demo and every set."""
    # Taken from what is published about the sets and their quick fits, not tuned on the
    # held-out part.
    found = {"demo": Protocol(load=datasets.load_demo_recording)}
    for name, entry in datasets.SETS.items():
        settings = {
            key: tuple(value) if isinstance(value, list) else value
            for key, value in entry["protocol"].items()
        }
        found[name] = Protocol(load=getattr(datasets, f"fetch_{name}"), **settings)
    return found
