"""Output-error identification."""

# A recording is divided into windows. In each, the robot is simulated from the measured
# state of its first row, driven by the measured torques. The errors of a window are
# integrals of one another: it counts as one observation of each joint. With the mean
# square e_j of the errors of joint j over all rows of W windows, minus twice the log
# likelihood is
#
#     J(theta, z) = W sum_j log(e_j(theta, z) + epsilon_j^2) + sum_w z_w' z_w,
#
# where epsilon_j is the noise of the encoder, and z_w what the start of a window is
# moved by, in units of its measurement noise. Starts are eliminated in every step of
# Gauss and Newton: each belongs to one window alone.

import warnings
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from sklearn_vbjfa._core._linear_systems import scaled_eigen
from sklearn_vbjfa.effects import InModel, OfChannel
from sklearn_vbjfa.equations._equations import regressor_rows
from sklearn_vbjfa.fit._estimate import project
from sklearn_vbjfa.recording import take_rows
from sklearn_vbjfa.robot._posterior import of_effects
from sklearn_vbjfa.robot._windows import warn_once
from sklearn_vbjfa.simulation import SimulationError, simulate

# Steps end when the mean squared error falls by less than this share.
TOLERANCE = 1e-4
_MOST_STEPS = 30
# Damping in units of the largest information of the simulation over the torque fit's.
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-3, 1e-8, 1e6
# Errors below this share of a joint's range are rounding.
_ROUNDING = 1e-9
# Memory of the sensitivities that are held together.
_BYTES = 128 << 20
# Degrees of freedom of Student's t that are taken at least, see `deviations`.
_LEAST_FREEDOM = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulationCriteria:
    """Errors of an identified robot before and after its refinement by simulation."""

    # (nv,): root mean square of simulated minus measured positions [rad or m], from the
    # measured states, and at last from the estimated ones
    position_before: np.ndarray
    position_after: np.ndarray
    n_windows: int
    window: float  # their length [s]
    converged: bool  # whether the steps ended at the tolerance


@dataclass(frozen=True, kw_only=True, eq=False)
class Windows:
    """Windows of a recording, W of L rows."""

    recording: object  # their rows, one segment each, with clock, torques and signals
    measured: np.ndarray  # (W, L, nv): positions [rad or m]
    # (W, L, nv): weights of positions, with the sum 1 in each window of a joint that
    # has any
    weight: np.ndarray
    start: np.ndarray  # (W, 2 * nv): measured state of each first row
    noise: np.ndarray  # (2 * nv,): standard deviations of its noise

    @property
    def count(self):
        return self.measured.shape[0]

    @property
    def observations(self):
        """Number of windows in which each joint has positions, (nv,)."""
        return (self.weight > 0).any(axis=1).sum(axis=0)

    @classmethod
    def of(cls, predictor, recording, states, rows):
        # states: `RecordingStates`. What remains of a recording is left out, half of it
        # at each end; recordings shorter than a window are left out.
        nv = predictor.features_.n_joints_
        picked, start = [], []
        for part, own in zip(recording.segments, states.full):
            n = part.stop - part.start
            first = (n % rows) // 2
            for at in range(first, n - rows + 1, rows):
                picked.append(slice(part.start + at, part.start + at + rows))
                start.append(own[slice(at, at + 1)].reshape(-1)[: 2 * nv])
        # Weights alone tell which positions count.
        t = predictor.plan.clock(recording)
        plain = replace(recording, t=t, weight=None, command=None, feedback=None)
        chosen = _windows_of(plain, picked)
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
    """Make a recording of windows, slices, each without what was before."""
    return replace(take_rows(recording, rows, range(len(rows))), before=())


def _start_noise(estimator, nv):
    """Deviations (2 nv,) of the noise of smoothed states."""
    # Zero for states that were given, and where the noise is not known.
    if estimator is None:
        return np.zeros(2 * nv)
    variance = estimator.noise_variance_
    encoder = np.sqrt(np.where(np.isnan(variance), 0.0, variance))
    return np.concatenate([encoder, estimator.velocity_noise()])


# -- simulation and criterion ----------------------------------------------------------


