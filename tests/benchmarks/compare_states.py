"""Freeze the results of the package, and compare two states of its code.

For changes that must not change a number::

    python tests/benchmarks/compare_states.py freeze one.json --checkout FOLDER
    python tests/benchmarks/compare_states.py freeze two.json
    python tests/benchmarks/compare_states.py compare one.json two.json

The script of one state runs on another: only public names are used. Each part runs in a
process on one thread. Measured sets are read from the folder that --data-home or
SKLEARN_VBJFA_DATA names.

Torques and arrays are compared relative to their norm, parameters in the norm of the
second moments that they were fitted to, names, file names and exit codes exactly, and
numbers in files to six digits. Sentences are not compared. Figures that only one state
has are listed and do not count as differences. Exit status 1 at a difference.
"""

import os

if __name__ == "__main__":
    # before NumPy loads its linear algebra
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
    os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")

import argparse
import csv
import functools
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

import sklearn_vbjfa
from sklearn_vbjfa import EffectDiscovery, RobotIdentifier, datasets, effects
from sklearn_vbjfa.robot import FitOptions, PDDrive

HERE = Path(__file__).resolve()
TOLERANCE, DIGITS = 1e-9, 1e-6
PLAIN = ("viscous", "coulomb", "offset", "rotor_inertia")
# Name -> settings of the identifier, names of the recordings, seconds in use.
SETS = {
    "demo": ({"friction": ("viscous", "coulomb")}, (), np.inf),
    "emps": ({"cutoff": 20.0}, ("DATA_EMPS",), np.inf),
    "staubli_tx40": ({"cutoff": 25.0}, (), np.inf),
    "ur5": ({"cutoff": 8.0, "options": FitOptions(standstill=0.03)}, ("No6",), 25.0),
}
FITTED = ("theta_std_", "identifiable_", "min_eigenvalues_", "noise_floor_")
FITTED += ("torque_noise_", "output_noise_", "cutoff_", "standstill_")
FOUND = ("error_before_", "error_plain_", "error_after_", "torque_std_")
LABELS = {"name", "joint", "effect", "parameter", "unit", "link"}

# -- figures of estimators -------------------------------------------------------------


def timed(found, step, function, *given, **settings):
    """Call a function and note its processor seconds."""
    started = time.process_time()
    result = function(*given, **settings)
    found[f"seconds|{step}"] = time.process_time() - started
    return result


def under(name, figures):
    """Figures under a name."""
    return {f"{name}, {key}": value for key, value in figures.items()}


def public_arrays(model):
    """Numeric public attributes of a fitted estimator by name."""
    public = {k: v for k, v in vars(model).items() if k.endswith("_") and k[0] != "_"}
    kinds = (bool, int, float, np.ndarray)
    return {k: v for k, v in sorted(public.items()) if isinstance(v, kinds)}


def fitted_robot(robot, q, groups=None):
    """Figures of a fitted identifier."""
    found = {x: getattr(robot, x) for x in FITTED}
    found["metric"] = robot.estimate_.metric
    # the shares of unnamed torques, which are not fitted, are behind
    fitted = slice(len(found["metric"]))
    found["theta|parameters"] = robot.theta_[fitted]
    found["theta|unconstrained"] = robot.theta_unconstrained_[fitted]
    found["torque"] = robot.predict(q, groups=groups)
    found["names"] = robot.parameter_names_
    found["units"] = robot.parameter_units_
    found["effects"] = [type(effect).__name__ for effect in robot.effects_]
    found["shapes"] = flat([effect.get_params() for effect in robot.effects_])
    if robot.gains_ is not None:
        found |= {"gain": robot.gains_.gain, "gain, std": robot.gains_.std}
    return found | exported(robot, q, groups)


def exported(robot, q, groups):
    """Numbers of a robot that is saved, and written as URDF and MJCF."""
    found = {}
    robot.save("robot.json")
    again = sklearn_vbjfa.load_identified("robot.json")
    found["saved, torque"] = again.predict(q, groups=groups)
    for kind, read in READERS.items():
        path = f"robot.{kind}"
        try:
            getattr(robot, {"urdf": "to_urdf", "xml": "to_mjcf"}[kind])(path)
        except ValueError:
            found[f"{kind}, refused"] = True
            continue
        found |= under(kind, read(path))
    return found


