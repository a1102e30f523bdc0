"""The field, side by side, on eleven measured sets: torques, positions, names.

Run ``python tests/benchmarks/bench_field.py --data-home DIR [--figaroh-python PYTHON]
[--out FILE ...] [--data SET ...] [--peers PEER ...] [--write]``, where PYTHON is the
interpreter of an environment with FIGAROH (``python -m venv ENV && ENV/bin/pip install
figaroh``); CMA-ES and mujoco.sysid need ``pip install cma "mujoco[sysid]"``. A peer
that is not there is left out with a line that says so.

Sets, splits, filters and masks are those of ``_protocols``, but for the Go2:
runs 0 to 6 are fitted, runs 7 to 9 judged, and all peers are told its commands, not
torques. EMPS is judged by its authors' rule as well (``bench_protocol_emps.py``). Every
peer has viscous and Coulomb friction, offset and rotor inertia of every joint.

- RobotIdentifier: with its defaults but filter, mask and friction of the set;
  EffectDiscovery: the same with the search for what is missing.
- scikit-learn's regressors: on the regressor columns of this package, behind its
  filter, mask, weights of joints, and its delay on the Go2. WLS is least squares with
  the four plain terms. Ridge, LASSO and PLS choose their strength by cross-validation
  over blocks of time.
- FIGAROH: the user script and settings of ``side_by_side`` for the UR5, with joints,
  rate and filter (1.5 times the set's) of the set put in; physical fit, base parameters
  where that is refused.
- mujoco.sysid: ``side_by_side/mujoco_sysid_user.py``, 10 iterations at most. On the
  Go2, joints and delay by the positions that commands make, the bodies as described;
  on other sets joints and bodies (pseudo-inertias in its default boxes) by the
  positions that torques make, in eight stretches of half a second.
- CMA-ES: armature, damping, Coulomb friction, offset and delay by the positions that
  commands make, as PACE has it; on the servo the model M1 of BAM as BAM fits it.
  Budget: 16 x 120 simulations of a run, 4000 of the servo's recordings.

CMA-ES and mujoco.sysid are fitted to runs 0 and 6 of the Go2 alone, means judged.

- error: of the torque, mean over the joints, `_figaroh.held_out_error`. On the Go2
  the torque is that of the PD law as late as the peer says.
- scatter: the two halves of the fitted part are fitted each alone; half the difference
  of the torques that they predict for the held-out part, over its spread.
- positions: simulated over windows of a second of the held-out part, each from the
  measured state at its start: by the recorded torques, at most twenty windows; on the
  Go2 and the servo by commands alone, in all windows (those of the Go2 from the first
  second on). Mean error over that of a robot that stays where it is, mean over the
  joints. A window counts on no joint more than the worst that a robot has which stays
  or goes on at its velocity, and so much if its simulation fails.
- consistent: whether all bodies are physically consistent (pseudo-inertia).
- seconds: of one processor (FIGAROH: by the clock, imports not counted).
- named: what is said to be missing, with a name, and on how many joints.
"""

import warnings
from dataclasses import replace

import _servo as servo
import bench_commands as commands
import bench_protocol_emps as emps
import numpy as np
from _field_peers import (
    CMA,
    FIGAROH,
    OURS,
    SEARCH,
    SERVO,
    SYSID,
    Case,
    answer,
    by_commands,
    names_of,
)
from _figaroh import held_out_error, recordings
from _protocols import protocols
from _report import fixed, parser, publish, rst_table, rst_title, run_study
from _rivals import settings_of
from scipy import signal

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier, StateEstimator
from sklearn_vbjfa.datasets import fetch_emps
from sklearn_vbjfa.robot import FitOptions

KEYS = ("set", "peer")
GO2 = "unitree_go2"
SETS = tuple(name for name in protocols() if name != "demo")
RIVALS = ("WLS", "ridge", "LASSO", "PLS", "Huber", "Theil-Sen")
PEERS = (OURS, SEARCH, *RIVALS, FIGAROH, SYSID, CMA)
COLUMNS = ("q", "v", "tau", "t", "weight", "states")
WINDOW, WINDOWS = 1.0, 20  # length [s], and most of them where torques drive
MARGIN = 0.1  # before the first of a recording [s]
# What a simulation may end in; anything else is a fault of this script.
FAILURES = (ValueError, ArithmeticError, RuntimeError)


# -- what is fitted and judged ---------------------------------------------------------


def rows_of(recording, rows):
    """Return some rows (n,) of a recording as one."""
    labels, groups = np.unique(recording.groups[rows], return_inverse=True)
    columns = {name: getattr(recording, name) for name in COLUMNS}
    return replace(
        recording,
        **{name: x if x is None else x[rows] for name, x in columns.items()},
        groups=groups,
        group_names=tuple(recording.group_names[k] for k in labels),
        signals={name: x[rows] for name, x in recording.signals.items()},
    )


