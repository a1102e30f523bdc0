"""Synthetic outcomes for reports."""

import dataclasses

import numpy as np

from sklearn_vbjfa.diagnosis import SearchSettings
from sklearn_vbjfa.diagnosis.explain import (
    Dependence,
    DiscoveredEffect,
    JointErrors,
    NotIdentifiable,
    Outcome,
    Unexplained,
)
from sklearn_vbjfa.diagnosis.search._posterior import UNDECIDED, Evidence
from sklearn_vbjfa.effects import Effect, resolve
from sklearn_vbjfa.inspection import ChannelFinding

EVIDENCE = Evidence(log_odds=8.2, gain=0.46, gain_std=0.04, errors=11.0, n_blocks=52)
# Probability 80 %, not significant in cross-validation.
POSSIBLE = Evidence(log_odds=1.386, gain=0.02, gain_std=0.02, errors=1.7, n_blocks=52)
KINDS = (
    ("load_friction", {"mu": 0.112}, {"mu": ""}, ("maxwell_slip",)),
    (
        "coupling",
        {"Fvm": 1.234, "Fcm": 12.3, "Iam": 0.0345, "other": 0, "ratio": 1.0},
        {"Fvm": "N m s/rad", "Fcm": "N m", "Iam": "kg m^2"},
        ("coulomb", "stribeck", "drift", "maxwell_slip"),
    ),
    ("ripple", {"A": 0.8, "phase": 1.2, "period": 0.33}, {"A": "N m"}, ()),
    ("my_own_effect", {"k3": 2e-7}, {"k3": "N m/rad^3"}, ()),
)


class MyOwnEffect(Effect):
    name = "my_own_effect"


def finding(message, severity="note"):
    return ChannelFinding("some_fault", (0,), severity, message)


def make_trials(joint, names):
    return tuple({"name": name, "joint": joint, "shape": {}} for name in names)


def make_effect(i, joint, names):
    name, parameters, units, rivals = KINDS[i % len(KINDS)]
    spread = {
        k: 0.1 * v for k, v in parameters.items() if not isinstance(v, (str, int))
    }
    return DiscoveredEffect(
        name=name,
        joint=joint,
        joint_name=names[joint],
        parameters=parameters,
        units=units,
        intervals={
            k: (parameters[k] - s, parameters[k] + s) for k, s in spread.items()
        },
        evidence=EVIDENCE,
        rivals=rivals,
        trials=make_trials(joint, rivals),
    )


def make_possible(i, joint, names, warning=UNDECIDED, evidence=POSSIBLE):
    """Make a possible effect, whose intervals contain zero."""
    effect = make_effect(i, joint, names)
    wide = {k: (low - high, 2 * high) for k, (low, high) in effect.intervals.items()}
    return dataclasses.replace(
        effect, intervals=wide, evidence=evidence, warning=warning, trials=()
    )


NO_ENDS = dict.fromkeys(("after", "difference", "added"), (np.nan, np.nan))
COLUMNS = ("before", "plain", "after", "floor", "spread", "seconds", "enough")
COLUMNS += ("searched", "threshold")
FINDINGS = ("unnamed", "contradictions", "repeated", "departures", "alike")
SETTINGS = {
    "test_size": 0.25,
    "held_out_seconds": 21.4,
    "guard_seconds": 0.13,
    "alpha": 0.05,
    "search": dataclasses.asdict(SearchSettings()),
    "effects": ("coulomb", "ripple"),
    "versions": {"numpy": "2.0"},
}


