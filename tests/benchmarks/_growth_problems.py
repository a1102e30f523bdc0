"""The problems and models whose growth is measured, by asv and by bench_growth alike.

A task is one method on one problem: `prepare` makes the data, `run` does the work and
returns its seconds, `error` compares with the truth of the generator. Seconds are those
of the processor, which others on the machine do not add to.
"""

import time

import numpy as np
from _report import add_root_to_path
from sklearn.base import clone
from sklearn.cross_decomposition import PLSRegression
from sklearn.linear_model import (
    ARDRegression,
    BayesianRidge,
    LassoCV,
    LinearRegression,
    Ridge,
)

from sklearn_vbjfa import JFARegressor, VBJFARegressor

SEED = 0
FACTORS = 20
RELEVANT = 10
# Share of each observed column's variance that is noise, in the study of growth.
INPUT_NOISE = 0.2
# Columns of the study of rows, and rows of the study of columns.
COLUMNS = 20
ROWS = 1000
# More rows than this are not held in memory: `partial_fit` takes them in chunks.
MOST_ROWS = 1_000_000
CHUNK = 100_000
# The recordings of the study of joints.
DURATION, DT = 20.0, 0.01
TEST_DURATION = 5.0
FRICTION = ("viscous",)
# Coulomb friction that the declared model of the search lacks, as a share of the
# standard deviation of the first joint's torque.
UNDECLARED = 0.3
PROJECTIONS = 5


class LinearProblem:
    """Correlated columns: 20 common factors plus noise of half their deviation.

    t = F B + 0.5 E with standard normal F (n, 20), E (n, d) and B (20, d) scaled by
    1 / sqrt(20); y depends on ten columns of t, with noise of half its deviation.
    Observed is X = t plus independent noise, which is a given share of the variance
    of each column of X. Drawn in chunks, each with a seed of its own, so that the
    making takes no more memory than the result.

    Parameters
    ----------
    n_samples, n_features : int
        Rows n and columns d.
    input_noise : float
        Share of the variance of X that is noise, in [0, 1).
    """

    def __init__(self, n_samples, n_features, input_noise=0.0):
        rng = np.random.default_rng([SEED, n_features])
        self.n_samples, self.n_features = n_samples, n_features
        self.mixing = rng.normal(size=(FACTORS, n_features)) / np.sqrt(FACTORS)
        self.coef = np.zeros(n_features)
        n_relevant = min(RELEVANT, n_features)
        chosen = rng.choice(n_features, size=n_relevant, replace=False)
        self.coef[chosen] = rng.normal(size=n_relevant)
        # Variances of the generator, not of the sample: all chunks have the same.
        common = self.mixing @ self.coef
        clean = common @ common + 0.25 * self.coef @ self.coef
        self.output_noise = 0.25 * clean
        variance = np.einsum("km,km->m", self.mixing, self.mixing) + 0.25
        self.input_noise = input_noise / (1.0 - input_noise) * variance

    @property
    def signal_covariance(self):
        """Covariance of the noiseless columns t, shape (d, d)."""
        return self.mixing.T @ self.mixing + 0.25 * np.eye(self.n_features)

    def chunks(self, size=CHUNK):
        """Yield X (m, d) and y (m,) of one chunk of rows after the other."""
        for number, start in enumerate(range(0, self.n_samples, size)):
            rng = np.random.default_rng([SEED, self.n_features, 1 + number])
            rows = min(size, self.n_samples - start)
            X = rng.normal(size=(rows, self.n_features))
            X *= 0.5
            X += rng.normal(size=(rows, FACTORS)) @ self.mixing
            y = X @ self.coef
            y += np.sqrt(self.output_noise) * rng.normal(size=rows)
            if self.input_noise.any():
                noise = rng.normal(size=X.shape)
                noise *= np.sqrt(self.input_noise)
                X += noise
            yield X, y

    def arrays(self):
        """Return all rows: X (n, d) and y (n,)."""
        X = np.empty((self.n_samples, self.n_features))
        y = np.empty(self.n_samples)
        start = 0
        for part, output in self.chunks():
            rows = slice(start, start + output.size)
            X[rows], y[rows] = part, output
            start += output.size
        return X, y

    def error(self, coef):
        """Distance of coefficients from the truth, relative to its length."""
        gap = np.linalg.norm(np.ravel(coef) - self.coef)
        return float(gap / np.linalg.norm(self.coef))