def part_of(recording, rows, commands=False):
    """Return some rows (n,) of a recording as a part; see `Case`."""
    part = {
        "q": recording.q[rows],
        "tau": recording.tau[rows],
        "groups": recording.groups[rows],
        "dt": recording.dt,
    }
    return {**part, "recording": rows_of(recording, rows)} if commands else part


def load(name, data_home):
    """Return the `Case` of a set."""
    protocol = protocols()[name]
    given = {} if name == "demo" else {"data_home": data_home}
    recording = protocol.load(**given)
    rows, gains = protocol.split(recording), None
    if name == SERVO:
        recording = servo.prepared(recording)
    if name == GO2:
        _, _, gains = commands.go2(data_home)
        runs = commands.FITTED, commands.JUDGED
        labels = [
            [recording.group_names.index(f"run_{k}") for k in own] for own in runs
        ]
        rows = [np.flatnonzero(np.isin(recording.groups, own)) for own in labels]
    told = name in (SERVO, GO2)
    fitted, held_out = (part_of(recording, own, told) for own in rows)
    return Case(
        name=name,
        cutoff=10.0 if name == "demo" else protocol.cutoff,
        standstill=protocol.standstill,
        recording=recording,
        fitted=fitted,
        held_out=held_out,
        gains=gains,
    )


