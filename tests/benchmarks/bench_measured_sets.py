"""The measured robots: declared, four plain terms, completed, and other methods.

Run ``python tests/benchmarks/bench_measured_sets.py --sets development --data-home DIR
[--write]``; how often the sets were run stands in ``README.md``.

Filters and masks are those of ``bench_measured_robots.py``, but for EMPS (20 Hz).
Split: the loop's own. Every model is fitted to the rows that the loop searched and
judged on those that it held out, in the same band and with the same mask; errors
are root mean squares over the spread of the torque in the moving time of the whole
recording, as in the report.

- declared: what the loop is told, ten inertial parameters and viscous friction a joint.
- four terms: viscous and Coulomb friction, offset and rotor inertia on every joint, by
  the package's estimator, no search.
- completed: what the loop ends with.

Methods, all with the four terms:

- WLS: least squares, joints weighted by their noise.
- ridge, LASSO, PLS: their strength or number of components (up to the rank of the
  equations) is chosen by cross-validation over five blocks of time of the fitted rows.
- stepwise: forwards and backwards by F-tests.
- IDIM-IV: two-stage least squares. The equations are made of the positions of every
  other sample, the instruments are the regressor matrices of the samples in between,
  both interpolated, differentiated and low-passed alike: their noise is independent
  where the encoder's is white. None of the sets has what a simulation of the closed
  loop would take, the controller.
"""

import json
import time
import warnings

import numpy as np
from _ledger import Ledger
from _perhaps import undecided
from _report import fixed, parser, publish, rst_table
from sklearn.base import clone

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import protocols
from sklearn_vbjfa.diagnosis.explain import split_in_time
from sklearn_vbjfa.effects import Shaped
from sklearn_vbjfa.recording import take_arrays
from sklearn_vbjfa.robot import OURS, collect_residuals, compare_methods, methods

SETS = {
    "development": ("emps", "ur5", "staubli_tx40", "bam_xl330", "tflex_1dof"),
    "confirmation": (
        "kuka_kr300",
        "franka_panda",
        "kuka_lbr_med7",
        "dfki_double_pendulum",
        "tiago",
    ),
}
# Name in the table -> name in the comparison of methods.
RIVALS = {
    "WLS": "WLS",
    "ridge": "ridge",
    "LASSO": "LASSO",
    "PLS": "PLS",
    "stepwise": "stepwise",
    "IDIM-IV": "IV",
}
# Errors of one model computed in two ways agree to this.
SAME = 1e-6
DECLARED = ("viscous",)
PLAIN = ("viscous", "coulomb", "offset", "rotor_inertia")
# Recordings used, where a set has several and the others are another motion's; and
# cut-offs [Hz] of the low-pass where they differ from the comparison of methods.
RECORDINGS = {"emps": ("DATA_EMPS",), "ur5": ("No6",), "kuka_kr300": ("A",)}
CUTOFFS = {"emps": 20.0}
# Seconds of a long recording that are used.
LENGTHS = {"tflex_1dof": 80.0}


def load(name, data_home):
    """Return the recording, its rows in use, and the declared model."""
    protocol = protocols()[name]
    recording = protocol.load(data_home=data_home)
    if name in RECORDINGS:
        recording = recording.select(*RECORDINGS[name])
    rows = np.flatnonzero(recording.t < LENGTHS.get(name, np.inf))
    identifier = RobotIdentifier(
        recording.robot_model(),
        dt=recording.dt,
        friction=DECLARED,
        cutoff=CUTOFFS.get(name, protocol.cutoff),
        standstill=protocol.standstill,
    )
    return recording, rows, identifier


def split_of(loop, q, tau, groups):
    """Return (X, y, groups) of the searched and of the held-out part of a loop.

    Parameters
    ----------
    loop : EffectDiscovery
        Fitted to q and tau.
    q, tau : ndarray of shape (n, nv)
        Positions and torques.
    groups : ndarray of shape (n,)
        Labels.
    """
    dt = loop.identifier.dt
    whole = take_arrays(
        q, tau, groups, None, None, dt=dt, joint_names=loop.joint_names_
    )
    split = split_in_time(loop.identifier, whole, loop.test_size)
    effects = loop.judged_.effects_
    shaped = [e for e in effects if isinstance(e, Shaped)]
    instants = [getattr(e, name) for e in shaped for name in e.jumping]
    guard = round(loop.report_.outcome.settings["guard_seconds"] / dt)
    split = split.decided(whole.t, instants).guarded(guard)
    parts = (split.searched(whole), split.untouched(whole))
    return tuple((part.q, part.tau, part.groups) for part in parts)