def _orthogonal_distance():
    from bench_errors_in_variables import OrthogonalDistance

    return OrthogonalDistance(max_rows=10**9)


# Name -> function that makes the estimator: defaults but for what the name says.
OURS = {
    "VB-JFA": VBJFARegressor,
    "VB-JFA, independent": lambda: VBJFARegressor(
        latent="independent", query="noiseless"
    ),
    "JFA": lambda: JFARegressor(query="noiseless"),
}
RIVALS = {
    "LinearRegression": LinearRegression,
    "Ridge": Ridge,
    "BayesianRidge": BayesianRidge,
    "ARDRegression": ARDRegression,
    "LassoCV": LassoCV,
    "PLSRegression": PLSRegression,
    "ODR (odrpack)": _orthogonal_distance,
}
NOISE_GIVEN = "VB-JFA, noise given"
LINEAR = (*OURS, NOISE_GIVEN, *RIVALS)
STREAMED = (*OURS, NOISE_GIVEN)

IDENTIFIER = "RobotIdentifier"
PROJECTION = "PhysicalProjector"
DISCOVERY = "EffectDiscovery"
# The identifier with other regressors in its place, and no projection.
IDENTIFIERS = (IDENTIFIER, *OURS, *RIVALS)
ROBOT = (*IDENTIFIERS, PROJECTION, DISCOVERY)


class LinearTask:
    """Fit of one linear model; in chunks where there are too many rows to hold."""

    def __init__(self, method, n_samples, n_features, *, streamed=None):
        self.problem = LinearProblem(n_samples, n_features, INPUT_NOISE)
        self.method = method
        if streamed is None:
            streamed = n_samples > MOST_ROWS and method in STREAMED
        self.streamed = streamed

    def prepare(self):
        """Make the estimator and, if they are to be held, the data."""
        if self.method == NOISE_GIVEN:
            self.estimator = VBJFARegressor(
                input_noise=self.problem.input_noise, query="noiseless"
            )
        else:
            self.estimator = {**OURS, **RIVALS}[self.method]()
        if self.streamed:
            self.parts = self.problem.chunks
        else:
            self.X, self.y = self.problem.arrays()
        return self

    def hold(self):
        """Keep the chunks, so that the making of data is not timed with the rest."""
        kept = list(self.problem.chunks())
        self.parts = lambda: kept
        return self

    def run(self):
        """Fit; return the seconds in the estimator."""
        self.model = clone(self.estimator)
        if not self.streamed:
            started = time.process_time()
            self.model.fit(self.X, self.y)
            return time.process_time() - started
        seconds = 0.0
        for X, y in self.parts():
            started = time.process_time()
            self.model.partial_fit(X, y)
            seconds += time.process_time() - started
        return seconds

    def error(self):
        """Relative error of the coefficients."""
        return self.problem.error(self.model.coef_)


class RobotData:
    """Simulated recording of a chain of revolute joints, and another motion of it."""

    def __init__(self, n_joints):
        from _simulated_models import chain

        from sklearn_vbjfa.datasets import make_robot_recording

        self.robot = chain(n_joints, np.random.default_rng(SEED))
        self.recording = make_robot_recording(
            self.robot, duration=DURATION, dt=DT, friction=FRICTION, random_state=SEED
        )
        self.new = make_robot_recording(
            self.robot,
            duration=TEST_DURATION,
            dt=DT,
            friction=self.recording.friction,
            inertial=self.recording.inertial,
            encoder_noise=0.0,
            torque_noise=0.0,
            random_state=SEED + 1,
        )

    def identifier(self, **settings):
        """Return the identifier of this robot."""
        from sklearn_vbjfa import RobotIdentifier

        return RobotIdentifier(self.robot, dt=DT, friction=FRICTION, **settings)


