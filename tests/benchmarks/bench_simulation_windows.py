"""Measured robots simulated over windows of a second: declared, completed, URDF.

Run ``python tests/benchmarks/bench_simulation_windows.py --sets development --data-home
DIR [--out FILE] [--models DIR] [--write]``; the confirmation set is run once, with
``--sets confirmation``, and ``--sets all`` with the same FILE makes the table of both.

Models, the search for effects included, are fitted to some recordings. On others, or on
a later part, each is driven by the measured torques from the measured state at the
start of every window, and its positions are compared with the measured ones. What is
fitted and judged, filters, masks and declared friction are those of the frozen
protocols; the rules below were fixed before the first of these simulations:

- start states come from the measured positions by the smoother of the declared fit, the
  same for all models; the first `MARGIN` seconds of a recording are left out, as a
  velocity rests on one side only there;
- a window's error is the root mean square of the position error of each joint; windows
  follow one another without gap or overlap;
- a window in which a simulation ends in an error, or not in numbers, counts on every
  joint as the worst error that either trivial rival has on any window of the set. The
  rival of the same window would make failing at rest free. Windows of finite error
  beyond that bound are counted as run away, and their error stands as it is;
- the figure of a set is the mean over windows and joints, the median over windows
  stands beside it, and the difference between completed and declared model has a 90 %
  interval by a bootstrap of blocks of neighbouring windows;
- asked for: the completed model better than the declared one, by the figure of the set,
  on at least three of the four sets.

The guide asks more: "a model that is not clearly better than both" trivial rivals "has
not been shown to simulate anything". This was added when the results were known.
Clearly better: the mean over windows of the difference of their errors (means over
joints) is below zero by Student's t, one-sided at 5 %, with the correlation of
neighbouring windows (`clearly_smaller` of the package).
"""

import time
import warnings
from dataclasses import dataclass
from pathlib import Path

import joblib
import numpy as np
from _ledger import Ledger
from _protocol_sets import MANIPULATED_SETS, PAIRED_SETS, pairs
from _report import commit, fixed, parser, publish, rst_table
from _simulated_models import simulated, torque_model
from bench_protocol_tx40 import FITTED, JUDGED
from scipy.optimize import lsq_linear
from sklearn.base import clone

from sklearn_vbjfa import EffectDiscovery
from sklearn_vbjfa.robot._windows import clearly_smaller

STAGES = {
    "development": ("ur5", "staubli_tx40", "bam_xl330"),
    "confirmation": ("dfki_double_pendulum",),
}
STAGES["all"] = (*STAGES["development"], *STAGES["confirmation"])
FROZEN = {
    **{name: PAIRED_SETS[name] for name in ("ur5", "bam_xl330")},
    "dfki_double_pendulum": PAIRED_SETS["dfki_double_pendulum"],
    "staubli_tx40": MANIPULATED_SETS["staubli_tx40"],
}
# Recordings of the UR5 that are fitted; the other six are judged.
UR5_FITTED = ("No4", "No6")
# Sets with a description that has masses, and torques in N m: URDFs, and the
# publishers' parameters of the double pendulum. The gains of the UR5 are not verified.
DESCRIBED = ("ur5", "staubli_tx40", "dfki_double_pendulum")
SECONDS = 1.0
MARGIN = 0.1
NEEDED = 3  # sets of four
DRAWS, LEVEL = 4000, 0.90

STAYS, GOES_ON = "stays where it is", "goes on at constant velocity"
TRIVIAL = (STAYS, GOES_ON)
DECLARED, COMPLETED = "declared", "completed"
BARE = "description, without friction"
RUBBED = "description, declared friction fitted"
# What a simulation may end in; anything else is a fault of this script.
FAILURES = (ValueError, ArithmeticError, RuntimeError)
KEYS = ("set", "judged")


# -- what is fitted and judged ---------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Split:
    """What one pair of models is fitted to and judged on.

    Attributes
    ----------
    label : str
        What is judged.
    fitted : ndarray of int
        Rows of the recording.
    judged : tuple of (str, slice)
        Names and rows of the stretches that windows are cut from.
    clock : ndarray of shape (n_samples,)
        Time of each row on the clock of the fit [s]. A recording of its own begins
        with it, as for `RobotIdentifier.predict`.
    """

    label: str
    fitted: np.ndarray
    judged: tuple
    clock: np.ndarray


