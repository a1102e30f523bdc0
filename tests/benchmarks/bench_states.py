"""Accelerations from noisy positions: a few well-kept ways, and the one in use.

Run ``python tests/benchmarks/bench_states.py [--write]``. One joint, four sines up to
the stated frequency, 20 s; the root mean square error of the acceleration over its
standard deviation, mean of two seeds, one second left out at both ends. "auto"
methods see the noisy positions alone; for the others an oracle picks the cut-off or
window that is best against the truth.
"""

import itertools

import numpy as np
from _report import parser, publish, rst_table
from scipy import optimize, signal
from scipy.interpolate import make_smoothing_spline

from sklearn_vbjfa import StateEstimator

DURATION = 20.0


def motion(rate, frequency, noise, seed):
    """Return times, noisy positions and true accelerations."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, DURATION, 1.0 / rate)
    f = frequency * np.array([0.2, 0.45, 0.7, 1.0])
    phase = rng.uniform(0, 2 * np.pi, size=4)
    w = 2 * np.pi * f
    angle = np.outer(t, w) + phase
    q = np.sin(angle) @ (0.3 / f)
    a = -np.sin(angle) @ (0.3 / f * w**2)
    return t, q + noise * rng.normal(size=t.size), a


def penalised_spline(q, dt, _):
    """`StateEstimator` with its automatic cut-off."""
    return StateEstimator(dt).fit_transform(q[:, None])[:, 2]


def penalised_spline_oracle(q, dt, cutoff):
    """`StateEstimator` with a given cut-off."""
    return StateEstimator(dt, cutoff=cutoff).fit_transform(q[:, None])[:, 2]


def butterworth(q, dt, cutoff):
    """Zero-phase Butterworth of order 4, then central differences twice."""
    sos = signal.butter(4, cutoff, fs=1 / dt, output="sos")
    smooth = signal.sosfiltfilt(sos, q)
    return np.gradient(np.gradient(smooth, dt), dt)


def savitzky_golay(q, dt, cutoff):
    """Savitzky-Golay of degree 5; the window follows the cut-off."""
    window = max(7, int(2.0 / (cutoff * dt)) | 1)
    if window >= q.size:
        return np.full(q.size, np.nan)
    return signal.savgol_filter(q, window, 5, deriv=2, delta=dt)


def spectral(q, dt, cutoff):
    """Low-pass and derivatives in the Fourier domain, mirrored at the ends."""
    n = q.size
    line = np.linspace(q[0], q[-1], n)
    odd = np.r_[q - line, -(q - line)[::-1]]
    f = np.fft.rfftfreq(2 * n, dt)
    gain = 1 / (1 + (f / cutoff) ** 8)
    spectrum = np.fft.rfft(odd) * gain * -((2 * np.pi * f) ** 2)
    return np.fft.irfft(spectrum, 2 * n)[:n]


def cubic_gcv(q, dt, _):
    """Cubic smoothing spline, its penalty by generalised cross-validation (SciPy)."""
    t = np.arange(q.size) * dt
    return make_smoothing_spline(t, q).derivative(2)(t)


def rts_smoother(q, dt, _):
    """Kalman/RTS smoother of an integrated white jerk, noise by maximum likelihood."""
    F = np.array([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]])
    G = np.array([dt**3 / 6, dt**2 / 2, dt])
    shape = np.outer(G, G) / dt
    shape += np.diag([dt**5, dt**3, dt]) * np.array([1 / 720, 1 / 12, 0])

    def forward(log_ratio, keep=False):
        Q = np.exp(log_ratio) * shape
        x, P = np.array([q[0], 0.0, 0.0]), np.diag([1.0, 1e4, 1e8])
        stored, squares, logs = [], 0.0, 0.0
        for value in q:
            xp, Pp = F @ x, F @ P @ F.T + Q
            s = Pp[0, 0] + 1.0
            k = Pp[:, 0] / s
            e = value - xp[0]
            x, P = xp + k * e, Pp - np.outer(k, Pp[0])
            squares += e * e / s
            logs += np.log(s)
            if keep:
                stored.append((xp, Pp, x, P))
        return stored if keep else q.size * np.log(squares) + logs

    best = optimize.minimize_scalar(
        forward, bounds=(0.0, 40.0), method="bounded", options={"xatol": 0.3}
    )
    stored = forward(best.x, keep=True)
    out = np.empty(q.size)
    xs = stored[-1][2]
    out[-1] = xs[2]
    for i in range(q.size - 2, -1, -1):
        _, _, x, P = stored[i]
        xp, Pp = stored[i + 1][:2]
        xs = x + P @ F.T @ np.linalg.solve(Pp, xs - xp)
        out[i] = xs[2]
    return out


METHODS = {
    "penalised quintic spline, auto": (penalised_spline, False),
    "cubic smoothing spline, GCV": (cubic_gcv, False),
    "Kalman/RTS, ML": (rts_smoother, False),
    "penalised quintic spline, oracle": (penalised_spline_oracle, True),
    "Butterworth + differences, oracle": (butterworth, True),
    "Savitzky-Golay, oracle": (savitzky_golay, True),
    "spectral, oracle": (spectral, True),
}


def error_of(method, needs_oracle, t, q, a, frequency):
    """Error of one method on one recording; the best over cut-offs for an oracle."""
    dt = t[1] - t[0]
    inner = (t > 1.0) & (t < t[-1] - 1.0)
    top = 0.45 / dt
    tried = (
        [c for c in frequency * np.geomspace(1.2, 20, 12) if c < top]
        if needs_oracle
        else [None]
    )
    errors = [
        np.sqrt(np.mean((method(q, dt, c) - a)[inner] ** 2)) / a[inner].std()
        for c in tried
    ]
    return float(np.nanmin(errors))


def run(conditions, seeds=2):
    """Return a list of (condition, method -> median error)."""
    results = []
    for rate, frequency, noise in conditions:
        figures = {}
        for name, (method, needs_oracle) in METHODS.items():
            errors = [
                error_of(
                    method,
                    needs_oracle,
                    *motion(rate, frequency, noise, seed),
                    frequency,
                )
                for seed in range(seeds)
            ]
            figures[name] = float(np.median(errors))
        results.append(((rate, frequency, noise), figures))
    return results


def main():
    """Run the comparison from the command line."""
    arguments = parser(__doc__).parse_args()
    conditions = list(itertools.product((100.0,), (0.7, 4.0), (0.0, 1e-4, 1e-3, 3e-3)))
    conditions += list(itertools.product((500.0,), (0.7, 4.0), (1e-3,)))
    results = run(conditions)
    rows = [
        [f"{r:.0f}", f, f"{n:.0e}", *(f"{figures[m]:.2e}" for m in METHODS)]
        for (r, f, n), figures in results
    ]
    headers = ["rate [Hz]", "motion [Hz]", "noise [rad]", *METHODS]
    publish("states", rst_table(rows, headers, n_labels=3), write=arguments.write)


if __name__ == "__main__":
    main()
