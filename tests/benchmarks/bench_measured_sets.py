"""The measured robots: declared, four plain terms, completed, and other methods.

Run ``python tests/benchmarks/bench_measured_sets.py --sets development --data-home DIR
[--write]``; how often the sets were run stands in ``README.md``.

Filters and masks are those of `_protocols`, but for EMPS (20 Hz).
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
- ridge, LASSO, PLS: strength or number of components by cross-validation over five
  blocks of time of the fitted rows.
- stepwise: forwards and backwards by F-tests.
- IDIM-IV: two-stage least squares. The equations are made of the positions of every
  other sample, the instruments are the regressor matrices of the samples in between,
  both interpolated, differentiated and low-passed alike: their noise is independent
  where the encoder's is white. None of the sets has what a simulation of the closed
  loop would take, the controller.
"""

import time
import warnings
from dataclasses import replace

import numpy as np
from _protocols import protocols
from _report import fixed, parser, publish, rst_table, run_study
from _rivals import settings_of
from sklearn.base import clone

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.diagnosis.explain import split_in_time
from sklearn_vbjfa.effects import Shaped, Sudden
from sklearn_vbjfa.recording import take_arrays, with_torques_shifted
from sklearn_vbjfa.robot import FitOptions

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
RIVALS = ("WLS", "ridge", "LASSO", "PLS", "stepwise", "IDIM-IV")
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
    given = {} if name == "demo" else {"data_home": data_home}
    recording = protocol.load(**given)
    if name in RECORDINGS:
        recording = recording.select(*RECORDINGS[name])
    rows = np.flatnonzero(recording.t < LENGTHS.get(name, np.inf))
    identifier = RobotIdentifier(
        recording.robot_model(),
        dt=recording.dt,
        friction=DECLARED,
        cutoff=CUTOFFS.get(name, protocol.cutoff),
        options=FitOptions(standstill=protocol.standstill),
    )
    return recording, rows, identifier


def split_of(loop, q, tau, groups):
    """Return (X, y, groups) of the searched and of the held-out part of a loop."""
    dt = loop.identifier.dt
    whole = take_arrays(
        q, tau, groups, None, None, dt=dt, joint_names=loop.joint_names_
    )
    shifted = with_torques_shifted(whole, loop.torque_lag_)
    split = split_in_time(loop.identifier, shifted, loop.test_size)
    effects = loop.validation_model_.effects_
    shaped = [e for e in effects if isinstance(e, Shaped)]
    instants = [t for e in shaped if isinstance(e, Sudden) for t, _ in e.changes]
    guard = round(loop.report_.outcome.provenance["settings"]["guard_seconds"] / dt)
    split = split.without(whole.t, instants).with_guard(guard)
    parts = (split.searched(whole), split.held_out(whole))
    return tuple((part.q, part.tau, part.groups) for part in parts)


def run(task):
    """Close the loop on a set and judge the other methods on its held-out part."""
    recording, rows, identifier = load(task["set"], task["data_home"])
    given = recording.q[rows], recording.tau[rows], recording.groups[rows]
    with warnings.catch_warnings():
        # How rivals converge is shown by their errors.
        warnings.simplefilter("ignore")
        return {"set": task["set"], **judge(*given, identifier)}


def judge(q, tau, groups, identifier):
    """Errors of the joints by method, effects, failures and seconds."""
    loop = EffectDiscovery(identifier, random_state=0)
    started = time.perf_counter()
    loop.fit(q, tau, groups)
    seconds = time.perf_counter() - started
    (X, y, labels), (X_test, y_test, labels_test) = split_of(loop, q, tau, groups)

    completed = loop.validation_model_.residuals(X_test, y_test, groups=labels_test)

    def error(model):
        # On the rows of the completed model, which may know torques at rest.
        left = model.residuals(X_test, y_test, groups=labels_test)
        return replace(left, weight=completed.weight).rms() / loop.torque_std_

    declared = error(loop.declared_)
    if not np.allclose(declared, loop.error_before_, atol=SAME, equal_nan=True):
        raise RuntimeError("the declared model was not judged on the same rows")
    fuller = clone(identifier).set_params(friction=PLAIN)
    plain = clone(fuller).set_params(
        bodies="free", options=replace(fuller.fit_options, alike=None)
    )
    plain.fit(X, y, groups=labels)
    errors = {
        "declared": loop.error_before_,
        "four terms": error(plain),
        "completed": loop.error_after_,
    }
    failures = {}
    for name in RIVALS:
        model = clone(fuller).set_params(**settings_of(name, fuller.fit_options))
        try:
            errors[name] = error(model.fit(X, y, groups=labels))
        except ValueError as refused:
            errors[name] = np.full_like(declared, np.nan)
            failures[name] = str(refused)
    return {
        "errors": {name: np.asarray(x).tolist() for name, x in errors.items()},
        "failures": failures,
        "effects": [[e.name, e.joint] for e in loop.effects_],
        "perhaps": [[e.name, e.joint] for e in loop.possible_],
        "cutoff": float(plain.cutoff_),
        "seconds": seconds,
    }


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
    arguments = parser(__doc__, data=True, out=True)
    arguments.add_argument("--sets", choices=SETS, default="development")
    arguments.add_argument("--data", nargs="*", help="some of the sets only")
    arguments = arguments.parse_args(argv)
    chosen = arguments.data or SETS[arguments.sets]
    if arguments.quick:
        chosen = ("demo",)
    tasks = [{"set": name, "data_home": arguments.data_home} for name in chosen]
    ledger = run_study(run, tasks, ("set",), out=arguments.out, line=str)
    publish(
        f"measured_sets_{arguments.sets}",
        report(ledger.of(tasks)),
        arguments,
        command=f"measured_sets.py --sets {arguments.sets}",
        commits=ledger.commits(tasks),
    )


if __name__ == "__main__":
    main()
