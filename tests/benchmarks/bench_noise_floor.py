"""The noise floor against the truth, and against residuals of measured robots.

Run ``python tests/benchmarks/bench_noise_floor.py --data-home DIR [--write]``. Fits,
splits, filters and masks are those of ``bench_measured_robots.py``, the estimator is
`RobotIdentifier` with its defaults.

Simulated robots have torque noise of known colour; the truth is the deviation of that
noise behind the low-pass of the fit. Seeds 0 to 99 are for work, 100 and above to
confirm.
"""

import sys
import time
import warnings
from dataclasses import replace

import numpy as np
from _report import fixed, parser, publish, rst_table
from bench_measured_robots import load
from scipy import signal

from sklearn_vbjfa.datasets import protocols

HEADERS = [
    "set",
    "joint",
    "unit",
    "fitted",
    "held out",
    "noise floor",
    "torque noise",
    "input noise",
    "output noise",
    "fitted / floor",
]

SEEDS = range(0, 3)
ROBOTS = ("demo_arm", "head", "kr300")
DT = 0.005  # s
# Standard deviation of the noise as a share of that of the torque.
SIZE = 0.03
# Right is what is within this share of the truth.
RIGHT = 0.15
# What the robots have, and what of it the model declares.
FRICTIONS = {
    "declared": (("viscous", "coulomb"), ("viscous", "coulomb"), None),
    "coulomb not declared": (("viscous", "coulomb"), ("viscous",), None),
    "presliding not declared": (
        ("viscous", "coulomb"),
        ("viscous", "coulomb"),
        "presliding",
    ),
}


def _white(n, rng):
    return rng.normal(size=n)


def _regressive(rho):
    def draw(n, rng):
        lead = int(20 / (1 - rho))
        x = signal.lfilter([1.0], [1.0, -rho], rng.normal(size=n + lead))
        return x[lead:] * np.sqrt(1 - rho**2)

    return draw


def _filtered(cutoff):
    """Noise of a sensor behind a low-pass of second order [Hz]."""
    b, a = signal.butter(2, 2 * cutoff * DT)
    _, response = signal.freqz(b, a, worN=8192)
    size = np.sqrt(np.mean(np.abs(response) ** 2))

    def draw(n, rng):
        return signal.lfilter(b, a, rng.normal(size=n + 1000))[1000:] / size

    return draw


