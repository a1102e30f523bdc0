"""Freeze what the package computes, and compare two states of its code.

For a change of the code's shape that should not change a number::

    python tests/benchmarks/compare_states.py freeze one.json --checkout FOLDER
    python tests/benchmarks/compare_states.py freeze two.json
    python tests/benchmarks/compare_states.py compare one.json two.json

Only public names are used, so that the script of one state runs on another: the
checkout at FOLDER, by default this one. Each way into the package runs in a process of
its own, on one thread with one kernel of the linear algebra; its processor time and
peak memory are stored beside. Measured sets are looked for in the folder that
--data-home or the environment variable SKLEARN_VBJFA_DATA names, and left out where
they are not found; nothing is downloaded.

Predicted torques are compared over their own size; parameters in the norm of the second
moments that they were fitted to, since single entries near zero mean nothing; names,
names of files and exit codes to the letter; reports, tables, descriptions and printed
text to the letter but for their numbers, which may differ in the seventh digit;
everything else as whole arrays. Exit status 1 at a difference.
"""

import os

if __name__ == "__main__":
    # before NumPy loads its linear algebra
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
    os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")

import argparse
import functools
import json
import math
import re
import resource
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np

import sklearn_vbjfa
from sklearn_vbjfa import (
    EffectDiscovery,
    JFARegressor,
    RobotIdentifier,
    StateEstimator,
    VBJFARegressor,
    datasets,
    effects,
    load_identified,
    simulation,
)

HERE = Path(__file__).resolve()
TOLERANCE = 1e-9
# Of numbers in texts: as good as six digits.
DIGITS = 1e-6
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
# Name -> settings of the identifier, names of the recordings, seconds in use.
SETS = {
    "demo": ({"friction": ("viscous", "coulomb")}, (), np.inf),
    "emps": ({"cutoff": 20.0}, ("DATA_EMPS",), np.inf),
    "staubli_tx40": ({"cutoff": 25.0}, (), np.inf),
    "ur5": ({"cutoff": 8.0, "standstill": 0.03}, ("No6",), 25.0),
}
FITTED = ("theta_std_", "identifiable_", "min_eigenvalues_", "noise_floor_")
FITTED += ("torque_noise_", "input_noise_torque_", "output_noise_", "cutoff_")
FITTED += ("standstill_",)
FOUND = ("error_before_", "error_plain_", "error_after_", "torque_spread_")
FOUND += ("projection_price_", "ceiling_")


def public_arrays(model):
    """Return name -> array of the numeric public attributes of a fitted estimator."""
    found = {}
    for name, value in sorted(vars(model).items()):
        if name.endswith("_") and not name.startswith("_") and value is not None:
            try:
                array = np.asarray(value)
            except ValueError:
                continue
            if array.dtype.kind in "bif":
                found[name] = array
    return found


def load(name, data_home):
    """Return positions, torques and groups in use, and the identifier."""
    settings, names, seconds = SETS[name]
    if name == "demo":
        recording = datasets.load_demo_recording()
    else:
        fetch = getattr(datasets, f"fetch_{name}")
        recording = fetch(data_home=data_home, download_if_missing=False)
    if names:
        recording = recording.select(*names)
    rows = recording.t - recording.t[0] < seconds
    identifier = RobotIdentifier(
        recording.robot_model(),
        dt=recording.dt,
        **{"friction": ("viscous",), **settings},
    )
    return recording.q[rows], recording.tau[rows], recording.groups[rows], identifier


def fitted_robot(identifier, q, groups=None, t=None):
    """Figures of a fitted identifier."""
    found = {name: np.asarray(getattr(identifier, name)) for name in FITTED}
    found["theta|parameters"] = identifier.theta_
    found["theta|unconstrained"] = identifier.theta_unconstrained_
    found["metric"] = identifier.estimator_.metric_
    found["torque"] = identifier.predict(q, groups=groups, t=t)
    found["names"] = np.array(identifier.parameter_names_)
    found["units"] = np.array(identifier.parameter_units_)
    if identifier.gains_ is not None:
        found["gain"] = identifier.gains_.gain
        found["gain, std"] = identifier.gains_.std
    return found


def described(effect):
    """Describe an effect, with its shape."""
    shape = {k: np.asarray(v).tolist() for k, v in effect.get_params().items()}
    return f"{type(effect).__name__} {json.dumps(shape, sort_keys=True, default=str)}"