def run_windows(predictor, windows, starts):
    """Simulate windows from starts (W, 2 nv); states (W, L, 3 nv)."""
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
    """Simulated windows of some parameters and starts."""

    predictor: object  # robot with its parameters
    z: np.ndarray  # (W, 2 * nv): what starts are moved by, in units of their noise
    states: np.ndarray  # (W, L, 3 * nv): simulated
    errors: np.ndarray  # (W, L, nv): simulated minus measured positions

    @classmethod
    def of(cls, predictor, windows, z):
        states = run_windows(predictor, windows, windows.start + z * windows.noise)
        errors = states[:, :, : windows.measured.shape[2]] - windows.measured
        return cls(predictor=predictor, z=z, states=states, errors=errors)

    def position_errors(self, windows):
        """Root mean square of the errors of each joint, (nv,)."""
        squares = (windows.weight * self.errors**2).sum(axis=(0, 1))
        return np.sqrt(squares / np.maximum(windows.observations, 1))

    def scale(self, windows):
        """Units of the errors (nv,): their present size, with the encoders' noise."""
        nv = self.errors.shape[2]
        span = np.ptp(windows.measured, axis=(0, 1))
        least = np.maximum(windows.noise[:nv], _ROUNDING * np.where(span > 0, span, 1))
        return np.hypot(self.position_errors(windows), least)

    def criterion(self, windows):
        size = 2.0 * np.log(self.scale(windows))
        return float(windows.observations @ size + (self.z**2).sum())


