"""Outcomes of searches that never ran, for reports."""

import dataclasses

import numpy as np

from sklearn_vbjfa.diagnosis import SearchSettings
from sklearn_vbjfa.diagnosis.explain import (
    Dependence,
    DiscoveredEffect,
    Hidden,
    Outcome,
    Unexplained,
)
from sklearn_vbjfa.diagnosis.search import UNDECIDED, Evidence
from sklearn_vbjfa.effects import EffectRange, resolve
from sklearn_vbjfa.inspection import ChannelFinding

EVIDENCE = Evidence(log_odds=8.2, gain=0.46, gain_std=0.04, errors=11.0, n_blocks=52)
# Of probability 80 %, and of one that is sure and chance on other stretches.
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


def finding(message, severity="warning"):
    return ChannelFinding("some_fault", (0,), severity, message)


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
        ranges=make_range(name, joint),
    )


def make_possible(i, joint, names, warning=UNDECIDED, evidence=POSSIBLE):
    """Make an effect without a name, whose values may all be zero."""
    effect = make_effect(i, joint, names)
    wide = {k: (low - high, 2 * high) for k, (low, high) in effect.intervals.items()}
    return dataclasses.replace(
        effect, intervals=wide, evidence=evidence, warning=warning, rivals=()
    )


def make_range(name, joint, depends=("position",)):
    return EffectRange(
        name=name,
        joint=joint,
        position=(-1.25, 1.5),
        speed=(0.001, 2.0),
        load=(-30.0, 45.0),
        depends=depends if name == "ripple" else (),
    )


def make_outcome(nv=6, n_effects=2, unexplained=(), names=None, **changes):
    names = names or tuple(f"joint{j + 1}" for j in range(nv))
    rng = np.random.default_rng(0)
    effects = tuple(make_effect(i, (i + 1) % nv, names) for i in range(n_effects))
    floor = np.linspace(0.03, 0.08, nv)
    after = floor * 1.02
    after[list(unexplained)] *= 2.0
    before = after.copy()
    before[[e.joint for e in effects]] += 0.1
    signals = (
        Dependence(signal=f"speed of {names[-1]}", share=0.31, p_value=1e-7),
        Dependence(signal="time", share=0.08, p_value=1e-4),
    )
    m = 1500
    residual = rng.standard_normal((m, nv)) * floor
    values = {
        "declared": {
            "robot": "arm",
            "joints": names,
            "friction": ("viscous",),
            "n_parameters": 11 * nv,
            "cutoff": 10.0,
        },
        "effects": effects,
        "possible": (),
        "unexplained": tuple(
            Unexplained(
                joint=j,
                joint_name=names[j],
                rms=0.5,
                floor=0.25,
                share=0.75,
                of_torque=0.043,
                signals=signals,
            )
            for j in unexplained
        ),
        "hidden": tuple(
            Hidden(
                name=name,
                joint=j,
                joint_name=names[j],
                reason=reason,
                remedy="needs time stamps" if reason == "signal" else "",
            )
            for j in range(nv)
            for name, reason in (
                ("rotor_inertia", "span"),
                ("counterbalance", "excitation"),
                ("drift", "signal"),
            )
        ),
        "channels": (
            finding("Torque of joint 1 is coarse, 3 steps."),
            finding("Joint 2 stands still."),
        ),
        "joint_names": names,
        "torque_units": ("N m",) * nv,
        "error_before": before,
        "error_after": after,
        "spread": np.linspace(50.0, 5.0, nv),
        "unsearched": (),
        "added": (),
        "wide_after": 1.4 * after,
        "wide_cutoff": 40.0,
        "seconds": np.full(nv, 9.0),
        "enough": np.ones(nv, dtype=bool),
        "intervals": {
            "before": np.array([0.9 * before, 1.1 * before]),
            "after": np.array([0.9 * after, 1.1 * after]),
            "difference": np.array([after - before - 0.01, (after - before) * 0.9]),
        },
        "floor": floor,
        "library": {effect.name: effect for effect in resolve("all")},
        "settings": {
            "test_size": 0.25,
            "untouched_stretches": 3,
            "untouched_seconds": 21.4,
            "guard_seconds": 0.13,
            "alpha": 0.05,
            "n_candidates": 18 * nv,
            "search": dataclasses.asdict(SearchSettings()),
            "effects": ("coulomb", "ripple"),
            "n_blocks": 52,
            "block_seconds": 1.3,
            "n_folds": 8,
            "correlation_seconds": 0.13,
            "too_short": (),
            "random_state": 0,
            "versions": {"numpy": "2.0"},
        },
        "curves": {
            "index": np.arange(m),
            "before": residual + 0.1 * np.sin(np.arange(m) / 40)[:, None],
            "after": residual,
            "weight": (np.arange(m)[:, None] % 700 > 60) * np.ones((m, nv)),
            "torque": rng.standard_normal((m, nv)),
        },
    }
    values |= changes
    if not values["added"]:
        # All plain terms were declared.
        values["error_plain"] = values["error_before"]
        same = {"plain": "before", "added": "difference"}
        own = values["intervals"]
        values["intervals"] = own | {k: own[v] for k, v in same.items() if v in own}
    return Outcome(**values)