def _held(count):
    """Return the noise of torques that are read every `count` rows and held."""

    def draw(n, rng):
        return np.repeat(rng.normal(size=n // count + 1), count)[:n]

    return draw


def _mixed(n, rng):
    return 0.8 * _regressive(0.95)(n, rng) + 0.6 * _white(n, rng)


# Unit noise; and the step that torques are rounded to, in units of the noise.
NOISES = {
    "white": (_white, 0.0),
    "AR(0.5)": (_regressive(0.5), 0.0),
    "AR(0.8)": (_regressive(0.8), 0.0),
    "AR(0.9)": (_regressive(0.9), 0.0),
    "AR(0.95)": (_regressive(0.95), 0.0),
    "AR(0.95) and white": (_mixed, 0.0),
    "sensor 50 Hz": (_filtered(50.0), 0.0),
    "sensor 20 Hz": (_filtered(20.0), 0.0),
    "held 4 rows": (_held(4), 0.0),
    "step 0.01": (_white, 0.01),
    "step 0.1": (_white, 0.1),
    "step 1": (_white, 1.0),
    "step 1, AR(0.8)": (_regressive(0.8), 1.0),
    "step 10": (_white, 10.0),
}


def simulate(robot, seed, friction, noise):
    """Return (identifier, recording, error of the torques as recorded (n, nv))."""
    from bench_rest import _model

    from sklearn_vbjfa import RobotIdentifier
    from sklearn_vbjfa.datasets import make_robot_recording

    has, declared, extra = FRICTIONS[friction]
    model = _model(robot)
    settings = {
        "dt": DT, "duration": 30.0, "encoder_noise": 2e-5, "torque_noise": 0.0,
        "friction": has, "random_state": seed,
    }  # fmt: skip
    recording = make_robot_recording(model, **settings)
    clean = recording.tau_clean
    if extra:
        # on every joint, in place of a sign that turns at once
        from sklearn_vbjfa.effects import dahl

        for j, size in enumerate(recording.friction["coulomb"]):
            q, v = recording.states[:, j], recording.states[:, model.nv + j]
            clean[:, j] += size * (dahl(q, 0.01 * np.ptp(q)) - np.sign(v))
    rng = np.random.default_rng([seed, len(noise)])
    draw, step = NOISES[noise]
    size = SIZE * clean.std(axis=0)
    tau = clean + size * np.column_stack(
        [draw(len(clean), rng) for _ in range(model.nv)]
    )
    if step:
        tau = step * size * np.round(tau / (step * size))
    recording = replace(recording, tau=tau)
    return RobotIdentifier(model, dt=DT, friction=declared), recording, tau - clean


def truth(robot, noise, recording, seed):
    """Deviation of the noise behind the low-pass of the fit, (nv,)."""
    lowpass = robot.estimator_.lowpass_
    draw, step = NOISES[noise]
    size = SIZE * recording.tau_clean.std(axis=0)
    long = draw(200_000, np.random.default_rng([seed, 77]))
    own = np.convolve(long, lowpass.taps, mode="valid").std() * size
    if step:
        # The error of rounding depends on the torque that is rounded.
        error = recording.tau - recording.tau_clean
        rng = np.random.default_rng(seed)
        again = recording.tau_clean + size * np.column_stack(
            [draw(len(error), rng) for _ in size]
        )
        both = [error, step * size * np.round(again / (step * size))]
        both[1] = both[1] - recording.tau_clean
        own = np.mean(
            [
                [np.convolve(x, lowpass.taps, mode="valid").std() for x in e.T]
                for e in both
            ],
            axis=0,
        )
    return own


def measure_simulated(seeds, robots=ROBOTS, frictions=FRICTIONS, noises=NOISES):
    """(friction, noise) -> (ratios of the floor, ratios of the residual) to truth."""
    found = {}
    for friction in frictions:
        for noise in noises:
            pairs = []
            for robot in robots:
                for seed in seeds:
                    identifier, recording, _ = simulate(robot, seed, friction, noise)
                    fitted = identifier.fit(recording.q, recording.tau)
                    size = truth(fitted, noise, recording, seed)
                    residual = fitted.residuals(recording.q, recording.tau).rms()
                    pairs.append([fitted.torque_noise_ / size, residual / size])
            found[friction, noise] = np.concatenate(pairs, axis=1)
    return found


def simulated_table(found):
    """Text of the table of simulated robots."""
    rows = []
    for (friction, noise), (ratio, residual) in found.items():
        known = ratio[np.isfinite(ratio)]
        spread = np.full(3, np.nan)
        if known.size:
            spread = np.array([known.min(), np.median(known), known.max()])
        shares = [
            100 * np.mean(what)
            for what in (
                (known <= 1 + RIGHT) & (known >= 1 / (1 + RIGHT)),
                known > 1 + RIGHT,
                known < 1 / (1 + RIGHT),
            )
        ] if known.size else 3 * [np.nan]  # fmt: skip
        rows.append(
            [
                friction,
                noise,
                *fixed(spread, 2),
                *fixed([*shares, 100 * np.mean(~np.isfinite(ratio))], 0),
                *fixed([np.median(residual)], 2),
            ]
        )
    return rst_table(
        rows,
        [
            "friction",
            "noise",
            "lowest",
            "median",
            "highest",
            "right [%]",
            "too high [%]",
            "too low [%]",
            "unknown [%]",
            "residual / truth",
        ],
        n_labels=2,
    )


def _figures(values):
    """Numbers with three digits; a dash for what does not exist."""
    return [f"{v:.3g}" if np.isfinite(v) else "–" for v in values]


def measure(name, data_home):
    """Return the rows of one set, one per joint."""
    recording, _, identifier, (train, test) = load(name, data_home)
    robot = identifier.fit(*train[:2], groups=train[2])
    fitted, held_out = (
        robot.residuals(*part[:2], groups=part[2]).rms() for part in (train, test)
    )
    columns = np.column_stack(
        [
            fitted,
            held_out,
            robot.noise_floor_,
            robot.torque_noise_,
            robot.input_noise_torque_,
            robot.output_noise_,
            fitted / robot.noise_floor_,
        ]
    )
    return [
        [name, joint, unit, *_figures(values)]
        for joint, unit, values in zip(
            robot.joint_names_, recording.torque_units, columns
        )
    ]


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument(
        "--data", nargs="*", default=None, help="sets; by default all measured ones"
    )
    arguments.add_argument("--seeds", nargs=2, type=int, default=None)
    arguments = arguments.parse_args(argv)
    seeds = range(*arguments.seeds) if arguments.seeds else SEEDS
    started = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        simulated = measure_simulated(seeds)
    print(f"simulated: {time.perf_counter() - started:.0f} s", file=sys.stderr)
    rows = []
    names = arguments.data
    if names is None:
        names = [name for name in protocols() if name != "demo"]
    for name in names:
        started = time.perf_counter()
        with warnings.catch_warnings():
            # Joints that stand still are told of by the fit.
            warnings.simplefilter("ignore", UserWarning)
            rows += measure(name, arguments.data_home)
        seconds = time.perf_counter() - started
        print(f"{name}: {seconds:.0f} s", file=sys.stderr, flush=True)
    text = (
        f"Simulated robots ({', '.join(ROBOTS)}), seeds {seeds[0]} to {seeds[-1]}, 30 "
        f"s of {1e3 * DT:g} ms: ``torque_noise_`` over the deviation of the torque "
        "noise behind the low-pass. *right*: within "
        f"{100 * RIGHT:.0f} %, of the joints where it is known. Steps of the torques "
        "in units of the deviation of the noise. *residual*: its root mean square, in "
        "the median.\n\n"
        + simulated_table(simulated)
        + "\n\nMeasured robots: root mean squares behind the low-pass and the mask, in "
        "the unit of the joint's torque.\n\n" + rst_table(rows, HEADERS, n_labels=3)
    )
    publish("noise_floor", text, write=arguments.write)


if __name__ == "__main__":
    main()