def _rank(pieces):
    """Rank of the equations of all pieces, their columns in units of their length."""
    gram = 0.0
    for piece in pieces:
        rows = (piece.Phi * np.sqrt(piece.weight)[:, :, None]).reshape(
            -1, piece.Phi.shape[2]
        )
        gram = gram + rows.T @ rows
    length = np.sqrt(np.diag(gram))
    gram = gram[np.ix_(length > 0, length > 0)]
    length = length[length > 0]
    return int(np.linalg.matrix_rank(gram / np.outer(length, length), hermitian=True))


def partial_least_squares(base, train, test):
    """Errors of PLS on the held-out part, of components up to the equations' rank."""
    settings = dict(methods(len(base.parameter_names_))["PLS"])
    robot = base.robot_
    pieces = robot.pieces(*train)
    counts = sorted({int(c) for c in np.geomspace(1, _rank(pieces), 8)})
    settings["regressor"] = clone(settings["regressor"]).set_params(components=counts)
    model = clone(base).set_params(**settings)
    found = model.estimated(pieces, robot.plan)
    return collect_residuals(robot.pieces(*test), found.theta).normalised_error()


def judge_set(q, tau, groups, identifier, names=tuple(RIVALS), **settings):
    """Close the loop on a recording and judge the other methods beside it.

    Parameters
    ----------
    q, tau, groups : ndarray
        Recording.
    identifier : RobotIdentifier
        Declared model.
    names : sequence of str
        Methods, of `RIVALS`.
    **settings
        Further parameters of `EffectDiscovery`.

    Returns
    -------
    dict
        ``errors``: method -> errors of the joints; effects, failures and times.
    """
    loop = EffectDiscovery(identifier, random_state=0, **settings)
    started = time.perf_counter()
    loop.fit(q, tau, groups)
    seconds = time.perf_counter() - started
    train, test = split_of(loop, q, tau, groups)
    rest = loop.declared_.residuals(test[0], test[1], groups=test[2])
    declared = rest.rms() / loop.torque_spread_
    if not np.allclose(declared, loop.error_before_, atol=SAME, equal_nan=True):
        raise RuntimeError(
            f"The declared model has {declared} on the held-out part; the loop says "
            f"{loop.error_before_}: not the same rows."
        )
    chosen = [OURS, *(RIVALS[name] for name in names if name != "PLS")]
    fuller = clone(identifier).set_params(friction=PLAIN)
    results, base = compare_methods(fuller, train, test, names=chosen)
    by_name = {result.name: result for result in results}
    rest = base.residuals(test[0], test[1], groups=test[2])
    # the comparison divides by the spread of the held-out part alone
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = rest.rms() / rest.normalised_error() / loop.torque_spread_
    errors = {
        "declared": loop.error_before_,
        "four terms": by_name[OURS].error * scale,
        "completed": loop.error_after_,
    }
    for name in names:
        if name == "PLS":
            error = partial_least_squares(base, train, test)
        else:
            error = by_name[RIVALS[name]].error
        errors[name] = error * scale
    return {
        "errors": {name: np.asarray(x).tolist() for name, x in errors.items()},
        "failures": {
            name: result.message
            for name in names
            if (result := by_name.get(RIVALS[name])) and result.message
        },
        "effects": [[e.name, e.joint] for e in loop.effects_],
        "perhaps": [[e.name, e.joint] for e in undecided(loop)],
        "cutoff": float(base.cutoff_),
        "seconds": seconds,
    }


def run(name, data_home=None):
    """Judge all methods on one set, as a dict."""
    recording, rows, identifier = load(name, data_home)
    parts = recording.q[rows], recording.tau[rows], recording.groups[rows]
    with warnings.catch_warnings():
        # How rivals converge is shown by their errors.
        warnings.simplefilter("ignore")
        return {"set": name, **judge_set(*parts, identifier)}