def make_outcome(nv=6, n_effects=2, unexplained=(), names=None, **changes):
    """Make an outcome; `changes`: columns of the errors, entries of other fields."""
    names = names or tuple(f"joint{j + 1}" for j in range(nv))
    effects = tuple(make_effect(i, (i + 1) % nv, names) for i in range(n_effects))
    effects = changes.pop("effects", effects)
    floor = np.linspace(0.03, 0.08, nv)
    after = floor * 1.02
    after[list(unexplained)] *= 2.0
    before = after.copy()
    before[[(i + 1) % nv for i in range(n_effects)]] += 0.1
    columns = {"before": before, "after": after, "floor": floor}
    columns |= {"spread": np.linspace(50.0, 5.0, nv), "seconds": np.full(nv, 9.0)}
    intervals = {
        "after": np.array([0.9 * after, 1.1 * after]),
        "difference": np.array([after - before - 0.01, (after - before) * 0.9]),
    }
    columns |= {k: changes.pop(k) for k in COLUMNS if k in changes}
    intervals = changes.pop("intervals", intervals)
    if not changes.get("added"):
        # All baseline friction terms are declared.
        columns["plain"] = columns["before"]
        if "difference" in intervals:
            intervals |= {"added": intervals["difference"]}
    units = changes.pop("units", nv * ("N m",))
    ends = {k: np.transpose(x).tolist() for k, x in intervals.items()}
    errors = tuple(
        JointErrors(
            joint=j,
            name=names[j],
            unit=units[j],
            position_unit="m" if units[j] == "N" else "rad",
            intervals=NO_ENDS | {k: tuple(x[j]) for k, x in ends.items()},
            **{k: np.asarray(x)[j].item() for k, x in columns.items()},
        )
        for j in range(nv)
    )
    findings = dict.fromkeys(FINDINGS, ()) | {
        "effects": effects,
        "possible": (),
        "unexplained": tuple(make_unexplained(j, names) for j in unexplained),
        "not_identifiable": tuple(make_hidden(names)),
        "channels": (
            finding("Torque of joint 1 is coarse, 3 steps."),
            finding("Joint 2 stands still."),
        ),
    }
    robot = {
        "name": "arm",
        "joints": names,
        "friction": ("viscous",),
        "added": (),
        "n_parameters": 11 * nv,
        "cutoff": 10.0,
        "drive": None,
        "motion": (),
        "limits": None,
        "gains": None,
        "corrections": (),
        "common_size": 1.0,
        "library": {e.name: e for e in (*resolve("all"), MyOwnEffect())},
        "unsimulated": [],
    }
    provenance = {
        "recordings": ("1",),
        "samples": 4000,
        "seconds": 20.0,
        "rate": 200.0,
        "looked_at": 0,
        "left_out": 0,
        "settings": SETTINGS | {"n_candidates": 18 * nv},
    }
    facts, curves = changes.pop("facts", ()), changes.pop("curves", {})
    for part in (findings, robot, provenance):
        part |= {key: changes.pop(key) for key in set(part) & set(changes)}
    assert not changes, changes
    return Outcome(
        errors=errors,
        findings=findings,
        facts=facts,
        robot=robot,
        curves=curves,
        provenance=provenance,
    )


def make_unexplained(j, names):
    signals = (
        Dependence(signal=f"speed of {names[-1]}", share=0.31, p_value=1e-7),
        Dependence(signal="time", share=0.08, p_value=1e-4),
    )
    keywords = {"joint": j, "joint_name": names[j], "signals": signals}
    return Unexplained(rms=0.5, floor=0.25, of_torque=0.043, **keywords)


def make_hidden(names):
    for j, joint_name in enumerate(names):
        for name, reason, remedy in (
            ("rotor_inertia", "span", ""),
            ("counterbalance", "excitation", ""),
            ("drift", "signal", "needs time stamps"),
        ):
            keywords = {"name": name, "joint": j, "joint_name": joint_name}
            yield NotIdentifiable(reason=reason, remedy=remedy, **keywords)


def changed(outcome, **changes):
    """Replace columns of the errors and entries of other fields."""
    errors, fields = list(outcome.errors), {}
    for name in ("findings", "robot", "provenance"):
        old = changes.pop(name, getattr(outcome, name))
        new = {k: changes.pop(k) for k in set(old) & set(changes)}
        fields[name] = old | new
    for name in set(changes) & set(COLUMNS):
        values = np.broadcast_to(changes.pop(name), len(errors)).tolist()
        errors = [dataclasses.replace(e, **{name: x}) for e, x in zip(errors, values)]
    if "intervals" in changes:
        ends = changes.pop("intervals")
        errors = [dataclasses.replace(e, intervals=NO_ENDS | ends) for e in errors]
    return dataclasses.replace(outcome, errors=tuple(errors), **fields, **changes)
