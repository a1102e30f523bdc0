"""Output-error identification."""

# A recording is divided into windows. In each, the robot is simulated from the measured
# state of its first row, driven by the measured torques. The errors within a window are
# highly correlated: it counts as one observation of each joint. With the mean square
# e_j of the errors of joint j over all rows of W windows, the criterion, minus twice
# the log likelihood, is
#
#     J(theta, z) = W sum_j log(e_j(theta, z) + epsilon_j^2) + sum_w z_w' z_w,
#
# where epsilon_j is the encoder noise, and z_w the correction of the initial state of a
# window, in units of its measurement noise. Initial states affect one window each, so
# every Gauss-Newton step eliminates them.

import warnings
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core._linear_systems import scaled_eigen
from sklearn_vbjfa.effects import InModel, OfChannel
from sklearn_vbjfa.fit._estimate import project
from sklearn_vbjfa.recording import take_rows
from sklearn_vbjfa.robot._posterior import effect_mask
from sklearn_vbjfa.robot._windows import warn_once
from sklearn_vbjfa.simulation import SimulationError, simulate

# Relative decrease of the mean squared error at convergence.
TOLERANCE = 1e-4
_MAX_STEPS = 30
# Damping relative to the largest eigenvalue of H in the metric of the torque fit.
_FIRST_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-3, 1e-8, 1e6
# Errors below this share of a joint's range are rounding errors.
_ROUNDING = 1e-9
# Maximum memory of sensitivities that are computed together.
_MAX_BYTES = 128 << 20
# Minimum degrees of freedom of Student's t, see `deviations`.
_MIN_FREEDOM = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulationCriteria:
    """Errors of an identified robot before and after its refinement by simulation."""

    # (nv,): RMS of simulated minus measured positions [rad or m], from measured initial
    # states before the refinement and from estimated ones after it
    position_before: np.ndarray
    position_after: np.ndarray
    n_windows: int
    window: float  # their length [s]
    converged: bool  # whether the tolerance was reached


@dataclass(frozen=True, kw_only=True, eq=False)
class Windows:
    """Windows of a recording, W of L rows."""

    recording: object  # one segment per window, with clock, torques and signals
    measured: np.ndarray  # (W, L, nv): positions [rad or m]
    # (W, L, nv): weights of positions; sum 1 for each joint and window with positions
    weight: np.ndarray
    start: np.ndarray  # (W, 2 * nv): measured initial states
    noise: np.ndarray  # (2 * nv,): standard deviations of their noise

    @property
    def count(self):
        return self.measured.shape[0]

    @property
    def observations(self):
        """Number of windows in which each joint has positions, (nv,)."""
        return (self.weight > 0).any(axis=1).sum(axis=0)

    @classmethod
    def of(cls, predictor, recording, states, rows):
        # states: `RecordingStates`. The remainder of a recording is left out, half at
        # each end, as are recordings shorter than a window.
        nv = predictor.features_.n_joints_
        picked, start = [], []
        for part, states_of_part in zip(recording.segments, states.full):
            n = part.stop - part.start
            offset = (n % rows) // 2
            for at in range(offset, n - rows + 1, rows):
                picked.append(slice(part.start + at, part.start + at + rows))
                start.append(states_of_part[slice(at, at + 1)].reshape(-1)[: 2 * nv])
        # Only `weight` selects positions; simulation ignores it.
        t = predictor.plan.clock(recording)
        unweighted = replace(recording, t=t, weight=None, command=None, feedback=None)
        chosen = _windows_of(unweighted, picked)
        weight = np.ones(chosen.tau.shape)
        if recording.weight is not None:
            weight = take_rows(recording, picked, range(len(picked))).weight
            weight = (weight > 0).astype(float)
        weight = weight.reshape(-1, rows, nv)
        total = weight.sum(axis=1, keepdims=True)
        return cls(
            recording=chosen,
            measured=chosen.q.reshape(-1, rows, nv),
            weight=np.divide(weight, total, out=np.zeros_like(weight), where=total > 0),
            start=np.array(start),
            noise=_start_noise(predictor.plan.state_estimator, nv),
        )

    def part(self, chosen):
        return _windows_of(self.recording, self.recording.segments[chosen])


