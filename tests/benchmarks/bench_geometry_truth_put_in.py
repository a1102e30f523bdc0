"""Faults of the geometry and of the channels, put into recordings of real robots.

Run ``python tests/benchmarks/bench_geometry_truth_put_in.py --sets development
--data-home DIR [--out FILE] [--write]``; ``--sets confirmation`` is run once, see
``README.md``.

Data, filters, masks and declared friction are those of `MANIPULATED_SETS`: TX40 and
UR5 for development, the Panda to confirm. Put in, one at a time: the gravity of the
model that is handed over is rotated by 2 and 4 degrees about x and about y; the
positions of a joint read 4 degrees too much; the torque of a joint is scaled by 0.8
and by 1.25. Zeros are put into the two joints that show them most and the two that
show them least, gains into the joint that shows it most and the one that does so least.

What can be seen is decided without the library (``_undeclared_told_apart.py``): bodies
and declared friction are fitted to the recording, the change is made to the torque of
that fit, and what the changed model's bodies and friction leave of it is compared with
what the declared model leaves of the recording in its band, joint by joint. Above
`SHOWN` times that rest, all joints together, the fault is to be named and valued. Below
`HIDDEN` it is to be called invisible, by the search (no fault is named) and by the
declared model that has it as an effect (its coefficient is not identifiable). Between
them it may be named or not: the rest of a real robot is no noise, and has by chance
some per cent in common with anything, which is more than the tolerance of a value
there.

The truth is relative to the recording as it is: where the loop names the same effect
there, its value is that much more. Values are within `TOLERANCE` of what was put in,
signs included. Beside it stands the value with which the effect alone, added to the
declared model, is fitted to the recording as it is: a robot has faults of its own.
"""

import sys
import time
import warnings
from dataclasses import dataclass

import _manipulations as put
import numpy as np
from _ledger import Ledger
from _protocol_sets import MANIPULATED_SETS, STAGES
from _report import parser, publish, rst_table, rst_title
from _undeclared_faults import PARAMETERS, Fault
from _undeclared_told_apart import Teller
from bench_geometry import rivals_of
from sklearn.base import clone

from sklearn_vbjfa import EffectDiscovery, effects
from sklearn_vbjfa.physical import ProjectionError

TILTS = (2.0, 4.0)
ZERO = 4.0
GAINS = (0.8, 1.25)
ABOUT = "xy"
TOLERANCE = 0.15
SHOWN, HIDDEN = 0.5, 1e-3
UNTOUCHED = "as recorded"
CLASSES = {
    "base_tilt": "BaseTilt",
    "joint_zero": "JointZero",
    "joint_axis": "JointAxis",
    "torque_gain": "TorqueGain",
}


@dataclass(frozen=True, kw_only=True)
class PutIn:
    """A fault to put into a recording.

    Attributes
    ----------
    label : str
        The fault in words; joints from one.
    fault : Fault
        What the loop should say is wrong with the robot or its channels.
    change : callable
        (model, q, tau) -> the same with the fault.
    seen : float
        What bodies and friction leave of it, over the rest of the declared model.
    """

    label: str
    fault: Fault
    change: object
    seen: float

    @property
    def expected(self):
        """What is to be said of it: "shown", "hidden" or "either"."""
        if self.seen >= SHOWN:
            return "shown"
        return "hidden" if self.seen < HIDDEN else "either"


def _tilted(degrees, axis):
    fault = -np.deg2rad(degrees) * np.eye(2)[axis]
    return (
        f"gravity of the model rotated by {degrees:g} degrees about {ABOUT[axis]}",
        # the model's gravity is turned, so that the robot's is turned back
        Fault("base_tilt", 0, tuple(fault.tolist())),
        lambda model, q, tau: (put.rotate_gravity(model, degrees, axis), q, tau),
    )


def _shifted(joint):
    return (
        f"position {joint + 1} shifted by {ZERO:g} degrees",
        Fault("joint_zero", joint, (float(np.deg2rad(ZERO)),)),
        lambda model, q, tau: (model, put.shift_zero(q, joint, ZERO), tau),
    )


