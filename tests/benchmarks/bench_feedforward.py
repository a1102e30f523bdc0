"""How much torque feedforward leaves to feedback, on measured robots.

Run as ``python tests/benchmarks/bench_feedforward.py --data-home DIR``; without
``--data-home`` the sets are downloaded. Root mean square of what a model misses of the
measured torque, over that of the torque itself, on the held-out part: 100 % is what no
feedforward at all leaves. Splits, low-pass, mask and friction columns are those of
``bench_measured_robots.py``.
"""

import sys
import time
import warnings

import numpy as np
from _report import fixed, parser, publish, rst_table, rst_title
from sklearn.base import clone

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import protocols, rigid_torques
from sklearn_vbjfa.physical import ProjectionError

ROBOTS = ("ur5", "staubli_tx40", "kuka_kr300")
# Torques [N m] that a set has from the robot's or its authors' own model.
OWN_MODELS = {
    "ur5": {"the controller's rigid model": ("m_target",)},
    "kuka_kr300": {
        "the authors' gravity": ("tau_grav_model",),
        "the authors' feedforward": ("tau_ff",),
    },
}
# What was asked of the robot: positions alone, or states.
DESIRED = {
    "ur5": ("q_target", "qd_target", "qdd_target"),
    "kuka_kr300": ("q_ref",),
}
NOTHING = "nothing fed forward"
URDF = "URDF"
IDENTIFIED = "RobotIdentifier"
COMPLETED = "completed by EffectDiscovery"
AHEAD = ", from the desired motion"


def load(name, data_home):
    """Return the recording, the declared model, and rows to fit and to test."""
    protocol = protocols()[name]
    access = {} if name == "demo" else {"data_home": data_home}
    recording = protocol.load(**access)
    identifier = RobotIdentifier(
        recording.robot_model(),
        dt=recording.dt,
        friction=protocol.friction,
        cutoff=protocol.cutoff,
        standstill=protocol.standstill,
    )
    return recording, identifier, protocol.split(recording)


def left_for_feedback(torque, predicted, weight):
    """Root mean square of the torque missed over that of the torque, each joint."""
    missed = (weight * (torque - predicted) ** 2).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.sqrt(missed / (weight * torque**2).sum(axis=0))


class GivenModel:
    """A model that comes with the set: its torques, as they are or brought to scale.

    Parameters
    ----------
    torques : ndarray of shape (n_samples, nv)
        What it says along the whole recording [N m].
    states : ndarray of shape (n_samples, 3 * nv)
        Smoothed states of the recording, for the friction.
    """

    def __init__(self, torques, states):
        _, v, a = np.split(states, 3, axis=1)
        self.columns = (torques, v, np.sign(v), np.ones_like(v), a)

    def answers(self, identifier, recording, train, test):
        """Errors as it is, and with scale, friction and rotor inertia fitted.

        Parameters
        ----------
        identifier : RobotIdentifier
            Fitted; gives low-pass and mask.
        recording : Recording
            Positions and torques.
        train, test : ndarray of int
            Rows.

        Returns
        -------
        plain, fitted : ndarray of shape (nv,)
            Shares of the torque that are left.
        """
        fit_to, columns, weight = self._filtered(identifier, recording, train)
        torque, unseen, counts = self._filtered(identifier, recording, test)
        plain = left_for_feedback(torque, unseen[0], counts)
        predicted = np.empty_like(torque)
        for j in range(torque.shape[1]):
            root = np.sqrt(weight[:, j])
            A = columns[:, :, j].T * root[:, None]
            theta = np.linalg.lstsq(A, fit_to[:, j] * root, rcond=None)[0]
            predicted[:, j] = theta @ unseen[:, :, j]
        return plain, left_for_feedback(torque, predicted, counts)

    def _filtered(self, identifier, recording, rows):
        """Torque, columns and weights behind the identifier's low-pass."""
        q, groups = recording.q[rows], recording.groups[rows]
        measured = identifier.residuals(q, recording.tau[rows], groups)
        columns = [
            identifier.residuals(q, x[rows], groups).torque for x in self.columns
        ]
        return measured.torque, np.array(columns), measured.weight


def complete(identifier, part, effects="all"):
    """Search the training part for effects, then fit all of it with them."""
    loop = EffectDiscovery(identifier, effects=effects, random_state=0)
    loop.fit(*part[:2], groups=part[2])
    found = loop.identifier_.effects
    completed = clone(identifier).set_params(effects=found)
    return completed.fit(*part[:2], groups=part[2]), loop


def _describe(loop):
    names = [f"{effect.name} {effect.joint + 1}" for effect in loop.effects_]
    return ", ".join(names) or "nothing"


def _answers(model, recording, rows, X):
    found = model.residuals(X[rows], recording.tau[rows], recording.groups[rows])
    return left_for_feedback(found.torque, found.predicted, found.weight)


def measure(name, data_home, effects="all"):
    """Return label -> share left for feedback of each joint; a note; the recording."""
    recording, declared, (train, test) = load(name, data_home)
    part = recording.q[train], recording.tau[train], recording.groups[train]
    identified = clone(declared).fit(*part[:2], groups=part[2])
    models, note = {IDENTIFIED: identified}, ""
    try:
        models[COMPLETED], loop = complete(declared, part, effects)
    except (ValueError, ProjectionError) as error:
        note = f"{COMPLETED} failed: {error}"
    else:
        note = f"Found in the fitted part, joint from 1, in order: {_describe(loop)}."
    states = identified.state_estimator_.transform(recording.q, groups=recording.groups)
    given = {URDF: rigid_torques(recording.robot_model(), states)}
    for label, signals in OWN_MODELS.get(name, {}).items():
        given[label] = sum(recording.signals[signal] for signal in signals)
    rows = {NOTHING: np.ones(recording.q.shape[1])}
    for label, torques in given.items():
        model = GivenModel(torques, states)
        plain, fitted = model.answers(identified, recording, train, test)
        rows[label] = plain
        rows[f"{label}, scale and friction fitted"] = fitted
    for label, model in models.items():
        rows[label] = _answers(model, recording, test, recording.q)
    if name in DESIRED:
        X = np.hstack([recording.signals[signal] for signal in DESIRED[name]])
        for label, model in models.items():
            rows[label + AHEAD] = _answers(model, recording, test, X)
    return rows, note, recording


def section(name, rows, note, recording):
    """Paragraphs of one robot."""
    headers = ["left [%]", *(f"j{j + 1}" for j in range(len(rows[NOTHING]))), "mean"]
    cells = [
        [label, *fixed(100 * share), *fixed([100 * np.nanmean(share)])]
        for label, share in rows.items()
    ]
    split = protocols()[name].describe(recording)
    return [
        rst_title(name, "~"),
        f"{split[0].upper()}{split[1:]}.",
        rst_table(cells, headers),
        note,
    ]


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument("--data", nargs="*", default=ROBOTS, choices=ROBOTS)
    arguments = arguments.parse_args(argv)
    paragraphs = []
    for name in arguments.data:
        started = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            paragraphs += section(name, *measure(name, arguments.data_home))
        seconds = time.perf_counter() - started
        print(f"{name}: {seconds:.0f} s", file=sys.stderr, flush=True)
    text = "\n\n".join(
        [
            "Root mean square of the torque that a model misses over that of the "
            "torque, held-out part, behind the low-pass and the mask.",
            *paragraphs,
        ]
    )
    publish("feedforward", text, write=arguments.write)


if __name__ == "__main__":
    main()
