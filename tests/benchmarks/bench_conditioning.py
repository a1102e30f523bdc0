"""Errors of predictions by the condition number of the inputs.

Run ``python tests/benchmarks/bench_conditioning.py [--large] [--write]``. Inputs with
known singular values and y = X coef + noise, with the same part of y along each of the
singular directions; the reference is the orthogonal projection of y on the span from
which X was made, so that no least-squares solver is the judge of another.
"""

import time
import warnings

import numpy as np
from _report import parser, publish, rst_table, rst_title
from scipy import linalg
from sklearn.linear_model import LinearRegression, Ridge

from sklearn_vbjfa import VBJFARegressor
from sklearn_vbjfa._core import _moments
from sklearn_vbjfa.regression import fit_moments

CONDITIONS = (1e2, 1e4, 1e6, 1e8, 1e10, 1e12)
NOISES = (1e-2, 1e-6, 1e-10)
N_FEATURES = 20
OURS = "this package"
GRAM = "scatter alone"


def make_problem(n, condition, noise, seed=0):
    """Return X, y and the projection of y on the columns of X and a constant.

    The columns come in one unit; X = U diag(s) V' with s from 1 to 1 / condition.
    """
    rng = np.random.default_rng(seed)
    U = rng.normal(size=(n, N_FEATURES))
    U -= U.mean(axis=0)
    U = linalg.qr(U, mode="economic", overwrite_a=True)[0]
    V = linalg.qr(rng.normal(size=(N_FEATURES, N_FEATURES)))[0]
    singular = np.logspace(0, -np.log10(condition), N_FEATURES)
    X = (U * singular) @ V.T * np.sqrt(n)
    y = U @ rng.choice([-1.0, 1.0], N_FEATURES) * np.sqrt(n / N_FEATURES)
    y += noise * rng.normal(size=n)
    return X, y, U @ (U.T @ y) + y.mean()


def models():
    """Name -> function that fits X, y and returns a fitted model."""

    def ours():
        return VBJFARegressor(latent="correlated", input_noise=0.0)

    def scatter_alone(X, y):
        return fit_moments(ours(), _moments.from_data(X, y))

    exact = np.finfo(float).eps
    return {
        GRAM: scatter_alone,
        OURS: lambda X, y: ours().fit(X, y),
        "LinearRegression": lambda X, y: LinearRegression().fit(X, y),
        "LinearRegression(tol=eps)": lambda X, y: LinearRegression(tol=exact).fit(X, y),
        "Ridge(1e-12, cholesky)": lambda X, y: Ridge(
            alpha=1e-12, solver="cholesky"
        ).fit(X, y),
    }


def measure(n, condition, noise):
    """Name -> (relative error of the predictions, seconds, fitted model)."""
    X, y, reference = make_problem(n, condition, noise)
    spread = np.linalg.norm(reference - reference.mean())
    found = {}
    for name, fit in models().items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            started = time.perf_counter()
            try:
                model = fit(X, y)
                seconds = time.perf_counter() - started
                mean = X @ model.coef_ + model.intercept_
                error = np.linalg.norm(mean - reference) / spread
            except linalg.LinAlgError:
                model, seconds, error = None, np.nan, np.nan
        found[name] = (error, seconds, model)
    return found


def table(n, noises=NOISES, conditions=CONDITIONS):
    """Table for one number of samples, and its results."""
    rows, results = [], {}
    names = list(models())
    for noise in noises:
        for condition in conditions:
            found = results[noise, condition] = measure(n, condition, noise)
            factor = found[OURS][2].statistics_.factor is not None
            rows.append(
                [
                    f"{noise:.0e}",
                    f"{condition:.0e}",
                    *(f"{found[name][0]:.1e}" for name in names),
                    f"{noise * np.sqrt(N_FEATURES / n):.1e}",
                    "QR" if factor else "scatter",
                    *(f"{found[name][1]:.3f}" for name in (GRAM, OURS)),
                    f"{found[names[2]][1]:.3f}",
                ]
            )
    headers = ["noise", "condition", *names, "standard error", "decided for"]
    headers += ["scatter alone [s]", "this package [s]", "LinearRegression [s]"]
    return rst_table(rows, headers), results


def robot_motion(model, n, seed):
    """Positions, velocities and accelerations (n, nv) of sums of five sinusoids."""
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(n)[:, None, None]
    w = 2 * np.pi * rng.uniform(0.05, 1.0, (model.nv, 5))
    phase = rng.uniform(0, 2 * np.pi, w.shape)
    size = rng.uniform(0.1, 0.5, w.shape)
    wave, slope = size * np.sin(w * t + phase), size * w * np.cos(w * t + phase)
    return wave.sum(axis=-1), slope.sum(axis=-1), (-(w**2) * wave).sum(axis=-1)


