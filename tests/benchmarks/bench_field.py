"""The field, side by side: this package, FIGAROH, and scikit-learn's regressors.

Run ``python tests/benchmarks/bench_field.py --data-home DIR [--figaroh-python PYTHON]
[--out FILE] [--data SET ...] [--write]``, where PYTHON is the interpreter of an
environment with FIGAROH (``python -m venv ENV && ENV/bin/pip install figaroh``). A peer
that is not there is left out with a line that says so.

Sets, splits, filters and masks are those of ``datasets.protocols``; the slide EMPS is
judged by its authors' rule as well (``bench_protocol_emps.py``). Every peer gives
torques for the held-out part, and `bench_figaroh.held_out_error` judges them all. The
torques of Go2 are those of its PD law without a delay.

- RobotIdentifier: with its defaults but filter, mask and friction of the set;
  EffectDiscovery: the same with the search for what is missing.
- scikit-learn's regressors: on the regressor columns of this package, behind its
  filter, mask and weights of joints: what is compared is the regressor alone.
  LinearRegression is least squares with the four plain terms. Ridge, LASSO and PLS
  choose their strength by cross-validation over blocks of time.
- FIGAROH: the user script and settings of ``side_by_side`` for the UR5, with joints,
  rate and filter (1.5 times the set's) of the set put in; physical fit, base parameters
  where that is refused.
- mujoco.sysid is not in the table: it fits simulated motions and predicts no torques.
  What it does with commands is ``output error`` in ``bench_commands.py``.

- error: mean over the joints.
- scatter: the two halves of the fitted part (of every recording) are fitted each alone;
  half the difference of the torques that they predict for the held-out part, over its
  spread. Coordinates of the parameters do not matter. EffectDiscovery has none here.
- consistent: whether all bodies are physically consistent (pseudo-inertia).
- seconds: of one processor (FIGAROH: by the clock, imports not counted).
- lines: that a user writes, settings included.
- named: what is said to be missing, with a name.
"""

import inspect
import tempfile
import time
import warnings
from dataclasses import replace
from pathlib import Path

import bench_protocol_emps as emps
import numpy as np
from _ledger import Ledger
from _report import fixed, parser, publish, rst_table, rst_title
from bench_figaroh import (
    SCRIPTS,
    Contestant,
    count_lines,
    held_out_error,
    load,
    recordings,
    run_script,
    user_lines,
)
from scipy import signal
from sklearn.linear_model import HuberRegressor, LinearRegression, TheilSenRegressor

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import fetch_emps, protocols
from sklearn_vbjfa.robot import methods

KEYS = ("set", "peer")
OURS, SEARCH, FIGAROH = "RobotIdentifier", "EffectDiscovery", "FIGAROH"
SETS = tuple(name for name in protocols() if name != "demo")


def regressors(n_parameters):
    """Return name -> scikit-learn's regressor."""
    tuned = methods(n_parameters)
    robust = {"fit_intercept": False}
    return {
        "LinearRegression": LinearRegression(**robust),
        **{name: tuned[name]["regressor"] for name in ("ridge", "LASSO", "PLS")},
        "Huber": HuberRegressor(alpha=0.0, max_iter=500, **robust),
        "Theil-Sen": TheilSenRegressor(
            max_subpopulation=200, max_iter=50, random_state=0, **robust
        ),
    }


PEERS = (OURS, *regressors(10), FIGAROH, SEARCH)


# -- what a user writes ----------------------------------------------------------------


def with_defaults(model, dt, protocol, fitted, held_out):
    """Identify with this package."""
    robot = RobotIdentifier(
        model,
        dt=dt,
        friction=protocol.friction,
        cutoff=protocol.cutoff,
        standstill=protocol.standstill,
    )
    robot.fit(fitted["q"], fitted["tau"], groups=fitted["groups"])
    return robot, robot.predict(held_out["q"], groups=held_out["groups"])


def with_search(model, dt, protocol, fitted, held_out):
    """Identify with this package and search for what is missing."""
    robot = RobotIdentifier(
        model,
        dt=dt,
        friction=protocol.friction,
        cutoff=protocol.cutoff,
        standstill=protocol.standstill,
    )
    loop = EffectDiscovery(robot, random_state=0, ceiling=False)
    loop.fit(fitted["q"], fitted["tau"], groups=fitted["groups"])
    return loop, loop.predict(held_out["q"], groups=held_out["groups"])


def with_regressor(model, dt, protocol, fitted, held_out, regressor):
    """Identify with a regressor of scikit-learn."""
    robot = RobotIdentifier(
        model,
        dt=dt,
        friction=protocol.friction,
        cutoff=protocol.cutoff,
        standstill=protocol.standstill,
        regressor=regressor,
        projector=None,
    )
    robot.fit(fitted["q"], fitted["tau"], groups=fitted["groups"])
    return robot, robot.predict(held_out["q"], groups=held_out["groups"])