def _scaled(joint, gain):
    return (
        f"torque {joint + 1} times {gain:g}",
        Fault("torque_gain", joint, (gain,)),
        lambda model, q, tau: (model, q, put.scale_channel(tau, joint, gain)),
    )


def visibility(model, states, tau, declared, rest):
    """Return a function that says how much of a change the declared columns leave.

    Parameters
    ----------
    model : pinocchio.Model
        Robot as declared.
    states : ndarray of shape (n, 3 nv)
        [q | v | a].
    tau : ndarray of shape (n, nv)
        Torques.
    declared : tuple of str
        Declared friction.
    rest : ndarray of shape (nv,)
        What the declared model leaves of the torques in the band of the fit, root mean
        square.
    """
    nv = tau.shape[1]
    further = []
    if "rotor_inertia" in declared:
        # a factor for each joint
        further = list(np.einsum("ni,ji->jni", states[:, 2 * nv :], np.eye(nv)))
    plain = tuple(name for name in declared if name != "rotor_inertia")
    first = Teller(model, states, tau, tau.std(axis=0), plain, further)
    theta = first.coefficients()
    torque = first.torque_of([], theta)
    q, v, a = np.split(states[first.rows], 3, axis=1)
    further = [x[first.rows] for x in further]

    def seen(change):
        changed, read, channels = change(model, q, torque)
        _, _, scaled = change(model, q[:1], rest[None])
        teller = Teller(
            changed, np.hstack([read, v, a]), channels, scaled[0], plain, further
        )
        return teller.explain([]).rms

    return seen


def cases(model, seen):
    """All faults that are put into a robot, as a list of `PutIn`.

    Parameters
    ----------
    model : pinocchio.Model
        Robot.
    seen : callable
        Of `visibility`.
    """
    zeros = sorted((_shifted(j) for j in range(model.nv)), key=lambda x: -seen(x[2]))
    gains = sorted(
        ([_scaled(j, gain) for gain in GAINS] for j in range(model.nv)),
        key=lambda x: -seen(x[0][2]),
    )
    tilts = [_tilted(degrees, axis) for axis in range(2) for degrees in TILTS]
    ends = list(dict.fromkeys([0, 1, model.nv - 2, model.nv - 1]))
    wanted = [*tilts, *(zeros[i] for i in ends), *gains[0], *gains[-1]]
    return [
        PutIn(label=label, fault=fault, change=change, seen=float(seen(change)))
        for label, fault, change in wanted
    ]


def close(identifier, model, q, tau, groups, **settings):
    """Close the loop; return what was named and the errors, as plain numbers."""
    loop = EffectDiscovery(
        clone(identifier).set_params(model=model),
        random_state=0,
        **settings,
    )
    started = time.perf_counter()
    try:
        loop.fit(q, tau, groups=groups)
    except (ValueError, ProjectionError) as error:
        return {"message": str(error), "seconds": time.perf_counter() - started}
    return {
        "message": "",
        "found": [
            {
                "name": e.name,
                "joint": e.joint,
                "values": [
                    float(e.parameters[name]) for name in PARAMETERS.get(e.name, ())
                ],
                "rivals": rivals_of(e, loop.joint_names_),
            }
            for e in loop.effects_
        ],
        "before": loop.error_before_.tolist(),
        "after": loop.error_after_.tolist(),
        "seconds": time.perf_counter() - started,
    }


def fitted_alone(identifier, fault, model, q, tau, groups):
    """Fit the declared model with one effect more.

    Returns
    -------
    values : list of float or None
        Values of the effect; None if the library does not have it.
    hidden : bool or None
        Whether the model says that it cannot see the effect.
    """
    make = getattr(effects, CLASSES[fault.name], None)
    if make is None:
        return None, None
    robot = clone(identifier).set_params(model=model, effects=[make(fault.joint)])
    robot.fit(q, tau, groups=groups)
    (effect,) = robot.effects_
    values = [float(getattr(effect, name)) for name in PARAMETERS[fault.name]]
    at = [i for i, x in enumerate(robot.parameter_names_) if fault.name in x]
    return values, bool(at) and not np.all(robot.identifiable_[at])