def closed_loop(name, data_home):
    """Figures of a fit and of a search on one recording."""
    q, tau, groups, identifier = load(name, data_home)
    found = fitted_robot(identifier.fit(q, tau, groups=groups), q, groups)
    search = EffectDiscovery(identifier, random_state=0).fit(q, tau, groups=groups)
    for kind in ("effects", "perhaps"):
        own = getattr(search, f"{kind}_")
        found[f"search, {kind}"] = np.array([f"{e.name} {e.joint}" for e in own])
        found[f"search, {kind}, log odds"] = np.array([e.log_odds for e in own])
    found |= {f"search, {key}": np.asarray(getattr(search, key)) for key in FOUND}
    figures = fitted_robot(search.identifier_, q, groups)
    found |= {f"search, {key}": value for key, value in figures.items()}
    found["search, shapes"] = "\n".join(map(described, search.identifier_.effects_))
    found["search, report"] = str(search.report_)
    found["search, report.json"] = json.dumps(search.report_.to_dict(), indent=1)
    return found


def head(data_home):
    """Figures of the paper's head in simulation."""
    recording = datasets.make_closed_loop_recording(
        "head", duration=10.0, n_recordings=2, random_state=0
    )
    paper = VBJFARegressor(latent="independent", prior="paper", query="noiseless")
    methods = {
        "default": {},
        "paper": {"input_noise": None, "regressor": paper},
        "robust": {"block_noise": True},
    }
    found = {}
    for name, settings in methods.items():
        identifier = RobotIdentifier(
            recording.robot_model(),
            dt=recording.dt,
            friction=("viscous", "coulomb"),
            **settings,
        )
        identifier.fit(recording.q, recording.tau, groups=recording.groups)
        figures = fitted_robot(identifier, recording.q, recording.groups)
        if name == "paper":
            regressor = identifier.estimator_.regressor_
            figures.update(
                {f"posterior, {k}": v for k, v in public_arrays(regressor).items()}
            )
        found.update({f"{name}, {k}": v for k, v in figures.items()})
    return found


def tables(data_home):
    """Posteriors of the regressors on tables."""
    found = {}
    for seed in range(3):
        data = datasets.make_noisy_regression(400, n_irrelevant=10, random_state=seed)
        known = {"latent": "correlated", "input_noise": data.input_noise_covariance}
        models = {
            "jfa": JFARegressor(),
            "paper": VBJFARegressor(latent="independent", prior="paper"),
            "independent": VBJFARegressor(latent="independent"),
            "default": VBJFARegressor(),
            "exact": VBJFARegressor(latent="correlated", input_noise=0.0),
            "known": VBJFARegressor(**known),
        }
        for name, model in models.items():
            model.fit(data.X, data.y)
            figures = public_arrays(model) | {"torque": model.predict(data.X_test)}
            found.update({f"{name} {seed}, {k}": v for k, v in figures.items()})
    recording = datasets.load_demo_recording()
    states = StateEstimator(dt=recording.dt).fit(recording.q)
    found["states"] = states.transform(recording.q)
    return found