def splits_of(name, recording):
    """List the splits of a set."""
    if name == "staubli_tx40":
        return [
            Split(
                label=f"rows {JUDGED.start}:{JUDGED.stop}",
                fitted=np.arange(recording.n_samples)[FITTED],
                judged=((recording.group_names[0], JUDGED),),
                clock=recording.dt * np.arange(recording.n_samples),
            )
        ]
    names = recording.group_names
    if name == "ur5":
        others = tuple(n for n in names if n not in UR5_FITTED)
        named = [(", ".join(others), UR5_FITTED, others)]
    else:
        named = pairs(names, FROZEN[name].leave_out)
    rows_of = dict(zip(names, recording.segments))
    since = np.concatenate([np.arange(s.stop - s.start) for s in recording.segments])
    return [
        Split(
            label=label,
            fitted=np.concatenate([np.r_[rows_of[n]] for n in fitted]),
            judged=tuple((n, rows_of[n]) for n in judged),
            clock=recording.dt * since,
        )
        for label, fitted, judged in named
    ]


def windows(judged, dt, seconds=SECONDS, margin=MARGIN):
    """List (name, rows) of windows; the last row of one is the first of the next.

    Parameters
    ----------
    judged : sequence of (str, slice)
        Stretches.
    dt, seconds, margin : float
        Sample period, length, and what is left out at the start of a stretch [s].
    """
    n, left_out = round(seconds / dt), round(margin / dt)
    return [
        (name, slice(first, first + n + 1))
        for name, rows in judged
        for first in range(rows.start + left_out, rows.stop - n, n)
    ]


# -- models ----------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Fits:
    """Both models of a split.

    Attributes
    ----------
    declared, completed : RobotIdentifier
        Fitted to the same rows.
    effects : tuple of (str, int)
        What was found: names and joints from zero.
    seconds : float
        Time of the search.
    commit : str
        Version that made them.
    """

    declared: object
    completed: object
    effects: tuple
    seconds: float
    commit: str


def fit(recording, identifier, rows, **settings):
    """Fit the declared model and close the loop on some rows, as `Fits`.

    Parameters
    ----------
    recording : Recording
        Recording.
    identifier : RobotIdentifier
        Declared model.
    rows : ndarray of int
        Rows that are fitted.
    **settings
        Arguments of `EffectDiscovery`.
    """
    part = recording.q[rows], recording.tau[rows], recording.groups[rows]
    started = time.perf_counter()
    loop = EffectDiscovery(identifier, random_state=0, **settings)
    loop.fit(*part)
    return Fits(
        declared=clone(identifier).fit(part[0], part[1], groups=part[2]),
        completed=loop.identifier_,
        effects=tuple((e.name, int(e.joint)) for e in loop.effects_),
        seconds=time.perf_counter() - started,
        commit=commit(),
    )


def fitted_friction(declared, recording, rows, model):
    """Friction (nv, 4) that the bodies of a description leave on the fitted rows.

    Viscous and Coulomb friction, offset and rotor inertia of each joint by least
    squares behind the low-pass and mask of the declared model; none but the offset may
    be negative.
    """
    from sklearn_vbjfa.datasets import rigid_torques

    q, groups = recording.q[rows], recording.groups[rows]
    states = declared.state_estimator_.transform(q, groups=groups)
    _, v, a = np.split(states, 3, axis=1)
    rest = recording.tau[rows] - rigid_torques(model, states)
    signals = (rest, v, np.sign(v), np.ones_like(v), a)
    found = [declared.residuals(q, x, groups) for x in signals]
    root = np.sqrt(found[0].weight)
    low = [0.0, 0.0, -np.inf, 0.0]
    out = np.empty((recording.nv, 4))
    for j in range(recording.nv):
        target, *columns = (root[:, j] * part.torque[:, j] for part in found)
        out[j] = lsq_linear(np.column_stack(columns), target, (low, np.inf)).x
    return out


def described(model, dt, friction=None):
    """Return the simulator of a description, `friction` of `fitted_friction`."""
    named = None
    if friction is not None:
        names = ("viscous", "coulomb", "offset", "rotor_inertia")
        named = dict(zip(names, friction.T))
    robot = torque_model(model, friction=named, dt=dt)

    def run(tau, q0, v0, t):
        return simulated(robot, tau, q0, v0, t)

    return run