def faults_of(found):
    """Return the faults among what was named, by name and joint."""
    return {
        (e["name"], e["joint"]): e["values"] for e in found if e["name"] in PARAMETERS
    }


def truth_beside(fault, reference):
    """Return what a fault comes to on top of what is named on the recording as it is.

    Parameters
    ----------
    fault : Fault
        What was put in.
    reference : dict
        Of `close`, for the recording as it is.

    Returns
    -------
    ndarray
        Values.
    """
    own = faults_of(reference["found"]).get(fault.key)
    if own is None:
        return np.array(fault.values)
    if fault.name == "torque_gain":
        return np.array(own) * fault.values
    return np.array(own) + fault.values


def verdict(case, answer, reference):
    """Judge what was named.

    Parameters
    ----------
    case : dict
        ``fault`` and ``expected`` of a `PutIn`.
    answer, reference : dict
        Of `close`, for the case and for the recording as it is.

    Returns
    -------
    text : str
        "named", "named, value off", "as a rival", "not named", "misnamed",
        "invisible" (rightly: nothing is named and the model says it is hidden),
        "not named, not called invisible", "named though hidden", "refused".
    right : bool
        Whether that is what it should be.
    """
    if answer["message"]:
        return "refused", False
    fault = case["fault"]
    named = faults_of(answer["found"])
    before = faults_of(reference["found"])
    new = [key for key in named if key not in before]
    expected = case["expected"]
    if fault.key in named and (expected != "hidden" or fault.key in new):
        neutral = 1.0 if fault.name == "torque_gain" else 0.0
        off = np.linalg.norm(named[fault.key] - truth_beside(fault, reference))
        size = np.linalg.norm(np.array(fault.values) - neutral)
        if off <= TOLERANCE * size:
            return "named", True
        return "named, value off", expected == "either"
    if any(list(fault.key) in map(list, e["rivals"]) for e in answer["found"]):
        return "as a rival", expected != "hidden"
    if new:
        return ("named though hidden" if expected == "hidden" else "misnamed"), False
    if expected == "shown":
        return "not named", False
    if case["hidden"] or expected == "either":
        return "invisible" if case["hidden"] else "not named", True
    return "not named, not called invisible", False


def run_set(name, data_home=None, recording=None, ledger=None, limit=None, **settings):
    """Judge all faults of one robot.

    Parameters
    ----------
    name : str
        Set.
    data_home : str, default=None
        Folder of the measured sets.
    recording : Recording, default=None
        In place of the measured one, for a trial at small size.
    ledger : Ledger, default=None
        Results so far.
    limit : int, default=None
        Number of faults; all by default.
    **settings
        Arguments of `EffectDiscovery`.

    Returns
    -------
    list of dict
        That of the recording as it is first.
    """
    frozen = MANIPULATED_SETS[name]
    ledger = ledger or Ledger(None, ("set", "label"))
    recording = recording or frozen.recording(data_home)
    model = recording.robot_model()
    q, tau, groups = recording.q, recording.tau, recording.groups
    identifier = frozen.identifier(model, recording.dt)
    declared = frozen.identifier(recording.robot_model(), recording.dt)
    declared.fit(q, tau, groups=groups)
    states = declared.state_estimator_.transform(q, groups=groups)
    rest = declared.residuals(q, tau, groups=groups).rms()
    seen = visibility(model, states, tau, frozen.friction, rest)
    chosen = cases(model, seen)[:limit]
    tasks = [{"set": name, "label": x} for x in [UNTOUCHED, *(c.label for c in chosen)]]
    if ledger.missing(tasks[:1]):
        answer = close(identifier, model, q, tau, groups, **settings)
        ledger.add({**tasks[0], **answer})
    reference = ledger.of(tasks[:1])[0]
    for case, task in zip(chosen, tasks[1:]):
        if not ledger.missing([task]):
            continue
        changed = case.change(model, q, tau)
        answer = close(identifier, *changed, groups, **settings)
        as_is, _ = fitted_alone(identifier, case.fault, model, q, tau, groups)
        _, hidden = fitted_alone(identifier, case.fault, *changed, groups)
        about = {
            "fault": case.fault,
            "expected": case.expected,
            "hidden": bool(hidden),
        }
        text, right = verdict(about, answer, reference)
        result = {
            **task,
            **answer,
            **about,
            "fault": [case.fault.name, case.fault.joint, list(case.fault.values)],
            "seen": case.seen,
            "as_is": as_is,
            "verdict": text,
            "right": right,
        }
        ledger.add(result)
        print(" | ".join(row(result, reference)), file=sys.stderr, flush=True)
    return ledger.of(tasks)