def read_urdf(path):
    """Numbers of a URDF."""
    import pinocchio as pin

    model = pin.buildModelFromUrdf(str(path))
    found = {
        "bodies": np.array([x.toDynamicParameters() for x in model.inertias[1:]]),
        "places": np.array([np.ravel(x.homogeneous) for x in model.jointPlacements]),
        "names": list(model.names),
    }
    for name in ("damping", "friction", "armature"):
        found[name] = np.array(getattr(model, name))
    data, states = model.createData(), np.random.default_rng(0)
    states = states.normal(size=(5, 3, model.nv))
    return found | {"torque": np.array([pin.rnea(model, data, *x) for x in states])}


def read_mjcf(path):
    """Numbers of an MJCF, as MuJoCo compiles it."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    names = ("body_mass", "body_pos", "jnt_axis", "jnt_range", "actuator_gainprm")
    names += ("dof_armature", "dof_damping", "dof_frictionloss", "qpos_spring")
    found = {name: np.array(getattr(model, name)) for name in names}
    found["gravity"] = np.array(model.opt.gravity)
    found["names"] = [model.joint(i).name for i in range(model.njnt)]
    data, torques = mujoco.MjData(model), []
    states = np.random.default_rng(0).normal(size=(5, 3, model.nv))
    for data.qpos[:], data.qvel[:], data.qacc[:] in states:
        mujoco.mj_inverse(model, data)
        torques.append(data.qfrc_inverse.copy())
    return found | {"torque": np.array(torques)}


READERS = {"urdf": read_urdf, "xml": read_mjcf}


def search_figures(identifier, q, tau, groups, **settings):
    """Figures of a fit, and of a search that starts with it."""
    found = {}
    timed(found, "fit", identifier.fit, q, tau, groups=groups)
    found |= fitted_robot(identifier, q, groups)
    search = EffectDiscovery(identifier, random_state=0, **settings)
    timed(found, "search", search.fit, q, tau, groups=groups)
    for kind in ("effects", "possible"):
        own = getattr(search, f"{kind}_")
        found[f"search, {kind}"] = [f"{e.name} {e.joint}" for e in own]
        found[f"search, {kind}, log odds"] = [e.log_odds for e in own]
        found[f"search, {kind}, values"] = flat([e.parameters for e in own])
    found |= under("search", {key: getattr(search, key) for key in FOUND})
    found |= under("search", fitted_robot(search.identifier_, q, groups))
    return found | {"search, file|report": flat(search.report_.to_dict())}


# -- parts -----------------------------------------------------------------------------


def tables(data_home):
    """Posteriors of the regressors on tables."""
    found = {}
    for seed in range(3):
        data = datasets.make_noisy_regression(400, n_irrelevant=10, random_state=seed)
        vbjfa = sklearn_vbjfa.VBJFARegressor
        known = {"latent": "correlated", "input_noise": data.input_noise_covariance}
        models = {
            "jfa": sklearn_vbjfa.JFARegressor(),
            "paper": vbjfa(latent="independent", prior="paper"),
            "independent": vbjfa(latent="independent"),
            "default": vbjfa(),
            "exact": vbjfa(latent="correlated", input_noise=0.0),
            "known": vbjfa(**known),
        }
        for name, model in models.items():
            timed(found, f"{name} {seed}", model.fit, data.X, data.y)
            figures = public_arrays(model) | {"torque": model.predict(data.X_test)}
            found |= under(f"{name} {seed}", figures)
    recording = datasets.load_demo_recording()
    states = sklearn_vbjfa.StateEstimator(dt=recording.dt).fit(recording.q)
    return found | {"states": states.transform(recording.q)}


def recorded(name, data_home):
    """Figures of a fit and of a search on one recording."""
    settings, names, seconds = SETS[name]
    if name == "demo":
        recording = datasets.load_demo_recording()
    else:
        fetch = getattr(datasets, f"fetch_{name}")
        recording = fetch(data_home=data_home, download_if_missing=False)
    if names:
        recording = recording.select(*names)
    rows = recording.t - recording.t[0] < seconds
    given = recording.q[rows], recording.tau[rows], recording.groups[rows]
    settings = {"friction": ("viscous",), **settings}
    model = recording.robot_model()
    robot = RobotIdentifier(model, dt=recording.dt, **settings)
    found = search_figures(robot, *given)
    if name == "demo":
        paper = {"latent": "independent", "prior": "paper", "query": "noiseless"}
        paper = sklearn_vbjfa.VBJFARegressor(**paper)
        settings |= {"input_noise": None, "regressor": paper}
        robot = RobotIdentifier(model, dt=recording.dt, **settings)
        robot.fit(given[0], given[1], groups=given[2])
        found |= under("paper", fitted_robot(robot, given[0], given[2]))
    return found


def go2(data_home):
    """Figures of a quadruped: late torques, and commands with its drive."""
    recording = datasets.fetch_unitree_go2(
        data_home=data_home, download_if_missing=False
    )
    runs = [recording.select(k) for k in range(3)]
    q, tau = [x.q[2:] for x in runs], [x.tau[:-2] for x in runs]
    groups = np.repeat(np.arange(3), [len(x) for x in q])
    q, tau = np.concatenate(q), np.concatenate(tau)
    settings = {"dt": recording.dt, "friction": PLAIN, "cutoff": 10.0}
    found, model = {}, recording.robot_model()
    for bodies in ("prior", "free"):
        robot = RobotIdentifier(model, bodies=bodies, **settings)
        timed(found, f"torques, {bodies}", robot.fit, q, tau, groups=groups)
        found |= under(f"torques, {bodies}", fitted_robot(robot, q, groups))
    robot = RobotIdentifier(model, drive=PDDrive(), **settings)
    timed(found, "commands", robot.fit_recording, PDDrive().driven(runs[0]))
    return found | under("commands", fitted_robot(robot, runs[0].q))


def identifiers(data_home):
    """Figures of an identifier with bodies, geometry, gains, and output error."""
    Path("arm.urdf").write_text(ARM)
    made = {"duration": 8.0, "dt": 0.01, "n_recordings": 2, "random_state": 0}
    make = functools.partial(datasets.make_robot_recording, "arm.urdf", **made)
    plain, scaled = make(), make(torque_gain={1: 1.3})
    moved = make(base_tilt=(0.05, 0.0), joint_zero={1: 0.05})
    payload = effects.Payload(joint=1, instant=8.0, centre=(0.1, 0.0, 0.0))
    # Name -> recording, settings.
    cases = {
        "prior": (plain, {}),
        "free": (plain, {"bodies": "free"}),
        "fixed": (plain, {"bodies": "fixed"}),
        "no projection": (plain, {"projector": None}),
        "geometry": (moved, {"effects": (effects.BaseTilt(), effects.JointZero(1))}),
        "gain": (scaled, {"effects": (effects.TorqueGain(1),)}),
        "gains": (scaled, {"gains": "unknown"}),
        "known mass": (
            scaled,
            {"gains": "unknown", "options": FitOptions(known_masses={"lower": 2.0})},
        ),
        "payload": (plain, {"effects": (payload,)}),
        "stribeck": (plain, {"effects": (effects.Stribeck(0), effects.Ripple(1))}),
        "output error": (
            plain,
            {"criterion": "simulation", "options": FitOptions(window=0.3)},
        ),
    }
    found = {}
    for name, (recording, settings) in cases.items():
        q, tau, groups = recording.q, recording.tau, recording.groups
        settings = {"friction": ("viscous", "coulomb"), **settings}
        robot = RobotIdentifier("arm.urdf", dt=0.01, **settings)
        timed(found, name, robot.fit, q, tau, groups=groups)
        found |= under(name, fitted_robot(robot, q, groups))
    return found


def whole_robot(data_home):
    """Figures of six joints with friction, geometry, and gains that the model lacks."""
    Path("six.urdf").write_text(SIX)
    recording = datasets.make_robot_recording(
        "six.urdf",
        duration=20.0,
        dt=0.01,
        n_recordings=2,
        undeclared={"spring": (1, 8.0)},
        base_tilt=(0.05, 0.02),
        joint_zero={3: 0.06},
        torque_gain={2: 1.15},
        random_state=0,
    )
    given = recording.q, recording.tau, recording.groups
    robot = RobotIdentifier("six.urdf", dt=0.01, friction=("viscous", "coulomb"))
    names = ("base_tilt", "joint_zero", "joint_axis", "torque_gain", "spring")
    found = search_figures(robot, *given, effects=list(names + ("stribeck", "offset")))
    held = (effects.BaseTilt(), effects.JointZero(3), effects.TorqueGain(2))
    robot = RobotIdentifier("six.urdf", dt=0.01, friction=PLAIN, effects=held)
    timed(found, "geometry", robot.fit, given[0], given[1], groups=given[2])
    return found | under("geometry", fitted_robot(robot, given[0], given[2]))


LINK = """
<link name="{name}"><inertial><origin xyz="{centre} 0 {up}"/><mass value="{mass}"/>
  <inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/>