class IdentificationTask:
    """Identification of a chain: positions and torques in, parameters out."""

    def __init__(self, method, n_joints):
        self.method, self.n_joints = method, n_joints

    def prepare(self):
        """Simulate the recording."""
        self.data = RobotData(self.n_joints)
        settings = {}
        if self.method != IDENTIFIER:
            regressor = {**OURS, **RIVALS}[self.method]()
            settings = {"regressor": regressor, "projector": None}
        self.estimator = self.data.identifier(**settings)
        return self

    def run(self):
        """Identify; return the seconds."""
        started = time.process_time()
        recording = self.data.recording
        self.model = clone(self.estimator).fit(recording.q, recording.tau)
        return time.process_time() - started

    def error(self):
        """Error of the parameters in the metric of another motion, relative.

        That is |Phi (theta - truth)| / |Phi truth| with the regressor matrix Phi of a
        noiseless motion that was not fitted, each joint in units of its torque: single
        parameters have no unique values.
        """
        new = self.data.new
        gap = self.model.predict(new.states) - new.tau_clean
        size = np.sqrt(np.mean(new.tau_clean**2, axis=0))
        return float(np.sqrt(np.mean((gap / size) ** 2)))


class ProjectionTask:
    """Projection of spoiled parameters of robots made of point masses."""

    def __init__(self, method, n_joints):
        self.n_joints = n_joints

    def prepare(self):
        """Draw robots, spoil their parameters, draw metrics."""
        add_root_to_path()
        from tests.physical._problems import metric, robot

        self.problems = []
        for seed in range(PROJECTIONS):
            rng = np.random.default_rng([SEED, seed, self.n_joints])
            truth = robot(rng, self.n_joints)
            noise = rng.normal(size=truth.size) * (np.abs(truth) + 0.2)
            A = metric(rng, truth.size, 1e4)
            self.problems.append((truth, truth + 0.5 * noise, A))
        return self

    def run(self):
        """Project; return the seconds of one projection."""
        from sklearn_vbjfa.physical import project

        started = time.process_time()
        self.found = [project(spoiled, A) for _, spoiled, A in self.problems]
        return (time.process_time() - started) / PROJECTIONS

    def error(self):
        """Distance from the truth after over before projection, root mean square.

        In the projection's own metric. The set is convex and holds the truth, so that
        it cannot exceed one.
        """
        shares = [
            ((result.theta - truth) @ A @ (result.theta - truth))
            / ((spoiled - truth) @ A @ (spoiled - truth))
            for result, (truth, spoiled, A) in zip(self.found, self.problems)
        ]
        return float(np.sqrt(np.mean(shares)))


class DiscoveryTask:
    """Search of the whole library for Coulomb friction that one joint has."""

    def __init__(self, method, n_joints):
        self.n_joints = n_joints

    def prepare(self):
        """Simulate, and add the friction."""
        from sklearn_vbjfa import EffectDiscovery

        self.data = RobotData(self.n_joints)
        recording = self.data.recording
        self.tau = recording.tau.copy()
        self.size = UNDECLARED * self.tau[:, 0].std()
        velocity = recording.states[:, self.n_joints]
        self.tau[:, 0] += self.size * np.sign(velocity)
        self.estimator = EffectDiscovery(self.data.identifier(), random_state=SEED)
        return self

    def run(self):
        """Search; return the seconds."""
        started = time.process_time()
        self.model = clone(self.estimator).fit(self.data.recording.q, self.tau)
        return time.process_time() - started

    def error(self):
        """Relative error of the friction that was found, with the plain terms."""
        robot = self.model.identifier_
        names = [name.partition(":")[2] for name in robot.parameter_names_]
        found = robot.theta_[names.index("coulomb")]
        return float(abs(found / self.size - 1.0))


def _robot_task(method, n_joints):
    kinds = {PROJECTION: ProjectionTask, DISCOVERY: DiscoveryTask}
    return kinds.get(method, IdentificationTask)(method, n_joints)


# What grows -> sizes, methods, and the task of a method and a size.
STUDIES = {
    "rows": (
        (10**3, 10**4, 10**5, 10**6, 10**7),
        LINEAR,
        lambda method, n: LinearTask(method, n, COLUMNS),
    ),
    "columns": (
        (10, 50, 200, 1000, 5000),
        LINEAR,
        lambda method, d: LinearTask(method, ROWS, d),
    ),
    "joints": ((1, 6, 12, 25, 50), ROBOT, _robot_task),
}


def make_task(study, method, size):
    """Return the task of a study ("rows", "columns", "joints"), ready to run."""
    return STUDIES[study][2](method, size).prepare()