def _mean(values):
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    return finite.mean() if finite.size else np.nan


def _joints_better(results, name):
    """Count the joints on which the completed model is better, and all of them."""
    pairs = [(r["errors"]["completed"], r["errors"][name]) for r in results]
    ours, other = (np.concatenate(x) for x in zip(*pairs))
    known = np.isfinite(ours) & np.isfinite(other)
    return int((ours < other)[known].sum()), int(known.sum())


def _ahead(results, names, means):
    """Say which methods are better than the completed model in the mean, a line a set.

    Better by more than one per cent of its error.
    """
    lines = []
    for i, r in enumerate(results):
        ours = means["completed"][i]
        ahead = [name for name in names if means[name][i] < 0.99 * ours]
        ahead.sort(key=lambda name: means[name][i])
        if ahead:
            told = [f"{name} ({100 * means[name][i]:.1f} %)" for name in ahead]
            told = ", ".join(told)
            lines.append(
                f"Better than the completed model ({100 * ours:.1f} %) in the mean of "
                f"{r['set']}: {told}."
            )
    return lines or ["No method is better than the completed model on any set."]


def report(results):
    """Text with the tables."""
    names = list(results[0]["errors"])
    means = {name: [_mean(r["errors"][name]) for r in results] for name in names}
    rows = [
        [r["set"], *fixed([100 * means[name][i] for name in names])]
        for i, r in enumerate(results)
    ]
    rows.append(["mean", *fixed([100 * _mean(means[name]) for name in names])])
    completed = np.array(means["completed"])
    others = [name for name in names if name != "completed"]
    better = [
        [
            name,
            f"{int(np.sum(completed < np.array(means[name])))} of {len(results)}",
            " of ".join(map(str, _joints_better(results, name))),
        ]
        for name in others
    ]
    joints = [
        [r["set"], name, " ".join(fixed(100 * np.array(r["errors"][name])))]
        for r in results
        for name in names
    ]
    found = [
        [
            r["set"],
            f"{r['cutoff']:.3g}",
            *(
                ", ".join(f"{n} {j + 1}" for n, j in r.get(what, ())) or "nothing"
                for what in ("effects", "perhaps")
            ),
            f"{r['seconds']:.0f}",
        ]
        for r in results
    ]
    failures = [
        f"{r['set']}, {name}: {message}"
        for r in results
        for name, message in r["failures"].items()
    ]
    parts = [
        "Errors on the held-out part over the spread of the torque in the moving time "
        "of the whole recording, mean over the joints [%].",
        rst_table(rows, ["set", *names]),
        rst_table(better, ["completed better than", "sets, in the mean", "joints"]),
        *_ahead(results, names, means),
        rst_table(joints, ["set", "method", "each joint [%]"], n_labels=3),
        rst_table(
            found,
            ["set", "cut-off [Hz]", "found, joint from 1", "perhaps", "s"],
            n_labels=1,
        ),
        *failures,
    ]
    return "\n\n".join(parts)


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--sets", choices=SETS, default="development")
    arguments.add_argument(
        "--data", nargs="*", default=None, help="some of the sets only"
    )
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument(
        "--out", default=None, metavar="FILE", help="results so far, as JSON lines"
    )
    arguments = arguments.parse_args(argv)
    known = SETS[arguments.sets]
    chosen = arguments.data or known
    if not set(chosen) <= set(known):
        raise SystemExit(f"--data must name some of {', '.join(known)}.")
    tasks = [{"set": name} for name in chosen]
    ledger = Ledger(arguments.out, ("set",))
    for task in ledger.missing(tasks):
        result = run(task["set"], arguments.data_home)
        ledger.add(result)
        means = {name: _mean(x) for name, x in result["errors"].items()}
        words = " ".join(f"{name} {100 * x:.1f}" for name, x in means.items())
        print(f"{task['set']}: {words}; {json.dumps(result['effects'])}", flush=True)
    publish(
        f"measured_sets_{arguments.sets}",
        report(ledger.of(tasks)),
        write=arguments.write,
        command="python tests/benchmarks/bench_measured_sets.py "
        f"--sets {arguments.sets}",
        states=ledger.states(tasks),
    )


if __name__ == "__main__":
    main()