def robots(data_home):
    """Figures of an identifier: bodies, corrections, gains, simulation, files, parts.

    The robot has two joints and a recording of 8 s in two parts, with a base that is
    tilted, a joint that is not zeroed, and a gain.
    """
    Path("arm.urdf").write_text(ARM)
    made = {"duration": 8.0, "dt": 0.01, "n_recordings": 2, "random_state": 0}
    plain = datasets.make_robot_recording("arm.urdf", **made)
    moved = datasets.make_robot_recording(
        "arm.urdf", base_tilt=(0.05, 0.0), joint_zero={1: 0.05}, **made
    )
    scaled = datasets.make_robot_recording("arm.urdf", torque_gain={1: 1.3}, **made)
    geometry = (effects.BaseTilt(), effects.JointZero(1))
    payload = effects.Payload(joint=1, instant=8.0, centre=(0.1, 0.0, 0.0))
    # under its name in states before drives
    controller = getattr(simulation, "PositionController", None)
    controller = controller or sklearn_vbjfa.robot.PDDrive
    # Name -> recording, settings.
    cases = {
        "prior": (plain, {}),
        "free": (plain, {"bodies": "free"}),
        "fixed": (plain, {"bodies": "fixed"}),
        "no projection": (plain, {"projector": None}),
        "geometry": (moved, {"effects": geometry}),
        "gain": (scaled, {"effects": (effects.TorqueGain(1),)}),
        "gains": (scaled, {"gains": "unknown"}),
        "known mass": (scaled, {"gains": "unknown", "known_masses": {"lower": 2.0}}),
        "payload": (plain, {"effects": (payload,)}),
        "stribeck": (plain, {"effects": (effects.Stribeck(0), effects.Ripple(1))}),
        "output error": (plain, {"criterion": "simulation", "window": 0.3}),
        "controller": (
            plain,
            {
                "criterion": "simulation",
                "controller": controller(100.0, 5.0),
            },
        ),
    }
    found = {}
    for name, (recording, settings) in cases.items():
        q, tau, groups = recording.q, recording.tau, recording.groups
        robot = RobotIdentifier(
            "arm.urdf", dt=0.01, **{"friction": ("viscous", "coulomb"), **settings}
        )
        fitting = {"groups": groups}
        if name == "controller":
            # what this controller would have followed
            speed = recording.states[:, 2:4]
            fitting["reference"] = q + (tau + 5.0 * speed) / 100.0
        robot.fit(q, tau, **fitting)
        figures = fitted_robot(robot, q, groups)
        figures["effects"] = "\n".join(map(described, robot.effects_))
        for write in ("save", "to_urdf", "to_mjcf"):
            try:
                getattr(robot, write)("robot")
            except ValueError as refusal:
                Path("robot").write_text(str(refusal))
            figures[f"file, {write}"] = Path("robot").read_text()
            if write == "save":
                again = load_identified("robot")
                figures["torque, read back"] = again.predict(q, groups=groups)
        found |= {f"{name}, {key}": value for key, value in figures.items()}
    first = plain.groups == plain.groups[0]
    robot = RobotIdentifier("arm.urdf", dt=0.01, cutoff=8.0, standstill=0.01)
    for rows in (first, ~first):
        robot.partial_fit(plain.states[rows], plain.tau[rows])
    figures = {k: getattr(robot, k) for k in ("theta_", "theta_std_")}
    figures["torque"] = robot.predict(plain.states)
    return found | {f"in parts, {key}": value for key, value in figures.items()}


LINK = """
<link name="{name}"><inertial><origin xyz="{centre} 0 0"/><mass value="{mass}"/>
  <inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/>
</inertial></link>
<joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="{name}"/>
  <origin xyz="{origin} 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" effort="100" velocity="10"/>
</joint>"""
UPPER = {"name": "upper", "joint": "shoulder", "parent": "base", "origin": 0}
LOWER = {"name": "lower", "joint": "elbow", "parent": "upper", "origin": 0.4}
ARM = (
    '<robot name="arm"><link name="base"/>'
    + LINK.format(**UPPER, centre=0.2, mass=3)
    + LINK.format(**LOWER, centre=0.15, mass=2)
    + "</robot>"
)
# What is typed, in this order, in one folder; {data} are the measured sets.
COMMANDS = (
    "",
    "--version --verbose",
    "effects",
    "datasets",
    "close-loop arm.csv --urdf arm.urdf --effects spring,ripple,stribeck --out report",
    "close-loop a.csv b.csv --urdf arm.urdf --effects none --no-ceiling --out two",
    "close-loop arm.csv --urdf arm.urdf --effects none --gain unknown "
    "--known-mass lower=2 --no-ceiling --out gains",
    "inspect arm.csv --urdf arm.urdf",
    "inspect gap.csv --urdf arm.urdf",
    "identify arm.csv --urdf arm.urdf",
    "identify a.csv b.csv --urdf arm.urdf --bodies free",
    "simulate arm.csv --urdf arm.urdf --window 0.5 --out simulated",
    "simulate b.csv --model report/identified.json --window 0.3 --out again",
    "design --urdf arm.urdf --duration 4 --acceleration 3 --out motion.csv",
    "design --report report --duration 4 --acceleration 3 --out next.csv",
    # with a doubt, or refused
    "close-loop unit.csv --urdf arm.urdf --effects none --no-ceiling --out unit",
    "close-loop rest.csv --urdf arm.urdf --effects none --no-ceiling --out rest",
    "close-loop missing.csv --urdf arm.urdf",
    "close-loop arm.csv --urdf missing.urdf",
    "close-loop arm.csv --urdf arm.urdf --effects unheard",
    "close-loop arm.csv --urdf arm.urdf --out .",
    "close-loop arm.csv",
    "inspect other.csv --urdf arm.urdf",
    "identify constant.csv --urdf arm.urdf",
    "simulate arm.csv --urdf arm.urdf --window 100",
    "design --urdf arm.urdf --duration -1",
    "no-command",
)