def lines_of(function):
    """Lines of one of these, without its docstring."""
    return count_lines(inspect.getsource(function), ".py")


# -- the peers -------------------------------------------------------------------------


def figaroh_settings(protocol, recording, name, folder):
    """Write FIGAROH's settings of a set, made of those of the UR5."""
    text = (SCRIPTS / "figaroh_ur5.yaml").read_text(encoding="utf-8")
    head, rest = text.split("active_joints:\n")
    rest = rest[rest.index("    coupling:") :]
    names = "".join(f"        - {joint}\n" for joint in recording.joint_names)
    text = f"{head}active_joints:\n{names}{rest}"
    text = text.replace("125.0", f"{1 / recording.dt:.6g}")
    text = text.replace("12.5", f"{1.5 * protocol.cutoff:.6g}")
    path = folder / f"figaroh_{name}.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def figaroh(name, protocol, recording, python, fitted, held_out):
    """Predicted torques, seconds and lines of FIGAROH; a word if it gives none."""
    if recording.urdf is None or not str(recording.urdf).endswith(".urdf"):
        raise RuntimeError("it reads URDFs, and the set has none")
    if any(unit != "rad" for unit in recording.position_units):
        raise RuntimeError("its script is for joints that turn")
    standstill = protocol.standstill
    standing = 0.02 if isinstance(standstill, str) else standstill
    row = Contestant(
        label=FIGAROH,
        files=("figaroh_user.py",),
        arguments=("10", str(standing)),
        stage="physical_fit",
    )
    with tempfile.TemporaryDirectory() as folder:
        settings = figaroh_settings(protocol, recording, name, Path(folder))
        outcome = run_script(row, python, recording.urdf, (fitted, held_out), settings)
    refused = "Reported estimate: none" in outcome.said
    if refused:
        row = replace(row, stage="fit")
        with tempfile.TemporaryDirectory() as folder:
            settings = figaroh_settings(protocol, recording, name, Path(folder))
            parts = (fitted, held_out)
            outcome = run_script(row, python, recording.urdf, parts, settings)
    lines = sum(user_lines(row, "ur5"))
    consistent = "no" if refused else "yes"
    return outcome.predicted, outcome.seconds, lines, consistent, "nothing"


def torques_of(task, protocol, recording, fitted, held_out):
    """Torques, seconds, lines, consistency and names of a peer fitted to a part."""
    name, peer = task["set"], task["peer"]
    if peer == FIGAROH:
        return figaroh(name, protocol, recording, task["python"], fitted, held_out)
    model = recording.robot_model()
    given = model, recording.dt, protocol, fitted, held_out
    started = time.process_time()
    if peer == OURS:
        function, (robot, predicted) = with_defaults, with_defaults(*given)
    elif peer == SEARCH:
        function, (loop, predicted) = with_search, with_search(*given)
        robot = loop.identifier_
    else:
        regressor = regressors(14 * recording.nv)[peer]
        function = with_regressor
        robot, predicted = with_regressor(*given, regressor)
    seconds = time.process_time() - started
    consistent = "yes" if (robot.min_eigenvalues_ > 0).all() else "no"
    named = "nothing"
    if peer == SEARCH and loop.effects_:
        named = ", ".join(dict.fromkeys(effect.name for effect in loop.effects_))
    return predicted, seconds, lines_of(function), consistent, named


def halves(part):
    """Split a part in two: the first and the second half of every recording."""
    chosen = [[], []]
    for rows in recordings(part):
        middle = len(rows) // 2
        chosen[0].append(rows[:middle])
        chosen[1].append(rows[middle:])
    rows = [np.concatenate(x) for x in chosen]
    return [{k: x if k == "dt" else x[own] for k, x in part.items()} for own in rows]


def run(task):
    """Judge one peer on one set."""
    name = task["set"]
    protocol, recording, fitted, held_out = load(name, task["data_home"])
    cutoff = protocol.cutoff
    kept = {key: task[key] for key in KEYS}

    def torques(part):
        return torques_of(task, protocol, recording, part, held_out)

    try:
        predicted, seconds, lines, consistent, named = torques(fitted)
        parts = [] if task["peer"] == SEARCH else halves(fitted)
        others = [torques(part)[0] for part in parts]
    except (RuntimeError, ValueError) as error:
        return {**kept, "failure": str(error).splitlines()[0]}

    def off(first, second):
        part = {**held_out, "tau": first}
        reference = held_out_error(second, part, fitted, cutoff, protocol.standstill)[
            0
        ] * _spread(first, held_out, cutoff)
        return reference / _spread(held_out["tau"], held_out, cutoff)

    error, _ = held_out_error(predicted, held_out, fitted, cutoff, protocol.standstill)
    return {
        **kept,
        "error": 100 * float(np.nanmean(error)),
        "scatter": 50 * float(np.nanmean(off(*others))) if others else np.nan,
        "consistent": consistent,
        "named": named,
        "seconds": seconds,
        "lines": lines,
    }