def _windows_of(recording, rows):
    """Return a recording of windows (slices) without history."""
    return replace(take_rows(recording, rows, range(len(rows))), before=())


def _start_noise(estimator, nv):
    """Return the standard deviations (2 nv,) of the noise of smoothed states."""
    # Zero for given states, or if the noise is unknown.
    if estimator is None:
        return np.zeros(2 * nv)
    variance = estimator.noise_variance_
    encoder = np.sqrt(np.where(np.isnan(variance), 0.0, variance))
    return np.concatenate([encoder, estimator.noise(1)])


# -- simulation and criterion ----------------------------------------------------------


def run_windows(predictor, windows, starts):
    """Simulate windows from initial states (W, 2 nv); return states (W, L, 3 nv)."""
    robot = predictor.torque_model()
    nv = robot.n_joints
    recording, L = windows.recording, windows.measured.shape[1]
    clock = predictor.plan.clock(recording)
    out = np.empty((windows.count, L, 3 * nv))
    for w, start in enumerate(starts):
        rows = slice(w * L, (w + 1) * L)
        out[w] = simulate(
            robot,
            recording.tau[rows],
            start[:nv],
            start[nv:],
            clock[rows] if predictor.plan.timed else None,
            signals={name: x[rows] for name, x in recording.signals.items()},
        )
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedFit:
    """Windows simulated with some parameters and initial states."""

    predictor: object  # robot with its parameters
    z: np.ndarray  # (W, 2 * nv): corrections of initial states in units of their noise
    states: np.ndarray  # (W, L, 3 * nv): simulated
    errors: np.ndarray  # (W, L, nv): simulated minus measured positions

    @classmethod
    def of(cls, predictor, windows, z):
        states = run_windows(predictor, windows, windows.start + z * windows.noise)
        errors = states[:, :, : windows.measured.shape[2]] - windows.measured
        return cls(predictor=predictor, z=z, states=states, errors=errors)

    def position_errors(self, windows):
        """Return the RMS error of each joint, (nv,)."""
        squares = (windows.weight * self.errors**2).sum(axis=(0, 1))
        return np.sqrt(squares / np.maximum(windows.observations, 1))

    def scale(self, windows):
        """Return the scale (nv,) of the errors: their RMS and the encoder noise."""
        nv = self.errors.shape[2]
        span = np.ptp(windows.measured, axis=(0, 1))
        floor = np.maximum(windows.noise[:nv], _ROUNDING * np.where(span > 0, span, 1))
        return np.hypot(self.position_errors(windows), floor)

    def criterion(self, windows):
        size = 2.0 * np.log(self.scale(windows))
        return float(windows.observations @ size + (self.z**2).sum())