def write_tables():
    """Write the recordings that the commands read."""
    Path("arm.urdf").write_text(ARM)
    recording = datasets.make_robot_recording(
        "arm.urdf",
        duration=15.0,
        n_harmonics=8,
        undeclared={"spring": (0, 4.0)},
        random_state=0,
    )
    columns = np.column_stack([recording.t, recording.q, recording.tau])
    half = len(columns) // 2
    still, constant, unit = columns.copy(), columns.copy(), columns.copy()
    still[:, 2] = 0.3
    constant[:, 3:] = 0.5
    unit[:, 3] *= 100.0
    written = {
        "arm": columns,
        "a": columns[:half],
        "b": columns[half:],
        "gap": np.delete(columns, np.s_[700:800], axis=0),
        "rest": still,
        "constant": constant,
        "unit": unit,
    }
    for name, table in written.items():
        header = "t,q1,q2,tau1,tau2"
        options = {"fmt": "%.9g", "delimiter": ",", "comments": ""}
        np.savetxt(f"{name}.csv", table, header=header, **options)
    np.savetxt("other.csv", columns, header="a,b,c,d,e", **options)


def command_line(data_home):
    """Exit codes, what is printed, and the files of some commands."""
    write_tables()
    found, seen = {}, set(Path().rglob("*"))
    for command in COMMANDS:
        run = subprocess.run(
            [sys.executable, "-m", "sklearn_vbjfa", *command.split()],
            capture_output=True,
            text=True,
            # What is shown of the progress hangs on the clock.
            env={**os.environ, "TQDM_DISABLE": "1"},
        )
        title = f"'{command}'"
        found[f"{title}, exit code"] = np.array(run.returncode)
        found[f"{title}, printed"] = run.stdout
        found[f"{title}, said"] = run.stderr
        new = sorted(path for path in Path().rglob("*") if path not in seen)
        seen.update(new)
        found[f"{title}, files"] = np.array([path.as_posix() for path in new])
        for path in new:
            if path.suffix in {".json", ".csv", ".urdf", ".xml"}:
                found[f"{title}, {path}"] = path.read_text()
    return found


PARTS = {"tables": tables, "head": head, "robots": robots}
PARTS |= {name: functools.partial(closed_loop, name) for name in SETS}
PARTS |= {"command line": command_line}


def run_part(name, path, checkout, data_home):
    """Store what one part finds, from a folder of its own."""
    package = Path(sklearn_vbjfa.__file__).parents[1]
    if not package.samefile(checkout):
        raise SystemExit(f"the package is that of {package}, not of {checkout}")
    path = os.path.abspath(path)
    with tempfile.TemporaryDirectory() as folder:
        # Several files are one recording, which has the name of their folder.
        own = Path(folder) / "recordings"
        own.mkdir()
        os.chdir(own)
        with warnings.catch_warnings():
            # convergence and doubts are compared, not wanted
            warnings.simplefilter("ignore")
            try:
                figures = PARTS[name](data_home)
            except OSError as missing:
                if name not in SETS:
                    raise
                print(f"{name}: left out, {missing}", flush=True)
                return
    figures = {k: v if isinstance(v, str) else v.tolist() for k, v in figures.items()}
    usage = [resource.getrusage(who) for who in (0, resource.RUSAGE_CHILDREN)]
    own = {
        "seconds": round(sum(u.ru_utime + u.ru_stime for u in usage), 1),
        "megabytes": round(max(u.ru_maxrss for u in usage) / 1024),
        "figures": figures,
    }
    Path(path).write_text(json.dumps(own))
    print("{}: {seconds} s, {megabytes} MB".format(name, **own), flush=True)


def freeze(path, checkout, data_home, names):
    """Store the figures of all parts in a JSON file."""
    stored = {}
    options = ["--checkout", checkout]
    options += ["--data-home", data_home] if data_home else []
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / "part.json"
        for name in names:
            subprocess.run(
                [sys.executable, HERE, "part", part, "--only", name, *options],
                env=os.environ | {"PYTHONPATH": checkout},
                check=True,
            )
            if part.exists():
                stored[name] = json.loads(part.read_text())
                part.unlink()
    Path(path).write_text(json.dumps(stored))


