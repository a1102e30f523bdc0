"""The slide EMPS by the rule of its board: open-loop simulation of another recording.

Run as ``python tests/benchmarks/bench_simulation_emps.py --data-home DIR``. Models are
fitted to DATA_EMPS. PULSES is simulated from its first state, driven by its measured
force, to its end, and judged by the root mean square of the positions, the first 20
rows left out (nonlinearbenchmark.org).

Structure and criterion are chosen on DATA_EMPS alone. Its reference repeats one motion
four times; each of the four is left out once, the model is fitted to the others, and
the one left out is simulated in open loop from its first state. The candidate with the
least root mean square of the positions over all four is fitted to the whole of
DATA_EMPS, and judged. No other candidate is simulated on PULSES; plain least squares,
by the authors' own filters, stands beside it.
"""

import itertools
import warnings
from dataclasses import replace

import numpy as np
from _report import fixed, parser, publish, rst_table
from bench_protocol_emps import FITTED, JUDGED, authors_least_squares, authors_states

from sklearn_vbjfa import RobotIdentifier, StateEstimator
from sklearn_vbjfa.datasets import fetch_emps
from sklearn_vbjfa.effects import AsymmetricFriction, Spring, Stribeck
from sklearn_vbjfa.simulation import simulate

SKIPPED = 20  # rows
REPEATS = 4
FRICTION = ("viscous", "coulomb")
# Label -> declared friction, effects. Asymmetric friction has an offset of its own.
STRUCTURES = {
    "viscous, Coulomb, offset": ((*FRICTION, "offset"), ()),
    "with asymmetric friction": (FRICTION, (AsymmetricFriction(),)),
    "with asymmetric friction, spring": (FRICTION, (AsymmetricFriction(), Spring())),
    "with asymmetric friction, Stribeck": (
        FRICTION,
        (AsymmetricFriction(), Stribeck(vs=0.02)),
    ),
}
# Label -> settings; windows of half a repeat and of a whole one (6.2 s).
CRITERIA = {
    "torque": {"criterion": "torque"},
    "simulation, 3.1 s": {"criterion": "simulation", "window": 3.1},
    "simulation, 6.2 s": {"criterion": "simulation", "window": 6.2},
}
# Published errors on PULSES [mm] are of the same rule.
PUBLISHED = {"LSTM, the best black box published with its predictions": 74.0}


def start_states(part):
    """States (n, 3) of a recording, smoothed."""
    return StateEstimator(part.dt).fit_transform(part.q)


def position_error(model, part, rows=None):
    """Root mean square of simulated positions [mm] in some rows of a recording."""
    rows = slice(0, part.n_samples) if rows is None else rows
    start = start_states(part)[rows.start]
    tau, q = part.tau[rows], part.q[rows, 0]
    states = simulate(model, tau, start[:1], start[1:2])
    return 1e3 * np.sqrt(np.mean((states[SKIPPED:, 0] - q[SKIPPED:]) ** 2))


def fit(part, structure, criterion, kept=None):
    """Fit a candidate to a recording, or to some rows of it (n,) of bool."""
    friction, effects = STRUCTURES[structure]
    robot = RobotIdentifier(
        part.robot_model(),
        dt=part.dt,
        friction=friction,
        effects=effects,
        **CRITERIA[criterion],
    )
    if kept is None:
        return robot.fit(part.q, part.tau)
    # Rows on the two sides of a gap are different recordings.
    label = np.cumsum(np.diff(kept, prepend=kept[0]) != 0)[kept]
    return robot.fit(part.q[kept], part.tau[kept], groups=label)


def left_out(part, structure, criterion):
    """Errors [mm] of the repeats, each simulated by a model fitted to the others."""
    borders = np.linspace(0, part.n_samples, REPEATS + 1).astype(int)
    errors = []
    for begin, end in itertools.pairwise(borders):
        kept = np.ones(part.n_samples, dtype=bool)
        kept[begin:end] = False
        try:
            robot = fit(part, structure, criterion, kept)
            errors.append(
                position_error(robot.robot_.torque_model(), part, slice(begin, end))
            )
        except ValueError:
            # Its simulation diverges: the candidate is out.
            errors.append(np.inf)
    return errors


def choose(part):
    """Candidates with their errors on left-out repeats [mm], and the best of them."""
    found = {
        (structure, criterion): left_out(part, structure, criterion)
        for structure in STRUCTURES
        for criterion in CRITERIA
    }
    return found, min(found, key=lambda one: _rms(found[one]))


def _rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def plain_model(part):
    """`TorqueModel` of the authors' least squares."""
    theta = authors_least_squares(authors_states(part.q[:, 0], part.dt), part.tau[:, 0])
    fitted = fit(part, "viscous, Coulomb, offset", "torque")
    robot = fitted.robot_.torque_model()
    bodies = np.array([[theta[0], 0, 0, 0, 1, 0, 1, 0, 0, 1.0]])
    return replace(robot, bodies=bodies, friction=theta[None, 1:])


def report(recording, judge=True):
    """Text of the tables; without `judge`, of the choice alone."""
    fitted = recording.select(FITTED)
    found, best = choose(fitted)
    rows = [
        [*names, *fixed(errors, 2), *fixed([_rms(errors)], 2)]
        for names, errors in found.items()
    ]
    parts = [
        f"Candidates on {FITTED}: root mean square of simulated positions [mm] over "
        f"each of its {REPEATS} repeats, by a model fitted to the others.",
        rst_table(
            rows,
            ["structure", "criterion", "1st", "2nd", "3rd", "4th", "all"],
            n_labels=2,
        ),
        f"Chosen: {best[0]}; {best[1]}.",
    ]
    if not judge:
        return "\n\n".join(parts)
    judged = recording.select(JUDGED)
    robot = fit(fitted, *best)
    declared = fit(fitted, "viscous, Coulomb, offset", "torque")
    models = {
        "plain least squares, authors' filters": plain_model(fitted),
        "RobotIdentifier, viscous, Coulomb, offset": declared.robot_.torque_model(),
        f"chosen: {best[0]}; {best[1]}": robot.robot_.torque_model(),
    }
    errors = [
        [
            label,
            *fixed([position_error(model, part) for part in (fitted, judged)], 2),
        ]
        for label, model in models.items()
    ]
    errors += [[label, "–", f"{value:.0f}"] for label, value in PUBLISHED.items()]
    return "\n\n".join(
        [
            f"Fitted: {FITTED}, judged: {JUDGED}. Open-loop simulation of the whole "
            "recording from its first state, driven by the measured force; root mean "
            f"square of the position, first {SKIPPED} rows left out.",
            rst_table(
                errors, ["model", "fitted recording [mm]", "judged recording [mm]"]
            ),
            *parts,
        ]
    )


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument(
        "--choose", action="store_true", help="choose alone, without the judged set"
    )
    arguments = arguments.parse_args(argv)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        recording = fetch_emps(data_home=arguments.data_home)
        text = report(recording, judge=not arguments.choose)
    if arguments.choose:
        print(text)
    else:
        publish("simulation_emps", text, write=arguments.write)


if __name__ == "__main__":
    main()
