"""Identification of simulated arms from positions alone, over a grid of conditions.

Run ``python tests/benchmarks/bench_simulated_arms.py [--small] [--write]``. For every
condition one recording of 40 s is simulated (white encoder noise, 5 % white torque
noise, viscous and Coulomb friction) and the torque of a new, noiseless motion is
predicted. Beside `RobotIdentifier` with its defaults: least squares with the true
states (clean-data oracle), and least squares in the same chain with the state cut-off
that an oracle picked on that new motion.
"""

import itertools
import tempfile
import warnings
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from _report import parser, publish
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import demo_arm_urdf, make_robot_recording

FRICTION = ("viscous", "coulomb")
CUTOFFS_PER_MOTION = (1.5, 2.0, 3.0, 4.0, 6.0, 10.0)  # times the motion's frequency


def seven_axis_urdf(folder):
    """Write the demo arm with one more axis in the upper arm; return the path."""
    tree = ElementTree.parse(demo_arm_urdf())
    root = tree.getroot()
    for joint in root.findall("joint"):
        if joint.get("name") == "joint_3":
            joint.find("parent").set("link", "turned_arm")
            joint.find("origin").set("xyz", "0 0 0.2")
    extra = ElementTree.fromstring(
        '<robot><joint name="joint_2b" type="revolute"><parent link="upper_arm"/>'
        '<child link="turned_arm"/><origin xyz="0 0 0.2" rpy="0 0 0"/>'
        '<axis xyz="0 0 1"/><limit lower="-2.5" upper="2.5" effort="300" '
        'velocity="4"/></joint><link name="turned_arm"><inertial>'
        '<origin xyz="0.01 0 0.1"/><mass value="3"/><inertia ixx="0.02" ixy="0" '
        'ixz="0" iyy="0.02" iyz="0" izz="0.01"/></inertial></link></robot>'
    )
    root.extend(list(extra))
    path = Path(folder) / "arm7.urdf"
    tree.write(path)
    return str(path)


def _nmse(predicted, truth):
    return float(np.mean(np.mean((predicted - truth) ** 2, axis=0) / truth.var(axis=0)))


def run_condition(urdf, *, frequency, rate, encoder_noise, seed, duration=40.0):
    """Return the figures of one condition as a dict."""
    dt = 1.0 / rate
    recording = make_robot_recording(
        urdf,
        duration=duration,
        dt=dt,
        frequency=frequency,
        encoder_noise=encoder_noise,
        torque_noise=0.05,
        random_state=seed,
    )
    new = make_robot_recording(
        urdf,
        duration=20.0,
        dt=0.01,
        frequency=frequency,
        encoder_noise=0.0,
        torque_noise=0.0,
        inertial=recording.inertial,
        friction=recording.friction,
        random_state=seed + 1000,
    )

    def fit(X, **settings):
        model = RobotIdentifier(urdf, dt=dt, friction=FRICTION, **settings)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return model.fit(X, recording.tau)

    least_squares = {
        "regressor": LinearRegression(),
        "projector": None,
        "input_noise": None,
    }
    ours = fit(recording.q)
    plain = fit(recording.q, projector=None)
    oracle = fit(recording.states, cutoff=None, standstill=None, **least_squares)
    best = min(
        _nmse(
            fit(recording.q, state_cutoff=c * frequency, **least_squares).predict(
                new.states
            ),
            new.tau,
        )
        for c in CUTOFFS_PER_MOTION
        if c * frequency < 0.45 * rate
    )
    truth = recording.theta(FRICTION)
    known = plain.identifiable_
    z = (plain.theta_unconstrained_ - truth)[known] / plain.theta_std_[known]
    gain = np.sqrt(np.sum(plain.estimator_.lowpass_.taps**2))
    return {
        "ours": _nmse(ours.predict(new.states), new.tau),
        "unprojected": _nmse(plain.predict(new.states), new.tau),
        "oracle": _nmse(oracle.predict(new.states), new.tau),
        "best least squares": best,
        "output noise": plain.output_noise_ / (recording.torque_noise * gain),
        "covered": np.abs(z) < 1.645,
        "cutoff": ours.cutoff_,
    }


def grid(small=False):
    """Conditions: axes, frequency [Hz], rate [Hz], encoder noise [rad]."""
    if small:
        return [(6, 0.7, 100.0, 1e-3)]
    return list(
        itertools.product(
            (6, 7), (0.7, 2.0, 4.0), (100.0, 250.0, 500.0), (1e-4, 1e-3, 3e-3)
        )
    )


def run(conditions, duration=40.0, on_row=None):
    """Return a list of (condition, figures)."""
    results = []
    with tempfile.TemporaryDirectory() as folder:
        urdfs = {6: demo_arm_urdf(), 7: seven_axis_urdf(folder)}
        for seed, (axes, frequency, rate, noise) in enumerate(conditions):
            figures = run_condition(
                urdfs[axes],
                frequency=frequency,
                rate=rate,
                encoder_noise=noise,
                seed=seed,
                duration=duration,
            )
            results.append(((axes, frequency, rate, noise), figures))
            if on_row is not None:
                on_row(results[-1])
    return results


def tables(results):
    """Return the table of conditions and the summary as text."""
    from tabulate import tabulate

    rows = []
    for (axes, frequency, rate, noise), f in results:
        rows.append(
            [
                axes,
                frequency,
                f"{rate:.0f}",
                f"{noise:.0e}",
                f"{f['ours']:.2e}",
                f"{f['unprojected']:.2e}",
                f"{f['oracle']:.2e}",
                f"{f['best least squares']:.2e}",
                f"{f['ours'] / f['oracle']:.2f}",
                f"{f['ours'] / f['best least squares']:.2f}",
                f"{f['output noise'].min():.2f} - {f['output noise'].max():.2f}",
                f"{100 * f['covered'].mean():.0f}",
            ]
        )
    headers = ["axes", "motion [Hz]", "rate [Hz]", "noise [rad]", "ours"]
    headers += ["unprojected", "oracle", "best LS", "ours / oracle", "ours / best LS"]
    headers += ["output noise / true", "90 % cover [%]"]
    table = tabulate(rows, headers=headers, tablefmt="rst", disable_numparse=True)
    to_oracle = np.array([f["ours"] / f["oracle"] for _, f in results])
    to_best = np.array([f["ours"] / f["best least squares"] for _, f in results])
    noise = np.concatenate([f["output noise"] for _, f in results])
    covered = np.concatenate([f["covered"] for _, f in results])
    summary = (
        f"ours / oracle: median {np.median(to_oracle):.2f}, worst "
        f"{to_oracle.max():.2f}; ours / best least squares: worst {to_best.max():.2f}; "
        f"output noise within 15 % of the truth: "
        f"{100 * np.mean(np.abs(noise - 1) < 0.15):.0f} % of the joints; 90 % "
        f"intervals cover {100 * covered.mean():.1f} % of {covered.size} parameters."
    )
    return table, summary


def main():
    """Run the grid from the command line."""
    arguments = parser(__doc__)
    arguments.add_argument("--small", action="store_true", help="one condition only")
    arguments = arguments.parse_args()
    results = run(
        grid(arguments.small),
        on_row=lambda row: print(tables([row])[0].splitlines()[-2], flush=True),
    )
    table, summary = tables(results)
    publish("simulated_arms", f"{table}\n\n{summary}", write=arguments.write)


if __name__ == "__main__":
    main()