def difference(one, other, metric):
    """Relative difference of two arrays; infinity where they do not match."""
    one, other = np.asarray(one), np.asarray(other)
    if one.shape != other.shape:
        return np.inf
    if "U" in (one.dtype.kind, other.dtype.kind) or one.dtype.kind == "b":
        return 0.0 if np.array_equal(one, other) else np.inf
    if not np.array_equal(np.isfinite(one), np.isfinite(other)):
        return np.inf
    finite = np.isfinite(one)
    change = np.where(finite, other, 0.0) - np.where(finite, one, 0.0)
    size = np.where(finite, one, 0.0)
    if metric is not None:
        squares = [float(x @ metric @ x) for x in (change, size)]
        return float(np.sqrt(max(squares[0], 0.0) / squares[1]))
    norm, most = np.linalg.norm(size), np.abs(change).max(initial=0.0)
    return float(np.linalg.norm(change) / norm if norm else most)


def same_line(one, other):
    """Whether two lines are equal but for the last digits of their numbers."""
    if one == other:
        return True
    if NUMBER.split(one) != NUMBER.split(other):
        return False
    pairs = zip(NUMBER.findall(one), NUMBER.findall(other))
    # what is zero but for rounding has no digits
    close = {"rel_tol": DIGITS, "abs_tol": 1e-12}
    return all(math.isclose(float(a), float(b), **close) for a, b in pairs)


def differing_lines(one, other):
    """Return the lines, in pairs, at which two texts differ."""
    lines = one.splitlines(), other.splitlines()
    if len(lines[0]) != len(lines[1]):
        counts = [(f"{len(lines[0])} lines", f"{len(lines[1])} lines")]
        only = [[x for x in a if x not in set(b)] for a, b in (lines, lines[::-1])]
        return counts + [(x, None) for x in only[0]] + [(None, x) for x in only[1]]
    return [(a, b) for a, b in zip(*lines) if not same_line(a, b)]


def differences(one, two):
    """Return what differs between the figures of a part, name -> how."""
    found = {}
    for key in sorted(one.keys() | two.keys()):
        if key not in one or key not in two:
            found[key] = "only in the first" if key in one else "only in the second"
        elif isinstance(one[key], str) or isinstance(two[key], str):
            changed = differing_lines(str(one[key]), str(two[key]))
            if changed:
                shown = [f"\n  - {a}\n  + {b}" for a, b in changed[:3]]
                found[key] = f"{len(changed)} line(s)" + "".join(shown)
        else:
            metric = None
            if "theta|" in key:
                metric = np.asarray(one[key.split("theta|")[0] + "metric"])
            apart = difference(one[key], two[key], metric)
            if not apart <= TOLERANCE:
                found[key] = f"{apart:.2e}" if np.isfinite(apart) else "differs"
    return found


def compare(path, other):
    """Print what differs between two files; return whether anything does."""
    one, two = (json.loads(Path(file).read_text()) for file in (path, other))
    different = False
    for name in one.keys() | two.keys():
        if name not in one or name not in two:
            print(f"{name}: only in {path if name in one else other}")
            different = True
    for name in (name for name in PARTS if name in one and name in two):
        parts = one[name], two[name]
        figures = [part["figures"] for part in parts]
        found = differences(*figures)
        for key, how in found.items():
            print(f"{name}: {key}: {how}")
        different |= bool(found)
        cost = [f"{p['seconds']} s and {p['megabytes']} MB" for p in parts]
        n = len(figures[0].keys() | figures[1].keys())
        print(f"{name}: {n - len(found)} of {n} equal; {' -> '.join(cost)}")
    return different


def main(argv=None):
    """Freeze, or compare."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    actions = arguments.add_subparsers(dest="action", required=True)
    for name, does in (
        ("freeze", "store the figures of one state"),
        ("part", "store those of one part, which is named; freeze calls it"),
    ):
        action = actions.add_parser(name, help=does)
        action.add_argument("path", metavar="FILE")
        action.add_argument(
            "--checkout",
            type=os.path.abspath,
            default=str(HERE.parents[2]),
            metavar="FOLDER",
        )
        action.add_argument(
            "--data-home",
            type=os.path.abspath,
            default=os.environ.get("SKLEARN_VBJFA_DATA"),
            metavar="FOLDER",
        )
        action.add_argument("--only", choices=PARTS, action="append")
    action = actions.add_parser("compare", help="print what differs")
    action.add_argument("path", metavar="FILE")
    action.add_argument("other", metavar="OTHER")
    arguments = arguments.parse_args(argv)
    if arguments.action == "compare":
        return int(compare(arguments.path, arguments.other))
    names = arguments.only or list(PARTS)
    state = arguments.checkout, arguments.data_home
    if arguments.action == "freeze":
        freeze(arguments.path, *state, names)
    else:
        run_part(names[0], arguments.path, *state)
    return 0


if __name__ == "__main__":
    sys.exit(main())