def robot_regressors(model, n, seed, chunk=5000):
    """Yield blocks (n_block, nv, 11 nv): rigid bodies and viscous friction."""
    from sklearn_vbjfa.model import TreeRegressor

    regressor = TreeRegressor(model)
    for rows in np.array_split(np.arange(n), max(n // chunk, 1)):
        q, v, a = (x[rows] for x in robot_motion(model, n, seed))
        Phi = regressor(q, v, a).reshape(rows.size, model.nv, -1)
        friction = v[:, :, None] * np.eye(model.nv)
        yield np.concatenate([Phi, friction], axis=2)


def least_squares_of_factor(factor):
    """Minimum-norm solution in columns of unit length, from the factor of [X y]."""
    R, z = factor[:, :-1], factor[:, -1]
    length = np.linalg.norm(R, axis=0)
    length = np.where(length > 0, length, 1.0)
    cond = R.shape[1] * 8 * np.finfo(float).eps
    return linalg.lstsq(R / length, z, cond=cond)[0] / length


def robot_errors(noise, n, seed=0):
    """Relative errors of new torques: scatter, QR; their difference; rank and size."""
    from _paper_robots import load_paper_robot

    from sklearn_vbjfa.model import nominal_parameters
    from sklearn_vbjfa.robot import joint_moments
    from sklearn_vbjfa.robot._estimate import least_squares

    model = load_paper_robot("arm")
    theta = np.append(np.ravel(nominal_parameters(model)), np.full(model.nv, 0.5))
    rng = np.random.default_rng(seed)
    stats, factor, weight = None, np.zeros((0, theta.size + 1)), None
    for Phi in robot_regressors(model, n, seed):
        tau = Phi @ theta
        if weight is None:
            scale = noise * tau.std(axis=0)
            weight = 1.0 / tau.std(axis=0) ** 2
        tau = tau + scale * rng.normal(size=tau.shape)
        block = joint_moments(Phi, tau, np.ones(tau.shape))
        stats = block if stats is None else stats + block
        rows = np.concatenate([Phi, tau[:, :, None]], axis=2) * np.sqrt(weight)[:, None]
        factor = _moments.triangular(factor, rows.reshape(-1, theta.size + 1))
    total = stats.total(weight)
    by_scatter = least_squares(total.S_xx, total.S_xy)
    by_factor = least_squares_of_factor(factor)
    squares = np.zeros(4)
    for Phi in robot_regressors(model, 5000, seed + 1):
        root = np.sqrt(weight)
        true, *found = (Phi @ x * root for x in (theta, by_scatter, by_factor))
        squares += [
            np.sum(true**2),
            *(np.sum((x - true) ** 2) for x in found),
            np.sum((found[0] - found[1]) ** 2),
        ]
    errors = np.sqrt(squares[1:] / squares[0])
    return (*errors, noise * np.sqrt(theta.size / (n * model.nv)))


def robot_table(n=50_000, noises=NOISES):
    """Torque errors of the robot path, from scatter matrices and from rows."""
    rows = [
        [f"{noise:.0e}", *(f"{value:.1e}" for value in robot_errors(noise, n))]
        for noise in noises
    ]
    headers = ["noise", "scatter", "QR of the rows", "difference"]
    return rst_table(rows, [*headers, "standard error on the rows of the fit"])


def report(sizes, noises=NOISES, conditions=CONDITIONS, robot_samples=50_000):
    """Tables for all sizes, and for a robot."""
    text = [
        "Relative errors of predictions on the rows of the fit against the projection "
        f"of y; {N_FEATURES} inputs, y with the same variance along each of their "
        "singular directions. Scatter alone and this package are "
        '``VBJFARegressor(latent="correlated", input_noise=0.0)``, the first without '
        "the second pass. Noise as a share of the deviation of y; standard error: what "
        "the noise alone does to least squares. LinearRegression drops directions "
        "below its default tolerance of 1e-6.",
    ]
    for n in sizes:
        text += [rst_title(f"{n:,} samples", "~"), table(n, noises, conditions)[0]]
    text += [
        rst_title("Robots", "~"),
        "Torques of a new motion of the ten-jointed arm, 110 parameters of which the "
        f"motion tells some combinations only; {robot_samples:,} samples, "
        f"{10 * robot_samples:,} rows, joints weighted by their torque. Scatter: the "
        "sums of ``JointTorqueRegressor``. Errors relative to the torque.",
        robot_table(robot_samples, noises),
    ]
    return "\n\n".join(text)


def main():
    """Run the comparison from the command line."""
    arguments = parser(__doc__)
    arguments.add_argument(
        "--large", action="store_true", help="a million samples too (minutes)"
    )
    arguments = arguments.parse_args()
    sizes = (100, 10_000, 1_000_000) if arguments.large else (100, 10_000)
    publish("conditioning", report(sizes), write=arguments.write)


if __name__ == "__main__":
    main()