def simulators(name, recording, fits, rows):
    """Label -> function (tau, q0, v0, t) -> states (n, 3 nv) of all models."""
    found = {DECLARED: fits.declared.simulate, COMPLETED: fits.completed.simulate}
    if name in DESCRIBED:
        model, dt = recording.robot_model(), recording.dt
        friction = fitted_friction(fits.declared, recording, rows, model)
        found[BARE] = described(model, dt)
        found[RUBBED] = described(model, dt, friction)
    return found


# -- judging ---------------------------------------------------------------------------


def rms(error):
    """Root mean square of each column."""
    return np.sqrt((error**2).mean(axis=0))


def judge(recording, split, states, models, seconds=None, margin=MARGIN):
    """Simulate all windows of a split.

    Parameters
    ----------
    recording : Recording
        Recording.
    split : Split
        What is judged.
    states : ndarray of shape (n_samples, 3 nv)
        Smoothed states of the recording, of which windows start.
    models : dict of str to callable
        As of `simulators`.
    seconds, margin : float
        As for `windows`; `SECONDS` by default.

    Returns
    -------
    dict
        ``recordings``, ``starts`` [s] of the windows; ``errors``: label -> (windows,
        joints) [rad or m], nan for a window that failed; ``failures``: label -> list of
        [window, message]; ``seconds``: label -> time taken.
    """
    cut = windows(split.judged, recording.dt, seconds or SECONDS, margin)
    nv = recording.nv
    labels = [*TRIVIAL, *models]
    errors = {label: np.full((len(cut), nv), np.nan) for label in labels}
    failures = {label: [] for label in models}
    taken = dict.fromkeys(models, 0.0)
    for k, (_, rows) in enumerate(cut):
        q, tau, t = recording.q[rows], recording.tau[rows], split.clock[rows]
        q0, v0 = states[rows.start, :nv], states[rows.start, nv : 2 * nv]
        errors[STAYS][k] = rms(q - q0)
        errors[GOES_ON][k] = rms(q - q0 - np.outer(t - t[0], v0))
        for label, run in models.items():
            started = time.process_time()
            try:
                found = np.asarray(run(tau, q0, v0, t))
            except FAILURES as error:
                failures[label].append([k, f"{type(error).__name__}: {error}"])
            else:
                if np.isfinite(found).all():
                    errors[label][k] = rms(found[:, :nv] - q)
                else:
                    failures[label].append([k, "the simulated states are not finite"])
            taken[label] += time.process_time() - started
    return {
        "recordings": [name for name, _ in cut],
        "starts": [float(split.clock[rows.start]) for _, rows in cut],
        "errors": {label: x.tolist() for label, x in errors.items()},
        "failures": failures,
        "seconds": taken,
    }


def run(task, data_home=None, models=None):
    """Fit and judge one split of one set, as a dict.

    Parameters
    ----------
    task : dict
        With `KEYS`.
    data_home : str or None
        Folder of the measured sets.
    models : str or None
        Folder in which fits are kept, and found if they are there already.
    """
    name, frozen = task["set"], FROZEN[task["set"]]
    recording = frozen.recording(data_home)
    identifier = frozen.identifier(recording.robot_model(), recording.dt)
    split = next(s for s in splits_of(name, recording) if s.label == task["judged"])
    kept = Path(models, f"{name} {split.label}.joblib") if models else None
    with warnings.catch_warnings():
        # Joints that leave their limits, motion outside the range of the fit: both
        # are in the figures.
        warnings.simplefilter("ignore", UserWarning)
        if kept is not None and kept.exists():
            fits = Fits(**joblib.load(kept))
        else:
            fits = fit(recording, identifier, split.fitted)
            if kept is not None:
                kept.parent.mkdir(parents=True, exist_ok=True)
                joblib.dump(vars(fits), kept)
        smoother = fits.declared.state_estimator_
        states = smoother.transform(recording.q, groups=recording.groups)
        every = simulators(name, recording, fits, split.fitted)
        found = judge(recording, split, states, every)
    return {
        **task,
        "units": list(recording.position_units),
        "fitted": _names(recording, split.fitted),
        "effects": [list(pair) for pair in fits.effects],
        "fit_seconds": fits.seconds,
        "fit_commit": fits.commit,
        **found,
    }


def _names(recording, rows):
    """Names of the recordings that rows are of, in order."""
    labels = dict.fromkeys(recording.groups[rows].tolist())
    return [recording.group_names[label] for label in labels]