def _spread(torque, part, cutoff):
    """Deviation of a torque (n, nv) behind the filter."""
    sos = signal.butter(4, cutoff, fs=1 / part["dt"], output="sos")
    smooth = [signal.sosfiltfilt(sos, torque[r], axis=0) for r in recordings(part)]
    return np.concatenate(smooth).std(axis=0)


def by_the_board(data_home):
    """Table of EMPS by its authors' rule: one recording fitted, another judged."""
    recording = fetch_emps(data_home=data_home)
    parts = [recording.select(name) for name in (emps.FITTED, emps.JUDGED)]
    states = [emps.authors_states(part.q[:, 0], part.dt) for part in parts]
    rows = [["published, least squares", *fixed(emps.PUBLISHED_ERRORS[1:], 2)]]
    settings = {"friction": emps.FRICTION, "cutoff": emps.CUTOFF, "standstill": None}
    chosen = {OURS: {}}
    for name, regressor in regressors(13).items():
        chosen[name] = {"regressor": regressor, "projector": None}
    for name, own in chosen.items():
        robot = RobotIdentifier(
            recording.robot_model(), dt=recording.dt, **settings, **own
        )
        robot.fit(parts[0].q, parts[0].tau)
        said = robot.predict(states[1])[:, 0]
        rows.append([name, *fixed([emps.relative_error(parts[1].tau[:, 0], said)], 2)])
    return rst_table(rows, ["EMPS, its authors' rule", "judged recording [%]"])


# -- the tables ------------------------------------------------------------------------


def table_of(name, results):
    """Table of one set."""
    rows = []
    for result in results:
        if "failure" in result:
            rows.append([result["peer"], *["–"] * 5, f"not run: {result['failure']}"])
            continue
        values = [result["error"], result["scatter"]]
        rows.append(
            [
                result["peer"],
                *fixed(values, 2),
                result["consistent"],
                *fixed([result["seconds"]], 1),
                str(result["lines"]),
                result["named"],
            ]
        )
    headers = ["error [%]", "scatter [%]", "consistent", "s", "lines", "named"]
    return rst_table(rows, [name, *headers])


def places(results):
    """Sentence on where the package is not first."""
    behind = []
    for name in dict.fromkeys(r["set"] for r in results):
        own = {
            r["peer"]: r["error"] for r in results if r["set"] == name and "error" in r
        }
        if not own or OURS not in own:
            continue
        ours = min(own[OURS], own.get(SEARCH, np.inf))
        best = min(own, key=own.get)
        # What the table does not show is no difference.
        if own[best] < ours - 0.005:
            behind.append(f"{name} ({best} {own[best]:.2f} %, {ours:.2f} %)")
    return f"By the error, this package is not first on: {', '.join(behind) or 'none'}."


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument("--data", nargs="+", choices=SETS, default=SETS)
    arguments.add_argument("--peers", nargs="+", choices=PEERS, default=PEERS)
    arguments.add_argument("--figaroh-python", default=None, metavar="PYTHON")
    arguments.add_argument("--out", default=None, metavar="FILE")
    arguments = arguments.parse_args(argv)
    if arguments.figaroh_python is None:
        print("FIGAROH is left out: give --figaroh-python.", flush=True)
    tasks = [
        {
            "set": name,
            "peer": peer,
            "data_home": arguments.data_home,
            "python": arguments.figaroh_python,
        }
        for name in arguments.data
        for peer in arguments.peers
        if peer != FIGAROH or arguments.figaroh_python
    ]
    ledger = Ledger(arguments.out, KEYS)
    with warnings.catch_warnings():
        # How rivals converge is shown by their errors.
        warnings.simplefilter("ignore")
        for task in ledger.missing(tasks):
            ledger.add(run(task))
            print(ledger.results[-1], flush=True)
        board = by_the_board(arguments.data_home)
    done = ledger.of(tasks)
    parts = [places(done), board]
    for name in arguments.data:
        own = [r for r in done if r["set"] == name]
        parts += [rst_title(name, "~"), table_of(name, own)]
    publish(
        "field", "\n\n".join(parts), write=arguments.write, states=ledger.states(tasks)
    )


if __name__ == "__main__":
    main()
