"""Closing the loop on simulated robots that lack known effects.

Run ``python tests/benchmarks/bench_discovery.py [--cases N] [--seed S] [--write]``.
Robots, joints, kinds, sizes and noise are drawn at random by a simulator that shares no
code with the library of effects (``_undeclared.py``: LuGre and Maxwell slip integrated
in time, a smooth sign, a gas spring's geometry, ...). The seeds of the table are not
those that the search was developed with.
"""

import sys
import time
import warnings
from dataclasses import dataclass

import numpy as np
from _report import parser, publish, rst_table
from _undeclared import LIBRARY, OUTSIDE, PLAIN, draw_cases, simulate

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier

KINDS = tuple(kind for kind in LIBRARY if kind not in PLAIN)
# (label, number of effects, range of sizes in units of the torque noise, target)
STUDIES = (
    ("one effect, 3 to 10", 1, (3.0, 10.0), "97 %"),
    ("one effect, 1 to 3", 1, (1.0, 3.0), "90 %"),
    ("one effect, 0.5 to 1", 1, (0.5, 1.0), ""),
    ("two effects, 2 to 8", 2, (2.0, 8.0), "85 %"),
    ("three effects, 2 to 8", 3, (2.0, 8.0), "85 %"),
)
# A library parameter beside the simulator's name for it.
COMPARED = {
    "asymmetric_friction": ("dFv", "Fv_difference"),
    "viscous_quadratic": ("F2", "F2"),
    "load_friction": ("mu", "mu"),
    "spring": ("k", "k"),
    "backlash": ("width", "width"),
    "ripple": ("period", "period"),
    "elastic": ("k", "stiffness"),
    "delay": ("delay", "delay"),
    "payload": ("dm", "mass"),
    "stribeck": ("Fs", "Fs"),
    "presliding": ("displacement", "displacement"),
}


@dataclass(frozen=True)
class Verdict:
    """What the loop made of one recording.

    Attributes
    ----------
    named : bool
        Every visible effect was named with its joint, and nothing else was.
    listed : bool
        The same, counting an effect that is given as a rival of the one named.
    extra : bool
        Something was named that is not there.
    claims : bool
        No joint with a true effect was reported as unexplained.
    parameter_errors : tuple of float
        Relative errors of the effects' main parameters.
    floor_ratio : float
        Largest error after over the noise floor, of the joints with an effect.
    seconds : float
        Time of the loop.
    """

    named: bool
    listed: bool
    extra: bool
    claims: bool
    parameter_errors: tuple
    floor_ratio: float
    seconds: float


def judge(recording):
    """Close the loop on a recording and compare with the truth."""
    identifier = RobotIdentifier(
        recording.model, dt=recording.dt, friction=recording.declared
    )
    loop = EffectDiscovery(identifier, random_state=0)
    started = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        loop.fit(recording.q, recording.tau, groups=recording.groups)
    seconds = time.perf_counter() - started
    truth = {(e.name, e.joint) for e in recording.truth if e.visible}
    allowed = truth | {(n, e.joint) for e in recording.truth for n in e.contains}
    found = {(e.name, e.joint) for e in loop.effects_}
    rivals = {(n, e.joint) for e in loop.effects_ for n in e.rivals}
    # A name that is wrong but whose rival is the true one is no claim.
    excused = {
        (e.name, e.joint)
        for e in loop.effects_
        if {(n, e.joint) for n in e.rivals} & truth
    }
    joints = [e.joint for e in recording.truth]
    ratio = loop.error_after_ / loop.report_.outcome.floor
    return Verdict(
        named=truth <= found and found <= allowed,
        listed=truth <= found | rivals and found <= allowed | excused,
        extra=bool(found - allowed - excused),
        claims=bool(found) and not {u.joint for u in loop.unexplained_} & set(joints),
        parameter_errors=tuple(_parameter_errors(recording.truth, loop.effects_)),
        floor_ratio=float(np.max(ratio[joints])) if joints else np.nan,
        seconds=seconds,
    )


def _parameter_errors(truth, effects):
    for entry in truth:
        for effect in effects:
            same = (effect.name, effect.joint) == (entry.name, entry.joint)
            if same and entry.name in COMPARED:
                own, theirs = COMPARED[entry.name]
                value, true = effect.parameters[own], entry.parameters[theirs]
                yield abs(abs(value) - abs(true)) / abs(true)


def study(cases):
    """Verdicts on drawn cases."""
    return [judge(case.simulate()) for case in cases]


def clean(n, seed):
    """Verdicts on robots that lack nothing."""
    declared = (("viscous",), ("viscous", "coulomb"))
    return [
        judge(simulate([], size=[], seed=seed + i, declared=declared[i % 2]))
        for i in range(n)
    ]


def _share(flags):
    return f"{100 * np.mean(flags):.0f} %" if len(flags) else "–"


def row(label, verdicts, target):
    """Row of the table."""
    errors = [e for v in verdicts for e in v.parameter_errors]
    return [
        label,
        len(verdicts),
        _share([v.named for v in verdicts]),
        _share([v.listed for v in verdicts]),
        target or "–",
        _share([v.extra for v in verdicts]),
        f"{100 * np.median(errors):.1f} %" if errors else "–",
        f"{np.nanmedian([v.floor_ratio for v in verdicts]):.2f}",
        f"{np.median([v.seconds for v in verdicts]):.1f}",
    ]


HEADERS = [
    "undeclared",
    "recordings",
    "named",
    "or given as rival",
    "target",
    "wrong name",
    "parameters, median error",
    "after / floor, median",
    "s",
]


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--cases", type=int, default=17)
    arguments.add_argument("--seed", type=int, default=2011)
    arguments = arguments.parse_args(argv)
    rows = []
    for k, (label, n_effects, sizes, target) in enumerate(STUDIES):
        cases = draw_cases(
            arguments.cases, n_effects, sizes, arguments.seed + k, kinds=KINDS
        )
        rows.append(row(label, study(cases), target))
        print(" | ".join(map(str, rows[-1])), file=sys.stderr, flush=True)
    nothing = clean(arguments.cases, arguments.seed + 100)
    strangers = study(
        draw_cases(arguments.cases, 1, (3.0, 8.0), arguments.seed + 10, kinds=OUTSIDE)
    )
    text = (
        "Sizes are root mean squares over the standard deviation of the torque "
        "noise.\n\n"
        + rst_table(rows, HEADERS)
        + f"\n\nNothing missing: {sum(v.extra for v in nothing)} false alarms in "
        f"{len(nothing)} recordings (target: 2 %). An effect outside the library: "
        f"{sum(v.claims for v in strangers)} of {len(strangers)} recordings in which "
        "something was named and the joint not reported as unexplained (target: none); "
        f"in {sum(v.extra for v in strangers)} some name was given."
    )
    publish("discovery", text, write=arguments.write)


if __name__ == "__main__":
    main()