# -- figures ---------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Figures:
    """What the windows of a set say.

    Attributes
    ----------
    errors : dict of str to ndarray of shape (n_windows, nv)
        Errors in degrees or mm, failed windows as the rules say.
    failed, run_away : dict of str to int
        Windows without a result, and of finite error beyond the bound on some joint.
    """

    errors: dict
    failed: dict
    run_away: dict

    def by_window(self, label):
        """Mean error over the joints, (n_windows,)."""
        return self.errors[label].mean(axis=1)

    @property
    def difference(self):
        """Error of the completed minus that of the declared model, (n_windows,)."""
        return self.by_window(COMPLETED) - self.by_window(DECLARED)


def figures(results):
    """Put the splits of one set together, as `Figures`."""
    unit = np.array([{"rad": 180 / np.pi, "m": 1e3}[u] for u in results[0]["units"]])
    found = {
        label: unit * np.concatenate([r["errors"][label] for r in results])
        for label in results[0]["errors"]
    }
    bound = np.max([found[label] for label in TRIVIAL], axis=(0, 1))
    failed, run_away = {}, {}
    for label, errors in found.items():
        none = np.isnan(errors).any(axis=1)
        failed[label] = int(none.sum())
        run_away[label] = int((errors > bound)[~none].any(axis=1).sum())
        errors[none] = bound
    return Figures(errors=found, failed=failed, run_away=run_away)


