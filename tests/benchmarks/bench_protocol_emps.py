"""The slide EMPS by its authors' protocol: fitted to one recording, judged on another.

Run as ``python tests/benchmarks/bench_protocol_emps.py --data-home DIR``. Positions
pass a Butterworth filter of order 4 at 100 Hz in both directions and are differentiated
centrally, the first 49 rows are dropped, and torque and prediction are decimated by 10
(a Chebyshev filter of order 8 at 40 Hz in both directions; 50 Hz is the Nyquist
frequency after that). Nothing is masked. The error is the norm of what is missed over
the norm of the force. First the authors' own least squares is repeated: if it does not
give their figures, the protocol is not theirs.
"""

import warnings

import numpy as np
from _report import fixed, parser, publish, rst_table
from scipy import signal

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier
from sklearn_vbjfa.datasets import fetch_emps
from sklearn_vbjfa.robot import FitOptions

FITTED, JUDGED = "DATA_EMPS", "PULSES"
POSITION_CUTOFF = 100.0  # Hz
BORDER = 49  # rows
DECIMATION = 10
# The package's low-pass: the Nyquist frequency that the authors decimate to.
CUTOFF = 50.0  # Hz
FRICTION = ("viscous", "coulomb", "offset")
# Janot, Gautier and Brunot (2019): mass, viscous, Coulomb, offset; and their errors.
PUBLISHED = {
    "M [kg]": 95.1089,
    "Fv [N s/m]": 203.5034,
    "Fc [N]": 20.3935,
    "offset [N]": -3.1648,
}
PUBLISHED_ERRORS = (4.08, 5.98)


def authors_states(q, dt):
    """Position, speed, acceleration (n, 3) of positions (n,), as the authors do."""
    b, a = signal.butter(4, POSITION_CUTOFF, fs=1 / dt)
    # The length of the padding is that of MATLAB's filtfilt.
    smooth = signal.filtfilt(b, a, q, padlen=3 * (len(a) - 1))
    v = np.gradient(smooth, dt)
    return np.column_stack([smooth, v, np.gradient(v, dt)])


def decimate(values):
    """Drop the first rows and decimate (n, ...) as MATLAB's decimate does."""
    values = values[BORDER:]
    b, a = signal.cheby1(8, 0.05, 0.8 / DECIMATION)
    smooth = signal.filtfilt(b, a, values, axis=0, padlen=3 * (len(a) - 1))
    # MATLAB keeps the last row of each ten, counted from the end.
    return smooth[(len(values) - 1) % DECIMATION :: DECIMATION]


def relative_error(force, predicted):
    """Norm of what is missed over the norm of the force, both decimated, in %."""
    force = decimate(force)
    return 100 * np.linalg.norm(force - decimate(predicted)) / np.linalg.norm(force)


def authors_columns(states):
    """Columns of mass, viscous and Coulomb friction and offset, (n, 4)."""
    _, v, a = states.T
    return np.column_stack([a, v, np.sign(v), np.ones_like(v)])


def authors_least_squares(states, force):
    """Mass, viscous and Coulomb friction and offset by the authors' least squares."""
    columns = decimate(authors_columns(states))
    return np.linalg.lstsq(columns, decimate(force), rcond=None)[0]


def fit_models(recording, **settings):
    """Label -> fitted model; and the loop. Arguments go to `EffectDiscovery`."""
    robot = RobotIdentifier(
        recording.robot_model(),
        dt=recording.dt,
        friction=FRICTION,
        cutoff=CUTOFF,
        options=FitOptions(standstill=None),
    )
    loop = EffectDiscovery(robot, random_state=0, **settings)
    loop.fit(recording.q, recording.tau)
    models = {
        "RobotIdentifier, whole recording": robot.fit(recording.q, recording.tau),
        "EffectDiscovery, declared model": loop.declared_,
        "EffectDiscovery, completed model": loop.identifier_,
    }
    return models, loop


def measure(recording, **settings):
    """Errors of every model on both recordings."""
    parts = [recording.select(name) for name in (FITTED, JUDGED)]
    states = [authors_states(part.q[:, 0], part.dt) for part in parts]
    force = [part.tau[:, 0] for part in parts]
    theta = authors_least_squares(states[0], force[0])
    errors = tuple(
        relative_error(y, authors_columns(x) @ theta) for x, y in zip(states, force)
    )
    models, loop = fit_models(parts[0], **settings)
    rows = [
        ["published, least squares", "theirs", *fixed(PUBLISHED_ERRORS, 2)],
        ["the same, repeated here", "theirs", *fixed(errors, 2)],
    ]
    for label, model in models.items():
        for source, inputs in (
            ("positions", [part.q for part in parts]),
            ("theirs", states),
        ):
            found = [
                relative_error(y, model.predict(x)[:, 0]) for x, y in zip(inputs, force)
            ]
            rows.append([label, source, *fixed(found, 2)])
    return rows, theta, errors, loop


def in_words(effect):
    """Name an effect with its parameters."""
    values = [
        f"{key} = {value:.3g}" if isinstance(value, float) else f"{key} = {value}"
        for key, value in effect.parameters.items()
    ]
    return f"{effect.name} ({', '.join(values)})"


def report(recording, **settings):
    """Text of the table."""
    rows, theta, errors, loop = measure(recording, **settings)
    agrees = np.allclose(errors, PUBLISHED_ERRORS, atol=0.005)
    found = ", ".join(map(in_words, loop.effects_)) or "nothing"
    sizes = [recording.select(name).n_samples for name in (FITTED, JUDGED)]
    return "\n\n".join(
        [
            f"Fitted: {FITTED}, {sizes[0]} rows, judged: {JUDGED}, {sizes[1]} rows, "
            f"of 1 ms. Filter of the judgement: Butterworth of order 4 at "
            f"{POSITION_CUTOFF:g} Hz on the positions, first {BORDER} rows dropped, "
            f"decimation by {DECIMATION}, zero phase, nothing masked. The package's "
            f"own low-pass: {CUTOFF:g} Hz, nothing masked; declared friction: "
            f"{', '.join(FRICTION)}. Norm of the error over the norm of the force.",
            rst_table(
                rows,
                ["model", "states", "fitted recording [%]", "judged recording [%]"],
                n_labels=2,
            ),
            rst_table(
                [
                    [name, f"{value:.4f}", f"{found_anew:.4f}"]
                    for (name, value), found_anew in zip(PUBLISHED.items(), theta)
                ],
                ["least squares", "published", "repeated here"],
            ),
            "Repeating the authors' least squares gives their errors: "
            f"{'yes' if agrees else 'NO, this is not their protocol'}.",
            f"Found by EffectDiscovery, in order: {found}.",
        ]
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__, data=True).parse_args(argv)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        text = report(fetch_emps(data_home=arguments.data_home))
    publish("protocol_emps", text, arguments)


if __name__ == "__main__":
    main()
