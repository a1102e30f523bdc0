"""Freeze what the package computes, and compare two states of its code.

Run ``python tests/benchmarks/compare_states.py freeze FILE [--data-home DIR]`` on one
state of the code and again on the other, then ``python
tests/benchmarks/compare_states.py compare FILE OTHER``. For a change of the code's
shape that should not change a number. Only public names are used, so that the script
of one state runs on the other; one thread and one kernel of the linear algebra.

Predicted torques are compared over their own size; parameters in the norm of the
second moments that they were fitted to, since single entries near zero mean nothing;
names to the letter; everything else as whole arrays. Exit status 1 at a difference.
"""

import os

if __name__ == "__main__":
    # before NumPy loads its linear algebra
    os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
    os.environ.setdefault("OPENBLAS_CORETYPE", "Haswell")

import argparse
import sys
import time
import warnings

import numpy as np

from sklearn_vbjfa import (
    EffectDiscovery,
    JFARegressor,
    RobotIdentifier,
    StateEstimator,
    VBJFARegressor,
    datasets,
)

TOLERANCE = 1e-9
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
        recording = getattr(datasets, f"fetch_{name}")(data_home=data_home)
    if names:
        recording = recording.select(*names)
    rows = recording.t - recording.t[0] < seconds
    identifier = RobotIdentifier(
        recording.robot_model(),
        dt=recording.dt,
        **{"friction": ("viscous",), **settings},
    )
    return recording.q[rows], recording.tau[rows], recording.groups[rows], identifier


def fitted_robot(identifier, q, groups):
    """Figures of a fitted identifier."""
    found = {name: np.asarray(getattr(identifier, name)) for name in FITTED}
    found["theta|parameters"] = identifier.theta_
    found["theta|unconstrained"] = identifier.theta_unconstrained_
    found["metric"] = identifier.estimator_.metric_
    found["torque"] = identifier.predict(q, groups=groups)
    found["names"] = np.array(identifier.parameter_names_)
    return found


def closed_loop(name, data_home):
    """Figures of a fit and of a search on one recording."""
    q, tau, groups, identifier = load(name, data_home)
    found = fitted_robot(identifier.fit(q, tau, groups=groups), q, groups)
    search = EffectDiscovery(identifier, random_state=0).fit(q, tau, groups=groups)
    effects = [f"{effect.name} {effect.joint}" for effect in search.effects_]
    found["search, effects"] = np.array(effects)
    found["search, before"] = search.error_before_
    found["search, after"] = search.error_after_
    model = search.identifier_
    found["search, torque"] = model.predict(q, groups=groups)
    found["search, report"] = np.array(str(search.report_).splitlines())
    return found


def head():
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


def tables():
    """Posteriors of the regressors on tables."""
    data = datasets.make_noisy_regression(400, n_irrelevant=10, random_state=0)
    known = {"latent": "correlated", "input_noise": data.input_noise_covariance}
    models = {
        "jfa": JFARegressor(),
        "paper": VBJFARegressor(latent="independent", prior="paper"),
        "independent": VBJFARegressor(latent="independent"),
        "default": VBJFARegressor(),
        "exact": VBJFARegressor(latent="correlated", input_noise=0.0),
        "known": VBJFARegressor(**known),
    }
    found = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # convergence is compared, not wanted
        for name, model in models.items():
            model.fit(data.X, data.y)
            figures = public_arrays(model) | {"torque": model.predict(data.X_test)}
            found.update({f"{name}, {k}": v for k, v in figures.items()})
    recording = datasets.load_demo_recording()
    states = StateEstimator(dt=recording.dt).fit(recording.q)
    found["states"] = states.transform(recording.q)
    return found


def freeze(path, data_home):
    """Store all figures in a file of NumPy's."""
    parts = {"tables": tables, "head": head}
    parts |= {name: lambda name=name: closed_loop(name, data_home) for name in SETS}
    stored = {}
    for name, part in parts.items():
        started = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            stored |= {f"{name}: {key}": value for key, value in part().items()}
        print(f"{name}: {time.perf_counter() - started:.0f} s", flush=True)
    np.savez_compressed(path, **stored)


def difference(one, other, metric):
    """Relative difference of two arrays; infinity where they do not match."""
    one, other = np.asarray(one), np.asarray(other)
    if one.shape != other.shape:
        return np.inf
    if one.dtype.kind in "bU":
        return 0.0 if np.array_equal(one, other) else np.inf
    if not np.array_equal(np.isfinite(one), np.isfinite(other)):
        return np.inf
    finite = np.isfinite(one)
    change = np.where(finite, other, 0.0) - np.where(finite, one, 0.0)
    size = np.where(finite, one, 0.0)
    if metric is not None:
        squares = [float(x @ metric @ x) for x in (change, size)]
        return float(np.sqrt(max(squares[0], 0.0) / squares[1]))
    norm = np.linalg.norm(size)
    return float(np.linalg.norm(change) / norm) if norm else float(np.abs(change).max())


def compare(path, other):
    """Print what differs between two files; return whether anything does."""
    with np.load(path) as first, np.load(other) as second:
        one, two = dict(first), dict(second)
    worst = {}
    for key in sorted(one.keys() | two.keys()):
        if key not in one or key not in two:
            print(f"{key}: only in {path if key in one else other}")
            worst[key] = np.inf
            continue
        metric = None
        if "theta|" in key:
            metric = one[key.split("theta|")[0] + "metric"]
        worst[key] = difference(one[key], two[key], metric)
    different = {key: value for key, value in worst.items() if value > TOLERANCE}
    for key, value in different.items():
        print(f"{key}: {value:.2e}")
        if key in one and key in two and one[key].dtype.kind == "U":
            lines = set(one[key].tolist()), set(two[key].tolist())
            print("  - " + "\n  - ".join(sorted(lines[0] - lines[1])))
            print("  + " + "\n  + ".join(sorted(lines[1] - lines[0])))
    same = [value for value in worst.values() if value <= TOLERANCE]
    largest = max(same, default=0.0)
    print(f"{len(same)} of {len(worst)} equal to {TOLERANCE:g}, largest {largest:.1e}")
    return bool(different)


def main(argv=None):
    """Freeze, or compare."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    actions = arguments.add_subparsers(dest="action", required=True)
    action = actions.add_parser("freeze", help="store the figures of this state")
    action.add_argument("path", metavar="FILE")
    action.add_argument("--data-home", default=None, metavar="DIR")
    action = actions.add_parser("compare", help="print what differs")
    action.add_argument("path", metavar="FILE")
    action.add_argument("other", metavar="OTHER")
    arguments = arguments.parse_args(argv)
    if arguments.action == "freeze":
        freeze(arguments.path, arguments.data_home)
        return 0
    return int(compare(arguments.path, arguments.other))


if __name__ == "__main__":
    sys.exit(main())