def interval(values, draws=DRAWS, level=LEVEL, seed=0):
    """Interval (2,) of the mean of (n,) by a bootstrap of blocks of neighbours.

    Blocks have the length n^(1/3) and go round at the end.
    """
    n = len(values)
    length = max(1, round(n ** (1 / 3)))
    rng = np.random.default_rng(seed)
    first = rng.integers(n, size=(draws, -(-n // length)))
    rows = (first[:, :, None] + np.arange(length)) % n
    means = values[rows.reshape(draws, -1)[:, :n]].mean(axis=1)
    return np.quantile(means, [0.5 - level / 2, 0.5 + level / 2])


def better(result):
    """Whether the completed model has the smaller figure, of `Figures`."""
    return bool(result.difference.mean() < 0)


def shown(result, label):
    """Whether a model is clearly better than both trivial rivals, of `Figures`."""
    own = result.by_window(label)
    return all(clearly_smaller(own, result.by_window(rival)) for rival in TRIVIAL)


def verdict(name, result):
    """Return the row of a set in the table of what was shown, of `Figures`."""
    means = {label: result.by_window(label).mean() for label in result.errors}
    cells = fixed([means.get(label, np.nan) for label in JUDGED_BY], 2)
    answers = [_yes(shown(result, label)) for label in (DECLARED, COMPLETED)]
    return [
        name,
        str(len(result.difference)),
        *cells,
        *answers,
        min(means, key=means.get),
    ]


# Models whose means stand beside one another in the table of what was shown.
JUDGED_BY = (*TRIVIAL, DECLARED, COMPLETED, RUBBED)
SHOWN = [
    "set",
    "windows",
    *JUDGED_BY,
    "declared clearly better than both",
    "completed clearly better than both",
    "smallest",
]
ERRORS = [
    "set",
    "model",
    "windows",
    "mean [degrees]",
    "clearly better than both trivial rivals",
    "median",
    "failed",
    "run away",
    "each joint, mean",
    "each joint, median",
    "time for 1 s [s]",
]
VERDICTS = [
    "set",
    "windows",
    "declared [degrees]",
    "completed",
    "difference",
    "its 90 % interval",
    "windows in which completed is better [%]",
    "completed better",
]


def report(by_set):
    """Text with the tables, of the results of each set."""
    found = {name: figures(results) for name, results in by_set.items()}
    cells, verdicts, words = [], [], []
    for name, result in found.items():
        results, n = by_set[name], len(result.difference)
        for label, errors in result.errors.items():
            means = result.by_window(label)
            taken = [r["seconds"][label] for r in results if label in r["seconds"]]
            cells.append(
                [
                    name,
                    label,
                    str(n),
                    *fixed([means.mean()], 2),
                    "–" if label in TRIVIAL else _yes(shown(result, label)),
                    *fixed([np.median(means)], 2),
                    str(result.failed[label]),
                    str(result.run_away[label]),
                    " ".join(fixed(errors.mean(axis=0), 2)),
                    " ".join(fixed(np.median(errors, axis=0), 2)),
                    f"{sum(taken) / (n * SECONDS):.3f}" if taken else "–",
                ]
            )
        low, high = interval(result.difference)
        verdicts.append(
            [
                name,
                str(n),
                *fixed([result.by_window(x).mean() for x in (DECLARED, COMPLETED)], 2),
                *fixed([result.difference.mean()], 2),
                f"{low:.2f} to {high:.2f}",
                f"{100 * (result.difference < 0).mean():.0f}",
                _yes(better(result)),
            ]
        )
        words += [_said(r) for r in results]
    wins = sum(better(result) for result in found.values())
    beaten = sum(shown(result, COMPLETED) for result in found.values())
    plain = sum(shown(result, DECLARED) for result in found.values())
    asked = f"asked for: {NEEDED} of {len(STAGES['all'])}"
    return "\n\n".join(
        [
            f"Windows of {SECONDS:g} s, started from smoothed measured states and "
            "driven by the measured torques, on recordings or stretches that were "
            "neither fitted nor searched. Errors are root mean squares of the position "
            "in a window, in degrees; the mean is that over windows and joints. Failed "
            "windows count as the worst error that a trivial rival has on any window "
            "of the set; those beyond that are counted as run away.",
            rst_table(verdicts, VERDICTS),
            f"Completed better than declared on {wins} of {len(found)} sets ({asked}).",
            f"Completed clearly better than both trivial rivals on {beaten} of "
            f"{len(found)} sets, declared on {plain}. Mean errors [degrees], and "
            "whether they are clearly smaller than those of both (Student's t of the "
            "windows' differences, one-sided at 5 %):",
            rst_table([verdict(*one) for one in found.items()], SHOWN),
            rst_table(cells, ERRORS, n_labels=2),
            "\n".join(words),
            f"Declared friction {', '.join(FROZEN['ur5'].friction)}; loop with "
            f"random_state=0; bootstrap of {DRAWS} draws with seed 0.",
        ]
    )


def _yes(answer):
    """Write an answer."""
    return "yes" if answer else "no"


def _said(result):
    """One line of a split: what was fitted, found, and failed."""
    found = ", ".join(f"{n} {j + 1}" for n, j in result["effects"]) or "nothing"
    line = (
        f"- {result['set']}, {result['judged']}: fitted {', '.join(result['fitted'])} "
        f"(commit {result['fit_commit']}), found {found}."
    )
    for label, entries in result["failures"].items():
        if entries:
            k, message = entries[0]
            where = f"{result['recordings'][k]} from {result['starts'][k]:.2f} s"
            first = message.splitlines()[0].rstrip(".")
            line += f" {label}: {len(entries)} failed, first {where} ({first})."
    return line


def tasks_of(names, data_home):
    """List the tasks of some sets."""
    return [
        {"set": name, "judged": split.label}
        for name in names
        for split in splits_of(name, FROZEN[name].recording(data_home))
    ]


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--sets", choices=STAGES, default="development")
    arguments.add_argument("--data", nargs="*", default=None, help="some of the sets")
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument(
        "--out", default=None, metavar="FILE", help="results so far, as JSON lines"
    )
    arguments.add_argument(
        "--models",
        default=None,
        metavar="DIR",
        help="fitted models so far, for another simulator of a package that fits alike",
    )
    arguments = arguments.parse_args(argv)
    known = STAGES[arguments.sets]
    chosen = arguments.data or known
    if not set(chosen) <= set(known):
        raise SystemExit(f"--data must name some of {', '.join(known)}.")
    tasks = tasks_of(chosen, arguments.data_home)
    ledger = Ledger(arguments.out, KEYS)
    for task in ledger.missing(tasks):
        ledger.add(run(task, arguments.data_home, arguments.models))
        result = figures(ledger.results[-1:])
        means = {x: result.by_window(x).mean() for x in result.errors}
        words = ", ".join(f"{label} {x:.2f}" for label, x in means.items())
        print(f"{task['set']}, {task['judged']}: {words}", flush=True)
    results = ledger.of(tasks)
    text = report({n: [r for r in results if r["set"] == n] for n in chosen})
    name = "simulation_windows"
    publish(
        name if arguments.sets == "all" else f"{name}_{arguments.sets}",
        text,
        write=arguments.write,
        command="python tests/benchmarks/bench_simulation_windows.py "
        f"--sets {arguments.sets}",
        states=ledger.states(tasks),
    )


if __name__ == "__main__":
    main()