@dataclass(frozen=True, kw_only=True, eq=False)
class Normal:
    """Normal equations of each window, half the derivatives of the criterion."""

    H: np.ndarray  # (p, p): Gauss-Newton matrix of the parameters, starts eliminated
    g: np.ndarray  # (W, p): gradients of the windows, starts eliminated
    cross: np.ndarray  # (W, 2 * nv, p): changes of z by parameters
    step: np.ndarray  # (W, 2 * nv): changes of z for the present parameters

    @classmethod
    def of(cls, fit, windows):
        scale = fit.scale(windows)
        W, L, nv = windows.measured.shape
        p = fit.predictor.theta_.size
        H, g = np.zeros((p, p)), np.empty((W, p))
        cross, step = np.empty((W, 2 * nv, p)), np.empty((W, 2 * nv))
        per_window = 8 * L * nv * (4 * p + 8 * nv)
        size = max(1, int(_BYTES // per_window))
        for begin in range(0, W, size):
            chosen = slice(begin, min(begin + size, W))
            states = fit.states[chosen]
            found = slopes(
                fit.predictor, windows.part(chosen), states.reshape(-1, 3 * nv)
            )
            S = propagate(found, states, windows.recording.dt)
            S[..., p:] *= windows.noise
            root = (np.sqrt(windows.weight[chosen]) / scale).transpose(1, 0, 2)
            S *= root[..., None]
            e = root * fit.errors[chosen].transpose(1, 0, 2)
            for k, w in enumerate(range(chosen.start, chosen.stop)):
                own = S[:, k].reshape(L * nv, -1)
                full, slope = own.T @ own, own.T @ e[:, k].ravel()
                inner = full[p:, p:] + np.eye(2 * nv)
                slope[p:] += fit.z[w]
                cross[w] = -np.linalg.solve(inner, full[p:, :p])
                step[w] = -np.linalg.solve(inner, slope[p:])
                H += full[:p, :p] + full[:p, p:] @ cross[w]
                g[w] = slope[:p] + full[:p, p:] @ step[w]
        return cls(H=0.5 * (H + H.T), g=g, cross=cross, step=step)


# -- refinement ------------------------------------------------------------------------


def refine(predictor, found, recording, states, window, projector):
    # Steps of Gauss and Newton, damped after Levenberg and Marquardt in the metric of
    # the torque fit, each projected, and taken only where the criterion falls. found:
    # `Estimate` of the torque fit, predictor: its `IdentifiedRobot`. Returns an
    # `Estimate` and `SimulationCriteria`.
    rows = round(float(window) / recording.dt) + 1
    longest = max(part.stop - part.start for part in recording.segments)
    if rows > longest:
        raise ValueError(
            f"window={window:g} s is longer than the longest recording "
            f"({(longest - 1) * recording.dt:.6g} s)."
        )
    windows = Windows.of(predictor, recording, states, rows)
    with warnings.catch_warnings(record=True) as caught:
        # Every window of every step says what the simulation goes without: once will
        # do.
        warnings.simplefilter("always")
        refined = _refine(predictor, found, windows, projector)
    warn_once(caught, "simulations", stacklevel=5)
    return refined


def _refine(predictor, found, windows, projector):
    nv = predictor.features_.n_joints_
    fit = SimulatedFit.of(predictor, windows, np.zeros((windows.count, 2 * nv)))
    before = fit.position_errors(windows)
    value, count = fit.criterion(windows), windows.observations.sum()
    held = held_parameters(predictor)
    metric = np.where(np.outer(~held, ~held), found.metric, 0.0)
    normal = Normal.of(fit, windows)
    root = scaled_eigen(metric).inverse_root()
    sizes = linalg.eigvalsh(root.T @ normal.H @ root) if root.size else [0.0]
    largest = float(sizes[-1])
    damping, unconstrained = _FIRST_DAMPING, found.theta_unconstrained
    converged = False
    for _ in range(_MOST_STEPS):
        if not largest > 0 or damping > _MOST_DAMPING:
            converged = True
            break
        own = normal.H + damping * largest * metric
        raw, theta = _step(fit.predictor, found, normal, own, held, projector)
        trial = _try(fit, normal, theta, windows)
        after = np.inf if trial is None else trial.criterion(windows)
        if not after < value:
            damping *= 10.0
            continue
        fell = value - after
        fit, value, unconstrained = trial, after, raw
        damping = max(0.1 * damping, _LEAST_DAMPING)
        normal = Normal.of(fit, windows)
        if fell < TOLERANCE * count:
            converged = True
            break
    criteria = SimulationCriteria(
        position_before=before,
        position_after=fit.position_errors(windows),
        n_windows=windows.count,
        window=(windows.measured.shape[1] - 1) * windows.recording.dt,
        converged=converged,
    )
    std = deviations(normal, metric, _LEAST_DAMPING * largest, found.std)
    refined = {"theta": fit.predictor.theta_, "theta_unconstrained": unconstrained}
    std = np.where(held, found.std, std)
    return replace(found, **refined, std=std), criteria


def _step(predictor, found, normal, own, held, projector):
    change = scaled_eigen(own).solve(-normal.g.sum(axis=0))
    change[held] = 0.0
    raw = predictor.theta_ + change
    asked = replace(found, theta=raw, theta_unconstrained=raw, metric=own)
    theta = project(asked, projector, predictor.features_, predictor.effects_).theta
    return raw, np.where(held, predictor.theta_, theta)


def _try(fit, normal, theta, windows):
    """Simulate with other parameters, starts following; None where it fails."""
    change = theta - fit.predictor.theta_
    z = fit.z + normal.step + normal.cross @ change
    try:
        return SimulatedFit.of(replace(fit.predictor, theta_=theta), windows, z)
    except (SimulationError, ValueError):
        # Diverging motion, or a robot without positive inertia.
        return None


def deviations(normal, metric, damping, before):
    """Find the standard deviations (p,) of refined parameters."""
    # With H the Gauss-Newton matrix, G the metric of the torque fit and a small damping
    # mu, the covariance is
    #     A^-1 (W / (nu - 2) sum_w g_w g_w') A^-1 + T C T',
    #     A = H + mu G,  T = 1 - A^-1 H,  nu = max(W - r, 3),
    # the sandwich of the gradients of the windows; what the simulation does not
    # determine keeps the covariance C of the torque fit. r = tr(A^-1 H) counts the
    # directions that it determines. Student's t of W - r degrees of freedom has the
    # variance (W - r) / (W - r - 2); three degrees are more than enough
    # (tests/robot/test_output_error.py).
    W = normal.g.shape[0]
    A = scaled_eigen(normal.H + damping * metric)
    inverse = A.inverse()
    shrunk = inverse @ normal.H
    rank = float(np.trace(shrunk))
    freedom = max(W - rank, _LEAST_FREEDOM)
    centred = normal.g - normal.g.mean(axis=0)
    meat = centred.T @ centred * W / (freedom - 2.0)
    own = inverse @ meat @ inverse
    plain = scaled_eigen(metric).inverse()
    size = np.sqrt(np.maximum(np.diagonal(plain), 0.0))
    wider = np.divide(before, size, out=np.ones_like(size), where=size > 0)
    wider = np.where(np.isfinite(wider), wider, 1.0)
    rest = np.eye(len(A.scale)) - shrunk
    kept = rest @ (plain * np.outer(wider, wider)) @ rest.T
    return np.sqrt(np.maximum(np.diagonal(own + kept), 0.0))


# Along a simulated motion the torques that the drives produce, tau(q, v, a, theta), do
# not change. A small change of parameters therefore moves it by s with
#
#     M d2s/dt2 + D ds/dt + K s = -Phi dtheta,
#     M = dtau/da,  D = dtau/dv,  K = dtau/dq,
#
# where Phi is the regressor, columns of friction and effects among them: integrated by
# the implicit midpoint rule, which is stable for friction and springs of any steepness.
# A joint that sticks has zero velocity. Where it turns round, dry friction jumps by c,
# an impulse c delta(v) of D with the mean c / (h abs(a)) over a step h.

# Differences are taken over this share of a joint's range, top speed and acceleration.
_SHARE = 1e-6


def slopes(predictor, recording, states):
    # states (n, 3 nv). Returns the derivatives of true torques by positions, velocities
    # and accelerations (3, n, nv, nv), their rise where the velocity of the joint
    # passes through zero (n, nv), and those by parameters Phi (n, nv, p).
    features, held = predictor.features_, held_parameters(predictor)

    def rows_of(states):
        return regressor_rows(
            recording,
            [states[part] for part in recording.segments],
            predictor.prediction_plan,
            features,
            theta=predictor.load_parameters,
        )

    Phi = np.concatenate([one(slice(None)) for one in rows_of(states)])
    Phi /= features.gains_[:, None]
    Phi[:, :, held] = 0.0
    held |= of_effects(predictor, lambda effect: isinstance(effect, OfChannel))
    theta = np.where(held, 0.0, predictor.theta_)

    def torque(column, values):
        other = states.copy()
        other[:, column] = values
        torques = [one.predict(theta)[0] for one in rows_of(other)]
        return np.concatenate(torques) / features.gains_

    n, nv = states.shape[0], features.n_joints_
    sizes = np.r_[np.ptp(states[:, :nv], axis=0), np.abs(states[:, nv:]).max(axis=0)]
    found, jump = np.empty((3, n, nv, nv)), np.zeros((n, nv))
    for column, step in enumerate(_SHARE * np.where(sizes > 0, sizes, 1.0)):
        kind, k = divmod(column, nv)
        here = states[:, column]
        rise = torque(column, here + step) - torque(column, here - step)
        found[kind, :, :, k] = rise / (2 * step)
        if kind == 1:
            # Across zero the difference is that of the jump, which is told apart.
            found[kind, np.abs(here) <= step, :, k] = 0.0
            both = np.full(n, step), np.full(n, -step)
            jump[:, k] = (torque(column, both[0]) - torque(column, both[1]))[:, k]
    return found, jump, Phi


def held_parameters(predictor):
    """Return which parameters (p,) a simulation does not depend on as columns."""
    # Values of effects in the model, and effects that a simulation leaves out.
    return of_effects(
        predictor, lambda e: isinstance(e, InModel) or bool(e.files.simulation)
    )


def propagate(found, states, dt):
    """Sensitivities of positions (L, W, nv, p + 2 nv) along W motions of L rows."""
    # By parameters, start positions and velocities. found: `slopes` along one motion
    # after the other (n = W L); states (W, L, 3 nv); dt [s].
    (stiffness, damping, mass), jump, Phi = found
    W, L = states.shape[:2]
    nv = states.shape[2] // 3
    p = Phi.shape[2]
    shape = (W, L, nv, -1)
    v, a = states[:, :, nv : 2 * nv], states[:, :, 2 * nv :]
    stuck = (v == 0) & (a == 0)
    free = ~stuck[..., None]

    def middle(values):
        values = values.reshape(shape)
        return 0.5 * (values[:, :-1] + values[:, 1:])

    def moved(values):
        # Friction of a joint that sticks balances every change.
        return middle(np.where(free, values.reshape(shape), 0.0))

    M, D, K = middle(mass), moved(damping), moved(stiffness)
    # One that turns round in a row moves the new way there.
    way = np.where(v != 0, np.sign(v), np.sign(a))
    turns = way[:, :-1] * way[:, 1:] < 0
    if turns.any():
        mean = 0.5 * np.abs(a[:, :-1] + a[:, 1:])
        jump = middle(jump[..., None])[..., 0]
        own = np.einsum("wljj->wlj", M)
        # Its friction cannot send a joint back the way that it came.
        most = 2.0 * own / dt
        slope = np.divide(jump, dt * mean, out=most.copy(), where=dt * mean > 0)
        impulse = np.where(turns, np.clip(slope, 0.0, most), 0.0)
        D = D + impulse[..., None] * np.eye(nv)
    half = 0.5 * dt * D + 0.25 * dt**2 * K
    left, right = M + half, M - half
    ends = np.broadcast_to(stuck[:, 1:, :, None], left.shape)
    left = np.where(ends, np.eye(nv), left)
    drive = np.concatenate(
        [np.where(ends, 0.0, right), np.where(ends, 0.0, -dt * K)], axis=-1
    )
    push = np.where(stuck[:, 1:, :, None], 0.0, -dt * moved(Phi))
    drive, push = np.linalg.solve(left, drive), np.linalg.solve(left, push)
    out = np.zeros((L, W, nv, p + 2 * nv))
    position, velocity = np.zeros((2, W, nv, p + 2 * nv))
    position[:, :, p : p + nv] = np.eye(nv)
    velocity[:, :, p + nv :] = np.eye(nv) * ~stuck[:, 0, :, None]
    out[0] = position
    for k in range(L - 1):
        both = np.concatenate([velocity, position], axis=1)
        after = drive[:, k] @ both
        after[:, :, :p] += push[:, k]
        position = position + 0.5 * dt * (velocity + after)
        velocity = after
        out[k + 1] = position
    return out