def halves(part):
    """Split a part in two: the first and the second half of every recording."""
    every = recordings(part)
    if "recording" in part and len(every) > 1:
        middle = (len(every) + 1) // 2
        chosen = [every[:middle], every[middle:]]
    else:
        middles = [len(rows) // 2 for rows in every]
        chosen = [
            [rows[:m] for rows, m in zip(every, middles)],
            [rows[m:] for rows, m in zip(every, middles)],
        ]
    return [_rows_of_part(part, np.concatenate(own)) for own in chosen]


def _rows_of_part(part, rows):
    found = {name: part[name][rows] for name in ("q", "tau", "groups")}
    if "recording" in part:
        found["recording"] = rows_of(part["recording"], rows)
    return {**found, "dt": part["dt"]}


# -- positions -------------------------------------------------------------------------


def windows_of(case):
    """List the windows of the held-out part, each its rows (m,)."""
    part = case.held_out
    length, found = round(WINDOW / part["dt"]), []
    # Late commands are not there yet in the first second of the Go2's runs; elsewhere
    # states rest on one side only where a recording begins. Windows of the servo are
    # those of `follow`.
    first = length if case.gains else round(MARGIN / part["dt"])
    first = 0 if case.name == SERVO else first
    for rows in recordings(part):
        starts = range(first, len(rows) - length + 1, length)
        found += [rows[k : k + length] for k in starts]
    if "recording" in part or len(found) <= WINDOWS:
        return found
    chosen = np.linspace(0, len(found) - 1, WINDOWS).astype(int)
    return [found[k] for k in chosen]


def measured_starts(case, windows):
    """Positions and velocities (n_windows, nv) that are measured at the starts."""
    smoother = StateEstimator(case.fitted["dt"])
    smoother.fit(case.fitted["q"], groups=case.fitted["groups"])
    part = case.held_out
    states = smoother.transform(part["q"], groups=part["groups"])
    firsts = [rows[0] for rows in windows]
    return np.split(states[firsts], 3, axis=1)[:2]


def position_errors(case, found):
    """Errors (n_windows, nv) of an `Answer`, of who stays, and of who goes on."""
    part, windows = case.held_out, windows_of(case)
    q0, v0 = measured_starts(case, windows)
    along = found.follow(WINDOW) if found.follow else None
    errors = np.full((3, len(windows), case.recording.nv), np.nan)
    for k, rows in enumerate(windows):
        q = part["q"][rows]
        since = part["dt"] * np.arange(len(rows))[:, None]
        errors[1, k] = _rms(q - q0[k])
        errors[2, k] = _rms(q - q0[k] - since * v0[k])
        if along is not None:
            errors[0, k] = _rms(along[rows] - q)
            continue
        try:
            simulated = np.asarray(found.simulate(part["tau"][rows], q0[k], v0[k]))
        except FAILURES:
            continue
        errors[0, k] = _rms(simulated[:, : q.shape[1]] - q)
    return errors


def _rms(missed):
    return np.sqrt((missed**2).mean(axis=0))


def position_figures(errors):
    """Error over that of who stays [%], that of who goes on, and windows that failed.

    Parameters
    ----------
    errors : ndarray of shape (3, n_windows, nv)
        As `position_errors` gives them.
    """
    own, stays, goes_on = errors
    failed = ~np.isfinite(own).all(axis=1)
    worst = np.maximum(stays, goes_on).max(axis=0)
    own = np.where(np.isfinite(own), np.minimum(own, worst), worst)
    own[failed] = worst
    mean = stays.mean(axis=0)
    return (
        100 * float((own.mean(axis=0) / mean).mean()),
        100 * float((goes_on.mean(axis=0) / mean).mean()),
        int(failed.sum()),
    )


# -- the judgement ---------------------------------------------------------------------


def run(task):
    """Judge one peer on one set."""
    case, peer = load(task["set"], task["data_home"]), task["peer"]
    kept = {key: task[key] for key in KEYS}
    if peer == FIGAROH and task["python"] is None:
        return {**kept, "failure": "no --figaroh-python was given"}
    python, others, why = task.get("python"), [], None
    try:
        if case.gains and peer in (CMA, SYSID):
            whole, *others = by_commands(case, case.fitted, peer)
        else:
            whole = answer(case, case.fitted, peer, python)
    except (ImportError, RuntimeError, ValueError) as error:
        return {**kept, "failure": str(error).splitlines()[0]}
    # Another two fits of mujoco.sysid would take a quarter of an hour.
    if not others and peer != SYSID:
        try:
            others = [answer(case, x, peer, python) for x in halves(case.fitted)]
        except (RuntimeError, ValueError) as error:
            # Half of a short recording may hold too little motion.
            why = str(error).splitlines()[0]
    result = {**kept, **judged(case, whole, others)}
    result.update(
        scatter_failure=why,
        consistent=whole.consistent,
        named=whole.named,
        seconds=whole.seconds,
    )
    return result


def judged(case, whole, others):
    """Figures of the answers of a peer, fitted to all and to two parts."""
    held_out, fitted, cutoff = case.held_out, case.fitted, case.cutoff

    def error(predicted, torque):
        part = {**held_out, "tau": torque}
        return held_out_error(predicted, part, fitted, cutoff, case.standstill)[0]

    def off(first, second):
        own = error(second, first) * _spread(first, held_out, cutoff)
        return own / _spread(held_out["tau"], held_out, cutoff)

    told = held_out["tau"] if whole.told is None else whole.told
    predicted = [other.predicted for other in others]
    figures = {
        "error": 100 * float(np.nanmean(error(whole.predicted, told))),
        "scatter": 50 * float(np.nanmean(off(*predicted))) if predicted else np.nan,
    }
    if whole.simulate or whole.follow:
        try:
            errors = position_errors(case, whole)
        except FAILURES as failure:
            figures["positions_failure"] = str(failure).splitlines()[0]
        else:
            figures["positions"], figures["goes_on"], figures["failed"] = (
                position_figures(errors)
            )
    return figures


def _spread(torque, part, cutoff):
    sos = signal.butter(4, cutoff, fs=1 / part["dt"], output="sos")
    smooth = [signal.sosfiltfilt(sos, torque[r], axis=0) for r in recordings(part)]
    return np.concatenate(smooth).std(axis=0)


def by_the_board(data_home):
    """Table of EMPS by its authors' rule: one recording fitted, another judged."""
    recording = fetch_emps(data_home=data_home)
    parts = [recording.select(name) for name in (emps.FITTED, emps.JUDGED)]
    states = [emps.authors_states(part.q[:, 0], part.dt) for part in parts]
    rows = [["published, least squares", *fixed(emps.PUBLISHED_ERRORS[1:], 2), ""]]
    settings = {"friction": emps.FRICTION, "cutoff": emps.CUTOFF}
    options = FitOptions(standstill=None)
    chosen = {OURS: {"options": options}, SEARCH: {"options": options}}
    chosen |= {name: settings_of(name, options) for name in RIVALS}
    for name, own in chosen.items():
        robot = RobotIdentifier(
            recording.robot_model(), dt=recording.dt, **settings, **own
        )
        named = "nothing"
        if name == SEARCH:
            robot = EffectDiscovery(robot, random_state=0)
        robot.fit(parts[0].q, parts[0].tau)
        if name == SEARCH:
            named = names_of(robot.effects_, recording.joint_names)
        said = robot.predict(states[1])[:, 0]
        error = emps.relative_error(parts[1].tau[:, 0], said)
        rows.append([name, *fixed([error], 2), named])
    return rst_table(rows, ["EMPS, its authors' rule", "judged recording [%]", "named"])


# -- the tables ------------------------------------------------------------------------


def shown(values):
    """Numbers with two digits; very large ones as powers of ten."""
    return [f"{v:.0e}" if v >= 1e4 else fixed([v], 2)[0] for v in values]


def table_of(name, results):
    """Table of one set."""
    rows = []
    for result in results:
        if "failure" in result:
            rows.append([result["peer"], *["–"] * 5, f"not run: {result['failure']}"])
            continue
        values = [result["error"], result["scatter"], result.get("positions", np.nan)]
        rows.append(
            [
                result["peer"],
                *shown(values),
                result["consistent"],
                *fixed([result["seconds"]], 1),
                result["named"],
            ]
        )
    headers = ["error [%]", "scatter [%]", "positions [%]", "consistent", "s"]
    table = rst_table(rows, [name, *headers, "named"])
    others = [r["goes_on"] for r in results if "goes_on" in r]
    if others:
        table += f"\n\nPositions of who goes on at its velocity: {others[0]:.2f} %."
    for key, word in (
        ("scatter_failure", "No scatter"),
        ("positions_failure", "No positions"),
    ):
        for why in dict.fromkeys(r[key] for r in results if r.get(key)):
            which = ", ".join(r["peer"] for r in results if r.get(key) == why)
            table += f"\n\n{word} ({which}): {why}"
    failed = [f"{r['peer']} {r['failed']}" for r in results if r.get("failed")]
    if failed:
        table += f"\n\nWindows whose simulation failed: {', '.join(failed)}."
    return table


def best_rival(results, figure):
    """Name and figure of the best peer that is not of this package."""
    own = {
        r["peer"]: r[figure]
        for r in results
        if r["peer"] not in (OURS, SEARCH) and r.get(figure, np.nan) == r.get(figure)
    }
    name = min(own, key=own.get) if own else "–"
    return name, own.get(name, np.nan)


def summary(results):
    """Table of the sets: this package, and the best rival, by torque and positions."""
    rows = []
    for name in dict.fromkeys(r["set"] for r in results):
        own = [r for r in results if r["set"] == name]
        by_peer = {r["peer"]: r for r in own}
        cells = []
        for figure in ("error", "positions"):
            rival, value = best_rival(own, figure)
            ours = [by_peer.get(p, {}).get(figure, np.nan) for p in (OURS, SEARCH)]
            cells += [*shown([*ours, value]), rival]
        rows.append([name, *cells])
    headers = [
        f"{word}, {what}"
        for word in ("torque [%]", "positions [%]")
        for what in (OURS, SEARCH, "best rival", "which")
    ]
    return rst_table(rows, ["set", *headers])


def places(results):
    """Sentences on where the package is not first."""
    said = []
    for peer in (OURS, SEARCH):
        for figure, word in (("error", "torque"), ("positions", "simulated position")):
            behind, judged_sets = [], 0
            for name in dict.fromkeys(r["set"] for r in results):
                own = [r for r in results if r["set"] == name]
                ours = [r[figure] for r in own if r["peer"] == peer and figure in r]
                rival, best = best_rival(own, figure)
                if not ours or best != best:
                    continue
                judged_sets += 1
                # What the table does not show is no difference.
                if best < ours[0] - 0.005:
                    behind.append(f"{name} ({rival} {best:.2f} %, {ours[0]:.2f} %)")
            if judged_sets:
                where = ", ".join(behind) or "none"
                said.append(
                    f"{peer}, by the {word}, is behind a rival on {len(behind)} of "
                    f"{judged_sets} sets: {where}."
                )
    return "\n\n".join(said)


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__, data=True, out=True)
    arguments.add_argument("--data", nargs="+", choices=SETS, default=SETS)
    arguments.add_argument("--peers", nargs="+", choices=PEERS, default=PEERS)
    arguments.add_argument("--figaroh-python", metavar="PYTHON")
    arguments = arguments.parse_args(argv)
    sets, peers = arguments.data, arguments.peers
    if arguments.quick:
        sets, peers = ("demo",), (OURS, "WLS", FIGAROH)
    shared = {"data_home": arguments.data_home, "python": arguments.figaroh_python}
    every = [
        {"set": name, "peer": peer, **shared}
        for name in (sets if arguments.quick else SETS)
        for peer in PEERS
    ]
    tasks = [task for task in every if task["set"] in sets and task["peer"] in peers]
    with warnings.catch_warnings():
        # How rivals converge is shown by their errors.
        warnings.simplefilter("ignore")
        ledger = run_study(run, tasks, KEYS, out=arguments.out, line=str)
        board = by_the_board(arguments.data_home) if "emps" in sets else ""
    done = ledger.of(every)
    parts = [places(done), summary(done), board]
    for name in dict.fromkeys(r["set"] for r in done):
        own = [r for r in done if r["set"] == name]
        parts += [rst_title(name, "~"), table_of(name, own)]
    publish("field", "\n\n".join(parts), arguments, commits=ledger.commits(every))


if __name__ == "__main__":
    main()
