"""Errors-in-variables methods on the same robot regressors.

Run ``python tests/benchmarks/bench_errors_in_variables.py [--write]``. A simulated
six-axis arm (50 s at 100 Hz, motion up to 2 Hz, 5 % torque noise) with little and with
much encoder noise; the states are smoothed lightly on purpose (cut-off stated) and
nothing is filtered afterwards, so that the regressors are noisy. All methods get the
same equations, weighted and scaled; the torque of a new, noiseless motion is predicted.
odrpack and popsregression take part where they are installed.
"""

import importlib.util
import time
import warnings

import numpy as np
from _report import parser, publish, rst_table
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.linear_model import ARDRegression, BayesianRidge, LinearRegression

from sklearn_vbjfa import (
    InstrumentalVariables,
    RobotIdentifier,
    TotalLeastSquares,
    VBJFARegressor,
)
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.robot._plan import corrects_noise

FRICTION = ("viscous", "coulomb")
CONDITIONS = [(1e-4, 15.0), (1e-3, 10.0), (1e-3, 20.0), (3e-3, 10.0)]


class OrthogonalDistance(RegressorMixin, BaseEstimator):
    """Linear model by odrpack, equal noise in all (scaled) inputs and the output."""

    def __init__(self, max_rows=1000):
        self.max_rows = max_rows

    def fit(self, X, y):
        """Fit at most `max_rows` rows, evenly spaced: the cost grows steeply."""
        from odrpack import odr_fit

        rows = np.linspace(0, len(y) - 1, min(self.max_rows, len(y))).astype(int)
        start = np.linalg.lstsq(X, y, rcond=1e-8)[0]
        result = odr_fit(
            lambda x, beta: beta @ x,
            np.ascontiguousarray(X[rows].T),
            y[rows],
            start,
            jac_beta=lambda x, beta: x.copy(),
            jac_x=lambda x, beta: np.repeat(beta[:, None], x.shape[1], axis=1),
            maxit=20,
        )
        self.coef_ = result.beta
        return self

    def predict(self, X):
        """Predict."""
        return X @ self.coef_


def methods():
    """Name -> settings of the identifier."""
    plain = {"projector": None}
    found = {
        "VB, noise measured": {"regressor": None, **plain},
        "VB, noise taken as zero": {
            "regressor": VBJFARegressor(latent="correlated", input_noise=0.0),
            **plain,
        },
        "VB-JFA, independent": {
            "regressor": VBJFARegressor(latent="independent", query="noiseless"),
            **plain,
        },
        "least squares": {"regressor": LinearRegression(), **plain},
        "IV, even/odd": {"regressor": InstrumentalVariables(), **plain},
        "TLS": {"regressor": TotalLeastSquares(), **plain},
        "BayesianRidge": {"regressor": BayesianRidge(), **plain},
        "ARDRegression": {"regressor": ARDRegression(), **plain},
    }
    if importlib.util.find_spec("odrpack"):
        found["ODR (1,000 rows)"] = {"regressor": OrthogonalDistance(), **plain}
    if importlib.util.find_spec("popsregression"):
        from popsregression import POPSRegression

        found["POPS"] = {"regressor": POPSRegression(), **plain}
    return found


def run_condition(encoder_noise, cutoff, *, duration=50.0, names=None):
    """Return name -> (nMSE on the new motion, seconds)."""
    recording = make_robot_recording(
        duration=duration,
        dt=0.01,
        frequency=2.0,
        encoder_noise=encoder_noise,
        random_state=0,
    )
    new = make_robot_recording(
        duration=20.0,
        dt=0.01,
        frequency=2.0,
        encoder_noise=0.0,
        torque_noise=0.0,
        inertial=recording.inertial,
        friction=recording.friction,
        random_state=1,
    )
    shared = RobotIdentifier(
        recording.urdf,
        dt=recording.dt,
        friction=FRICTION,
        cutoff=None,
        state_cutoff=cutoff,
    )
    part = (recording.q, recording.tau, recording.groups)
    base = shared.fit(*part)
    robot = base.robot_
    pieces = robot.pieces(*part)
    measured = robot.pieces(*part, halves="noise")
    results = {}
    for name, settings in methods().items():
        if names is not None and name not in names:
            continue
        model = RobotIdentifier(**{**shared.get_params(), **settings})
        rows = measured if corrects_noise(model.regressor) else pieces
        if name.startswith("IV"):
            rows = robot.pieces(*part, halves="instruments")
        start = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = model.estimated(rows, robot.plan)
        seconds = time.perf_counter() - start
        # These states are true: a joint that moves slowly does not stand.
        error = base.features_.matrices(new.states) @ found.theta - new.tau
        nmse = np.mean(np.mean(error**2, axis=0) / new.tau.var(axis=0))
        results[name] = (float(nmse), seconds)
    return results


def main():
    """Run all conditions from the command line."""
    arguments = parser(__doc__).parse_args()
    results = {c: run_condition(*c) for c in CONDITIONS}
    names = list(next(iter(results.values())))
    rows = [
        [
            name,
            *(f"{results[c][name][0]:.1e}" for c in CONDITIONS),
            f"{max(results[c][name][1] for c in CONDITIONS):.1f}",
        ]
        for name in names
    ]
    headers = ["method", *(f"{n:.0e} rad, {c:.0f} Hz" for n, c in CONDITIONS), "s"]
    publish(
        "errors_in_variables",
        "nMSE of the torque on a new, noiseless motion; encoder noise, state cut-off."
        f"\n\n{rst_table(rows, headers)}",
        write=arguments.write,
    )


if __name__ == "__main__":
    main()