def plain(name, values):
    """Values in degrees, a gain as it is."""
    if values is None:
        return "–"
    shown = values if name == "torque_gain" else np.rad2deg(values)
    return ", ".join(f"{x:.2f}" for x in np.atleast_1d(shown))


def _words(found):
    pairs = [f"{e['name']} {e['joint'] + 1}" for e in found]
    return ", ".join(pairs) or "nothing"


HEADERS = [
    "put in",
    "what to say",
    "verdict",
    "found",
    "left over rest",
    "value",
    "should be",
    "as recorded, fitted alone",
    "before, mean [%]",
    "after",
    "as recorded, after",
    "s",
]


def row(result, reference):
    """Row of the table."""
    if result["message"]:
        return [result["label"], "–", "refused", result["message"], *["–"] * 8]
    mean = [f"{100 * np.nanmean(result[key]):.1f}" for key in ("before", "after")]
    rest = f"{100 * np.nanmean(reference['after']):.1f}"
    seconds = f"{result['seconds']:.0f}"
    if result["label"] == UNTOUCHED:
        found = _words(result["found"])
        return [UNTOUCHED, "–", "–", found, *["–"] * 4, *mean, rest, seconds]
    name, joint, values = result["fault"]
    fault = Fault(name, joint, tuple(values))
    return [
        result["label"],
        result["expected"],
        result["verdict"],
        _words(result["found"]),
        f"{result['seen']:.2f}",
        plain(name, faults_of(result["found"]).get(fault.key)),
        plain(name, truth_beside(fault, reference)),
        plain(name, result["as_is"]),
        *mean,
        rest,
        seconds,
    ]


def report(by_set):
    """Text with a table for each robot.

    Parameters
    ----------
    by_set : dict of str to list of dict
        Results of `run_set`.
    """
    parts = []
    for name, results in by_set.items():
        judged = [r for r in results[1:] if not r["message"]]
        counts = [
            f"{sum(r['right'] for r in own)} of {len(own)} {kind}"
            for kind in ("shown", "hidden", "either")
            if (own := [r for r in judged if r["expected"] == kind])
        ]
        parts += [
            rst_title(name, "~"),
            f"{MANIPULATED_SETS[name].describe()}. Right: {', '.join(counts)}.",
            rst_table([row(r, results[0]) for r in results], HEADERS, n_labels=4),
        ]
    parts.append(
        "Left over rest: what another fit of bodies and friction leaves of the fault, "
        "over what the declared model leaves of the recording. Values in degrees, a "
        "tilt as roll and pitch; gains as they are."
    )
    return "\n\n".join(parts)


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--sets", choices=STAGES, default="development")
    arguments.add_argument(
        "--data", nargs="*", default=None, help="some of the sets only"
    )
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument("--limit", type=int, default=None, help="faults a robot")
    arguments.add_argument(
        "--out", default=None, metavar="FILE", help="results so far, as JSON lines"
    )
    arguments = arguments.parse_args(argv)
    known = [n for n, s in MANIPULATED_SETS.items() if s.stage == arguments.sets]
    chosen = arguments.data or known
    if not set(chosen) <= set(known):
        raise SystemExit(f"--data must name some of {', '.join(known)}.")
    ledger = Ledger(arguments.out, ("set", "label"))
    by_set = {}
    for name in chosen:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            by_set[name] = run_set(
                name, arguments.data_home, ledger=ledger, limit=arguments.limit
            )
    publish(
        f"geometry_truth_put_in_{arguments.sets}",
        report(by_set),
        write=arguments.write,
        command="python tests/benchmarks/bench_geometry_truth_put_in.py "
        f"--sets {arguments.sets}",
        states=ledger.states(),
    )


if __name__ == "__main__":
    main()