</inertial></link>
<joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="{name}"/>
  <origin xyz="{origin} 0 {up}"/><axis xyz="{axis}"/>
  <limit lower="-3" upper="3" effort="100" velocity="10"/>
</joint>"""


def urdf(*links):
    """Return a robot of links (name, joint, origin, centre, mass, axis, up)."""
    keys = ("name", "joint", "origin", "centre", "mass", "axis", "up")
    text, parent = '<robot name="arm"><link name="base"/>', "base"
    for link in links:
        text += LINK.format(**dict(zip(keys, link)), parent=parent)
        parent = link[0]
    return text + "</robot>"


ARM = urdf(
    ("upper", "shoulder", 0, 0.2, 3, "0 1 0", 0),
    ("lower", "elbow", 0.4, 0.15, 2, "0 1 0", 0),
)
SIX = urdf(
    ("l1", "j1", 0, 0.03, 4, "0 0 1", 0.2),
    ("l2", "j2", 0, 0.2, 7, "0 1 0", 0.02),
    ("l3", "j3", 0.4, 0.18, 4, "0 1 0", -0.03),
    ("l4", "j4", 0.35, 0.05, 2, "1 0 0", 0.02),
    ("l5", "j5", 0.1, 0.06, 1.5, "0 1 0", 0.03),
    ("l6", "j6", 0.08, 0.05, 1, "1 0 0", 0.04),
)

# -- the command line ------------------------------------------------------------------

PACKAGE = sys.executable, "-m", "sklearn_vbjfa"
LAW = "pd kp=100,100 kd=5,5"
# Typed in this order in one folder, each as words.
COMMANDS = (
    "",
    "effects",
    "close-loop arm.csv --urdf arm.urdf --effects spring,ripple,stribeck --out report "
    "--ranges ranges.json",
    "close-loop a.csv b.csv --urdf arm.urdf --effects none --out two",
    "close-loop arm.csv --urdf arm.urdf --effects none --gain currents "
    "--known-mass lower=2 --out gains",
    "close-loop commands.csv --urdf arm.urdf --effects spring,stribeck --out driven "
    "--drive LAW",
    "inspect arm.csv --urdf arm.urdf",
    "inspect gap.csv --urdf arm.urdf",
    "inspect commands.csv --urdf arm.urdf --drive LAW",
    "simulate b.csv --model report/identified.json --window 0.3 --out again",
    "design --urdf arm.urdf --duration 4 --acceleration 3 --out motion.csv",
    "design --report report --duration 4 --acceleration 3 --out next.csv",
    # with a warning, or refused
    "close-loop unit.csv --urdf arm.urdf --effects none --out unit",
    "close-loop rest.csv --urdf arm.urdf --effects none --out rest",
    "close-loop missing.csv --urdf arm.urdf",
    "close-loop arm.csv --urdf missing.urdf",
    "close-loop arm.csv --urdf arm.urdf --effects unheard",
    "close-loop arm.csv --urdf arm.urdf --out .",
    "close-loop arm.csv",
    "inspect other.csv --urdf arm.urdf",
    "simulate arm.csv --model report/identified.json --window 100",
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
    q, tau = recording.q, recording.tau
    columns = np.column_stack([recording.t, q, tau])
    half = len(columns) // 2
    still, unit, commands = (columns.copy() for _ in range(3))
    still[:, 2] = 0.3
    unit[:, 3] *= 100.0
    # commands of the law, logged two samples before they act
    wanted = q + (tau + 5.0 * recording.states[:, 2:4]) / 100.0
    commands[:, 3:] = np.concatenate([wanted[2:], wanted[-1:], wanted[-1:]])
    written = {
        "arm": columns,
        "a": columns[:half],
        "b": columns[half:],
        "gap": np.delete(columns, np.s_[700:800], axis=0),
        "rest": still,
        "unit": unit,
        "commands": commands,
        "other": columns,
    }
    headers = {"other": "a,b,c,d,e", "commands": "t,q1,q2,q_desired1,q_desired2"}
    for name, table in written.items():
        header = headers.get(name, "t,q1,q2,tau1,tau2")
        options = {"fmt": "%.9g", "delimiter": ",", "comments": ""}
        np.savetxt(f"{name}.csv", table, header=header, **options)


def command_line(data_home):
    """Exit codes of commands, names and numbers of their files."""
    write_tables()
    found, seen = {}, set(Path().rglob("*"))
    for command in COMMANDS:
        title = f"'{command}'"
        words = [LAW if word == "LAW" else word for word in command.split()]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([*PACKAGE, *words], capture_output=True)
        found[f"{title}, exit code"] = done.returncode
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = [x.ru_utime + x.ru_stime for x in (before, after)]
        found[f"seconds|{title}"] = seconds[1] - seconds[0]
        new = sorted(path for path in Path().rglob("*") if path not in seen)
        seen.update(new)
        found[f"{title}, files"] = [path.as_posix() for path in new]
        for path in new:
            found |= {f"{title}, file|{path}{k}": v for k, v in numbers(path).items()}
    return found


def numbers(path):
    """Numbers of a file by key; none of the saved model, which has no fixed format."""
    kind = path.suffix[1:]
    if kind in READERS:
        return {f", {key}": value for key, value in READERS[kind](path).items()}
    if kind == "json" and path.name != "identified.json":
        return {"": flat(json.loads(path.read_text()))}
    if kind == "csv":
        with path.open(newline="") as file:
            return {"": flat(list(csv.DictReader(file)))}
    return {}


def flat(value, key=""):
    """Numbers and labels of nested dicts and lists, by path."""
    if isinstance(value, dict):
        parts = [(f"{key}/{k}", x) for k, x in value.items()]
    elif isinstance(value, (list, tuple, np.ndarray)):
        parts = [(f"{key}/{k}", x) for k, x in enumerate(value)]
    else:
        try:
            return {key: float(value)}
        except (TypeError, ValueError):
            return {key: value} if key.rpartition("/")[2] in LABELS else {}
    return {k: x for name, part in parts for k, x in flat(part, name).items()}


PARTS = {"tables": tables, "identifiers": identifiers, "whole robot": whole_robot}
PARTS |= {name: functools.partial(recorded, name) for name in SETS}
PARTS |= {"go2": go2, "command line": command_line}

# -- freezing and comparing ------------------------------------------------------------


def run_part(name, path, checkout, data_home):
    """Store the figures of one part, computed in a temporary folder."""
    package = Path(sklearn_vbjfa.__file__).parents[1]
    if not package.samefile(checkout):
        raise SystemExit(f"the package is that of {package}, not of {checkout}")
    path = os.path.abspath(path)
    with tempfile.TemporaryDirectory() as folder:
        # Several files are one recording, which has the name of their folder.
        work = Path(folder) / "recordings"
        work.mkdir()
        os.chdir(work)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                figures = PARTS[name](data_home)
            except OSError as missing:
                if name not in (*SETS, "go2"):
                    raise
                print(f"{name}: left out, {missing}", flush=True)
                return
    figures = {
        key: value if isinstance(value, dict) else np.asarray(value).tolist()
        for key, value in figures.items()
        if value is not None
    }
    usage = [resource.getrusage(who) for who in (0, resource.RUSAGE_CHILDREN)]
    part = {
        "seconds": round(sum(u.ru_utime + u.ru_stime for u in usage), 1),
        "megabytes": round(max(u.ru_maxrss for u in usage) / 1024),
        "figures": figures,
    }
    Path(path).write_text(json.dumps(part))
    print("{}: {seconds} s, {megabytes} MB".format(name, **part), flush=True)


def freeze(path, checkout, data_home, names):
    """Store the figures of all parts in a JSON file."""
    stored = {}
    options = ["--checkout", checkout]
    options += ["--data-home", data_home] if data_home else []
    with tempfile.TemporaryDirectory() as folder:
        part = Path(folder) / "part.json"
        for name in names:
            done = subprocess.run(
                [sys.executable, HERE, "part", part, "--only", name, *options],
                env=os.environ | {"PYTHONPATH": checkout, "TQDM_DISABLE": "1"},
            )
            if done.returncode:
                print(f"{name}: failed", flush=True)
            elif part.exists():
                stored[name] = json.loads(part.read_text())
                part.unlink()
            Path(path).write_text(json.dumps(stored))


def same(one, other):
    """Whether two entries of a file are equal to six digits."""
    if not (isinstance(one, float) and isinstance(other, float)):
        return one == other
    close = math.isclose(one, other, rel_tol=DIGITS, abs_tol=1e-12)
    return close or (math.isnan(one) and math.isnan(other))


def difference(one, other, metric=None):
    """Relative difference of two arrays; infinity where they do not match."""
    if isinstance(one, dict):
        common = one.keys() & other.keys()
        return 0.0 if all(same(one[k], other[k]) for k in common) else np.inf
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


def differences(one, two):
    """Return the differences between figures that both states have, name -> text."""
    found = {}
    for key in sorted(one.keys() & two.keys()):
        if key.startswith("seconds|"):
            continue
        metric = None
        if "theta|" in key and key.split("theta|")[0] + "metric" in one:
            metric = np.asarray(one[key.split("theta|")[0] + "metric"])
        apart = difference(one[key], two[key], metric)
        # Printed, or zero but for the solver's tolerance.
        rough = "file|" in key or "min_eigenvalues_" in key
        if not apart <= (DIGITS if rough else TOLERANCE):
            found[key] = f"{apart:.2e}" if np.isfinite(apart) else shown(one, two, key)
    return found


def shown(one, two, key):
    """Describe a difference that has no size."""
    one, two = one[key], two[key]
    if isinstance(one, dict):
        changed = [k for k in one if k in two and not same(one[k], two[k])]
        first = [f"{k} {one[k]} -> {two[k]}" for k in changed[:3]]
        return f"{len(changed)} of {len(one)} numbers: {'; '.join(first)}"
    return "{} -> {}".format(*(str(x)[:200] for x in (one, two)))


def compare(path, other):
    """Print the differences between two files; return whether there are any."""
    one, two = (json.loads(Path(file).read_text()) for file in (path, other))
    different = False
    for name in one.keys() ^ two.keys():
        print(f"{name}: only in {path if name in one else other}")
        different = True
    for name in (name for name in PARTS if name in one and name in two):
        parts = one[name], two[name]
        figures = [part["figures"] for part in parts]
        found = differences(*figures)
        for key, how in found.items():
            print(f"{name}: {key}: {how}")
        different |= bool(found)
        common = figures[0].keys() & figures[1].keys()
        for which, own in zip(("first", "second"), figures):
            if lacking := sorted(own.keys() - common):
                print(f"{name}: only in the {which}: {', '.join(lacking)}")
        for key in sorted(key for key in common if key.startswith("seconds|")):
            cost = [f"{x[key]:.2f} s" for x in figures]
            print(f"{name}: {key[8:]}: {' -> '.join(cost)}")
        cost = [f"{p['seconds']} s and {p['megabytes']} MB" for p in parts]
        n = sum(not key.startswith("seconds|") for key in common)
        print(f"{name}: {n - len(found)} of {n} equal; {' -> '.join(cost)}")
    return different


def main(argv=None):
    """Freeze, or compare."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    actions = arguments.add_subparsers(dest="action", required=True)
    # "part" is what "freeze" starts
    for name in ("freeze", "part"):
        action = actions.add_parser(name)
        action.add_argument("path", metavar="FILE")
        here = str(HERE.parents[2])
        action.add_argument("--checkout", type=os.path.abspath, default=here)
        data = os.environ.get("SKLEARN_VBJFA_DATA")
        action.add_argument("--data-home", type=os.path.abspath, default=data)
        action.add_argument("--only", choices=PARTS, action="append")
    action = actions.add_parser("compare")
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
