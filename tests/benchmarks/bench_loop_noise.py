"""Noise of an encoder in the loop and in the log: what second moments make of it.

Run ``python tests/benchmarks/bench_loop_noise.py [--write]``.

One joint with armature .02 kg m^2 and damping .3 N m s/rad follows three sines under a
PD law (20 N m/rad, 1 N m s/rad) at 1 kHz for 400 s. Its encoder has white noise, which
the drive sees ("loop") or only the log ("log"). The log has positions at 200 Hz;
torques are the law of these, regressors their slopes, all behind a zero-phase low-pass.
Noise covariances are those of the very noise that was drawn: what is left is not their
estimate's error. Nothing is of the package: moments and least squares in plain NumPy.
"""

import numpy as np
from _report import fixed, parser, publish, rst_table
from scipy import signal

M, F, KP, KD = 0.02, 0.3, 20.0, 1.0
TICK, LOG, STEPS, SUBSTEPS = 1e-3, 5, 400_000, 4
SINES = ((0.3, 0.7, 0.0), (0.2, 1.9, 1.0), (0.1, 3.7, 2.0))
SEEN_BEHIND = 40.0  # of the drive's speed [Hz]


def simulate(deviation, in_loop, rng):
    """Command, position and noise at the log's rate, (n,) each."""
    t = TICK * np.arange(STEPS)
    aim = sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in SINES)
    e = deviation * rng.standard_normal(STEPS)
    keep = np.exp(-2 * np.pi * SEEN_BEHIND * TICK)
    rate = signal.lfilter([1 - keep], [1, -keep], np.diff(e, prepend=e[0]) / TICK)
    seen = KP * e + KD * rate if in_loop else np.zeros(STEPS)
    q, v, found = 0.0, 0.0, np.empty(STEPS)
    for k in range(STEPS):
        found[k] = q
        tau = KP * (aim[k] - q) - KD * v - seen[k]
        for _ in range(SUBSTEPS):
            v += TICK / SUBSTEPS * (tau - F * v) / M
            q += TICK / SUBSTEPS * v
    return aim[::LOG], found[::LOG], e[::LOG]


def errors(aim, q, e, cutoff):
    """Relative errors (3, 2) of armature and damping: plain, - Psi, - psi_xy too."""
    dt = LOG * TICK
    sos = signal.butter(4, cutoff, fs=1 / dt, output="sos")

    def columns(x):
        v = np.gradient(signal.sosfiltfilt(sos, x), dt)
        return np.column_stack([np.gradient(v, dt), v])[2 * LOG * 40 : -2 * LOG * 40]

    def law(aim, x):
        torque = KP * (aim - x) - KD * np.gradient(x, dt)
        return signal.sosfiltfilt(sos, torque)[2 * LOG * 40 : -2 * LOG * 40]

    X, y, N, w = columns(q + e), law(aim, q + e), columns(e), law(0.0, e)
    S, s, P, p = X.T @ X, X.T @ y, N.T @ N, N.T @ w
    found = [np.linalg.solve(*pair) for pair in ((S, s), (S - P, s), (S - P, s - p))]
    return np.array(found) / [M, F] - 1


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0]).parse_args(argv)
    rng, rows = np.random.default_rng(0), []
    for deviation in (1e-3, 3e-3):
        for place in ("log", "loop"):
            case = simulate(deviation, place == "loop", rng)
            for cutoff in (10.0, 20.0, 40.0):
                found = 100 * errors(*case, cutoff)
                cells = fixed(found.T.ravel(), 1)
                rows.append([f"{1e3 * deviation:g}", place, f"{cutoff:g}", *cells])
    heads = ["noise [mrad]", "in", "low-pass [Hz]"]
    for name in ("armature", "damping"):
        heads += [f"{name}, {way} [%]" for way in ("plain", "Ψ", "Ψ and ψ")]
    publish("loop_noise", rst_table(rows, heads, n_labels=3), write=arguments.write)


if __name__ == "__main__":
    main()