@dataclass(frozen=True, kw_only=True, eq=False)
class Normal:
    """Normal equations of each window, half the derivatives of the criterion."""

    H: np.ndarray  # (p, p): Gauss-Newton matrix, initial states eliminated
    g: np.ndarray  # (W, p): gradients of the windows, initial states eliminated
    cross: np.ndarray  # (W, 2 * nv, p): derivatives of z by parameters
    step: np.ndarray  # (W, 2 * nv): change of z at the present parameters

    @classmethod
    def of(cls, fit, windows):
        scale = fit.scale(windows)
        W, L, nv = windows.measured.shape
        p = fit.predictor.theta_.size
        H, g = np.zeros((p, p)), np.empty((W, p))
        cross, step = np.empty((W, 2 * nv, p)), np.empty((W, 2 * nv))
        per_window = 8 * L * nv * (4 * p + 8 * nv)
        size = max(1, int(_MAX_BYTES // per_window))
        for begin in range(0, W, size):
            chosen = slice(begin, min(begin + size, W))
            states = fit.states[chosen]
            derivatives = slopes(
                fit.predictor, windows.part(chosen), states.reshape(-1, 3 * nv)
            )
            S = propagate(derivatives, states, windows.recording.dt)
            S[..., p:] *= windows.noise
            root = (np.sqrt(windows.weight[chosen]) / scale).transpose(1, 0, 2)
            S *= root[..., None]
            e = root * fit.errors[chosen].transpose(1, 0, 2)
            for k, w in enumerate(range(chosen.start, chosen.stop)):
                J = S[:, k].reshape(L * nv, -1)
                full, slope = J.T @ J, J.T @ e[:, k].ravel()
                inner = full[p:, p:] + np.eye(2 * nv)
                slope[p:] += fit.z[w]
                cross[w] = -np.linalg.solve(inner, full[p:, :p])
                step[w] = -np.linalg.solve(inner, slope[p:])
                H += full[:p, :p] + full[:p, p:] @ cross[w]
                g[w] = slope[:p] + full[:p, p:] @ step[w]
        return cls(H=0.5 * (H + H.T), g=g, cross=cross, step=step)


# -- refinement ------------------------------------------------------------------------


def refine(predictor, result, recording, states, window, projector):
    # Levenberg-Marquardt steps, damped in the metric of the torque fit, projected, and
    # accepted if the criterion decreases. result: `Estimate` of the torque fit,
    # predictor: its `IdentifiedRobot`. Returns an `Estimate` and `SimulationCriteria`.
    rows = round(float(window) / recording.dt) + 1
    longest = max(part.stop - part.start for part in recording.segments)
    if rows > longest:
        raise ValueError(
            f"window={window:g} s is longer than the longest recording "
            f"({(longest - 1) * recording.dt:.6g} s)."
        )
    windows = Windows.of(predictor, recording, states, rows)
    with warnings.catch_warnings(record=True) as caught:
        # Each simulation warns about what it omits; `warn_once` removes repetitions.
        warnings.simplefilter("always")
        refined = _refine(predictor, result, windows, projector)
    warn_once(caught, "simulations", stacklevel=5)
    return refined


def _refine(predictor, result, windows, projector):
    nv = predictor.features_.n_joints_
    fit = SimulatedFit.of(predictor, windows, np.zeros((windows.count, 2 * nv)))
    before = fit.position_errors(windows)
    value, count = fit.criterion(windows), windows.observations.sum()
    fixed = fixed_parameters(predictor)
    metric = np.where(np.outer(~fixed, ~fixed), result.metric, 0.0)
    normal = Normal.of(fit, windows)
    root = scaled_eigen(metric).inverse_root()
    eigenvalues = linalg.eigvalsh(root.T @ normal.H @ root) if root.size else [0.0]
    largest = float(eigenvalues[-1])
    damping, unconstrained = _FIRST_DAMPING, result.theta_unconstrained
    converged = False
    for _ in range(_MAX_STEPS):
        if not largest > 0 or damping > _MAX_DAMPING:
            converged = True
            break
        H = normal.H + damping * largest * metric
        raw, theta = _step(fit.predictor, result, normal, H, fixed, projector)
        trial = _simulate_trial(fit, normal, theta, windows)
        trial_value = np.inf if trial is None else trial.criterion(windows)
        if not trial_value < value:
            damping *= 10.0
            continue
        decrease = value - trial_value
        fit, value, unconstrained = trial, trial_value, raw
        damping = max(0.1 * damping, _MIN_DAMPING)
        normal = Normal.of(fit, windows)
        if decrease < TOLERANCE * count:
            converged = True
            break
    criteria = SimulationCriteria(
        position_before=before,
        position_after=fit.position_errors(windows),
        n_windows=windows.count,
        window=(windows.measured.shape[1] - 1) * windows.recording.dt,
        converged=converged,
    )
    std = deviations(normal, metric, _MIN_DAMPING * largest, result.std)
    refined = {"theta": fit.predictor.theta_, "theta_unconstrained": unconstrained}
    std = np.where(fixed, result.std, std)
    return replace(result, **refined, std=std), criteria


def _step(predictor, result, normal, H, fixed, projector):
    change = scaled_eigen(H).solve(-normal.g.sum(axis=0))
    change[fixed] = 0.0
    raw = predictor.theta_ + change
    trial = replace(result, theta=raw, theta_unconstrained=raw, metric=H)
    theta = project(trial, projector, predictor.features_, predictor.effects_).theta
    return raw, np.where(fixed, predictor.theta_, theta)


def _simulate_trial(fit, normal, theta, windows):
    """Simulate with other parameters and updated initial states; None on failure."""
    change = theta - fit.predictor.theta_
    z = fit.z + normal.step + normal.cross @ change
    try:
        return SimulatedFit.of(replace(fit.predictor, theta_=theta), windows, z)
    except (SimulationError, ValueError):
        # Diverging motion, or a robot without positive inertia.
        return None


def deviations(normal, metric, damping, torque_std):
    """Return the standard deviations (p,) of refined parameters."""
    # With the Gauss-Newton matrix H, the metric G of the torque fit and a damping mu:
    #     A^-1 (W / (nu - 2) sum_w g_w g_w') A^-1 + T C T',
    #     A = H + mu G,  T = 1 - A^-1 H,  nu = max(W - r, 3),
    # a sandwich of the gradients of the windows; directions that simulation does not
    # determine keep the covariance C of the torque fit. r = tr(A^-1 H) is the effective
    # number of determined directions. Student's t with W - r degrees of freedom has the
    # variance (W - r) / (W - r - 2); a minimum of three is conservative
    # (tests/robot/test_output_error.py).
    W = normal.g.shape[0]
    A = scaled_eigen(normal.H + damping * metric)
    inverse = A.inverse()
    shrunk = inverse @ normal.H
    rank = float(np.trace(shrunk))
    freedom = max(W - rank, _MIN_FREEDOM)
    centred = normal.g - normal.g.mean(axis=0)
    meat = centred.T @ centred * W / (freedom - 2.0)
    sandwich = inverse @ meat @ inverse
    covariance = scaled_eigen(metric).inverse()
    std = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    inflation = np.divide(torque_std, std, out=np.ones_like(std), where=std > 0)
    inflation = np.where(np.isfinite(inflation), inflation, 1.0)
    T = np.eye(len(A.scale)) - shrunk
    retained = T @ (covariance * np.outer(inflation, inflation)) @ T.T
    return np.sqrt(np.maximum(np.diagonal(sandwich + retained), 0.0))


# The drive torques tau(q, v, a, theta) along a simulated motion are given. A small
# change of parameters therefore changes the motion by s with
#
#     M d2s/dt2 + D ds/dt + K s = -Phi dtheta,
#     M = dtau/da,  D = dtau/dv,  K = dtau/dq,
#
# where Phi is the regressor, including friction and effects. It is integrated by the
# implicit midpoint rule, which is stable for any stiffness and damping. A sticking
# joint has zero velocity. At a velocity reversal dry friction jumps by c: an impulse
# c delta(v) of D with the mean c / (h abs(a)) over a step h.

# Step of finite differences relative to range, maximum speed and acceleration.
_STEP_SHARE = 1e-6


def slopes(predictor, recording, states):
    # states (n, 3 nv). Returns the derivatives of true torques with respect to
    # positions, velocities and accelerations (3, n, nv, nv), their jump where the
    # velocity of the joint crosses zero (n, nv), and the regressor Phi (n, nv, p).
    features, fixed = predictor.features_, fixed_parameters(predictor)

    regressors = predictor.regressors(recording, states)
    Phi = np.concatenate([rows(slice(None)) for rows in regressors])
    Phi /= features.gains_[:, None]
    Phi[:, :, fixed] = 0.0
    fixed |= effect_mask(predictor, lambda effect: isinstance(effect, OfChannel))
    theta = np.where(fixed, 0.0, predictor.theta_)

    def torque(column, values):
        perturbed = states.copy()
        perturbed[:, column] = values
        rows = predictor.regressors(recording, perturbed)
        return np.concatenate([x.predict(theta)[0] for x in rows]) / features.gains_

    n, nv = states.shape[0], features.n_joints_
    sizes = np.r_[np.ptp(states[:, :nv], axis=0), np.abs(states[:, nv:]).max(axis=0)]
    derivatives, jump = np.empty((3, n, nv, nv)), np.zeros((n, nv))
    for column, step in enumerate(_STEP_SHARE * np.where(sizes > 0, sizes, 1.0)):
        kind, k = divmod(column, nv)
        nominal = states[:, column]
        rise = torque(column, nominal + step) - torque(column, nominal - step)
        derivatives[kind, :, :, k] = rise / (2 * step)
        if kind == 1:
            # Across zero velocity the difference is the jump, which is separate.
            derivatives[kind, np.abs(nominal) <= step, :, k] = 0.0
            sides = np.full(n, step), np.full(n, -step)
            jump[:, k] = (torque(column, sides[0]) - torque(column, sides[1]))[:, k]
    return derivatives, jump, Phi


def fixed_parameters(predictor):
    """Return the parameters (p,), bool, without sensitivities in a simulation."""
    # Values of effects in the model, and effects that a simulation omits.
    return effect_mask(
        predictor, lambda e: isinstance(e, InModel) or bool(e.files.simulation)
    )


def propagate(derivatives, states, dt):
    """Return sensitivities of positions (L, W, nv, p + 2 nv), W motions of L rows."""
    # With respect to parameters, initial positions and velocities. derivatives:
    # `slopes` along all motions in turn (n = W L); states (W, L, 3 nv); dt [s].
    (stiffness, damping, mass), jump, Phi = derivatives
    W, L = states.shape[:2]
    nv = states.shape[2] // 3
    p = Phi.shape[2]
    shape = (W, L, nv, -1)
    v, a = states[:, :, nv : 2 * nv], states[:, :, 2 * nv :]
    stuck = (v == 0) & (a == 0)
    free = ~stuck[..., None]

    def midpoint(values):
        values = values.reshape(shape)
        return 0.5 * (values[:, :-1] + values[:, 1:])

    def free_midpoint(values):
        # Friction of a sticking joint balances every change.
        return midpoint(np.where(free, values.reshape(shape), 0.0))

    M, D, K = midpoint(mass), free_midpoint(damping), free_midpoint(stiffness)
    # At a row of zero velocity, the new direction is that of the acceleration.
    direction = np.where(v != 0, np.sign(v), np.sign(a))
    turns = direction[:, :-1] * direction[:, 1:] < 0
    if turns.any():
        mean = 0.5 * np.abs(a[:, :-1] + a[:, 1:])
        jump = midpoint(jump[..., None])[..., 0]
        inertia = np.einsum("wljj->wlj", M)
        # Friction cannot reverse the motion of a joint.
        limit = 2.0 * inertia / dt
        slope = np.divide(jump, dt * mean, out=limit.copy(), where=dt * mean > 0)
        impulse = np.where(turns, np.clip(slope, 0.0, limit), 0.0)
        D = D + impulse[..., None] * np.eye(nv)
    half = 0.5 * dt * D + 0.25 * dt**2 * K
    left, right = M + half, M - half
    ends = np.broadcast_to(stuck[:, 1:, :, None], left.shape)
    left = np.where(ends, np.eye(nv), left)
    drive = np.concatenate(
        [np.where(ends, 0.0, right), np.where(ends, 0.0, -dt * K)], axis=-1
    )
    forcing = np.where(stuck[:, 1:, :, None], 0.0, -dt * free_midpoint(Phi))
    drive, forcing = np.linalg.solve(left, drive), np.linalg.solve(left, forcing)
    out = np.zeros((L, W, nv, p + 2 * nv))
    position, velocity = np.zeros((2, W, nv, p + 2 * nv))
    position[:, :, p : p + nv] = np.eye(nv)
    velocity[:, :, p + nv :] = np.eye(nv) * ~stuck[:, 0, :, None]
    out[0] = position
    for k in range(L - 1):
        state = np.concatenate([velocity, position], axis=1)
        new_velocity = drive[:, k] @ state
        new_velocity[:, :, :p] += forcing[:, k]
        position = position + 0.5 * dt * (velocity + new_velocity)
        velocity = new_velocity
        out[k + 1] = position
    return out
