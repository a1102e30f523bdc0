"""Allowed uses of a result, consistent with the verdicts on the joints."""

from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import Report
from sklearn_vbjfa.diagnosis.explain import Fact
from sklearn_vbjfa.inspection import JointMotion
from sklearn_vbjfa.robot._exports import UNSTABLE
from tests.diagnosis.report._outcomes import changed, finding, make_outcome
from tests.diagnosis.report._pages import line_of, make_mass
from tests.diagnosis.report.test_report import STATUS


def allowed_uses(report):
    return {use.name: use.allowed for use in report.uses}


def test_all_uses_are_allowed_at_the_noise_floor():
    report = Report(make_outcome(channels=()))
    assert set(allowed_uses(report).values()) == {True}
    printed = str(report)
    assert "Use for: feedforward, simulation, collision detection." in printed
    assert "Do not use for" not in printed


def test_findings_of_the_export_qualify_the_simulation():
    outcome = make_outcome(channels=())
    for drive, warning, reason in (
        (None, "identified.xml moves (joint2 4 %)", "identified.json; the MuJoCo"),
        (None, f"{UNSTABLE}: why", "diverges without feedback"),
        ({"kind": "PDDrive"}, f"{UNSTABLE}: why", "only under its drive"),
    ):
        changes = {"provenance": outcome.provenance | {"export": (warning,)}}
        changes |= {"robot": outcome.robot | {"drive": drive}}
        report = Report(replace(outcome, **changes))
        assert report.uses[1].reason.startswith(reason)
        assert report.uses[1].allowed == ("diverges" not in reason)
        assert report.to_dict()["warnings"] == [warning]


@pytest.mark.parametrize(
    ("delay", "error", "status", "allowed", "warning"),
    [
        (0.008, 0.1, "floor", (1, 1, 1), "none"),
        (-0.004, 0.3, "floor", (1, 1, 1), "none"),
        (-0.03, 0.1, "floor", (0, 0, 0), "more than a sample period before"),
        (0.008, 0.1, "unknown", (1, 1, 0), "noise floor unknown"),
        (0.008, 0.3, "unknown", (0, 1, 0), "more than a fifth of the torque"),
    ],
)
def test_uses_of_a_control_law(delay, error, status, allowed, warning):
    fact = {"kind": "parameter", "name": "drive:delay", "joint": None, "value": delay}
    fact = Fact(interval=(delay - 1e-4, delay + 1e-4), **fact)
    errors = dict.fromkeys(("before", "after", "plain"), np.full(6, error))
    errors["floor"] = np.full(6, error if status == "floor" else np.nan)
    changes = errors | {"drive": {"kind": "PDDrive"}, "facts": (fact,)}
    report = Report(make_outcome(channels=(), n_effects=0, **changes))
    assert tuple(use.allowed for use in report.uses[:3]) == allowed
    assert warning in " ".join(report.warnings or ("none",))
    assert ("if the drive follows this law" in report.uses[0].reason) == allowed[0]
    assert ("not confirmed" in report.uses[1].reason) == (status == "unknown")


def test_effects_without_simulation_qualify_the_simulation():
    outcome = make_outcome(channels=(), n_effects=1)
    (effect,) = outcome.findings["effects"]
    report = Report(changed(outcome, effects=(replace(effect, name="elastic"),)))
    assert "simulation (joint 2: simulations leave an effect out)" in line_of(report)


def test_motion_in_one_direction_qualifies_the_uses():
    known = {"lowest": -1.0, "highest": 1.0, "fastest": 1.0, "torques": (-1.0, 1.0)}
    known |= {"slides": False, "shows": (), "hides": ()}
    turns = enumerate([(9, 0), (0, 0), (9, 0), (0, 1), (9, 0), (9, 0)], 1)
    motion = [
        JointMotion(name=f"joint{j}", reversals=count, resting=resting, **known)
        for j, (count, resting) in turns
    ]
    report = Report(make_outcome(channels=(), motion=motion))
    assert all(allowed_uses(report).values())
    assert "(joint 2: one direction of motion only)" in line_of(report)


def test_residual_above_the_noise_forbids_collision_detection():
    changes = {"unexplained": (2,), "threshold": [2.5] * 6, "floor": [0.2] * 6}
    report = Report(make_outcome(channels=(), **changes))
    assert [*allowed_uses(report).values()] == [True, True, False]
    note = "joint 3: residual above the noise floor, 99.9 % of residuals below 2.5 N m"
    assert report.to_dict()["uses"][2]["reason"] == note
    ends = {"after": [[0.1] * 6, [0.9] * 6], "difference": [[-1] * 6, [0] * 6]}
    changes = {"intervals": ends, "floor": [0.2] * 6}
    report = Report(make_outcome(channels=(), after=np.full(6, 0.4), **changes))
    assert report.joints[2].text == "2.0 times the floor (not significant)"
    assert all(allowed_uses(report).values())


def test_an_increased_error_forbids_feedforward():
    after = make_outcome().column("before")
    after[1] *= 3.0
    report = Report(make_outcome(channels=(), after=after, intervals={}))
    assert report.joints[1].status == "worse"
    assert not allowed_uses(report)["feedforward"]
    assert "held-out error rose" in report.uses[0].reason


def test_an_insignificant_increase_is_noted_with_the_uses():
    outcome = make_outcome(channels=())
    error = outcome.errors[1]
    ends = {"difference": (-0.1, 0.2), "added": (-0.1, 0.2)}
    error = replace(error, after=1.2 * error.before, intervals=error.intervals | ends)
    errors = (outcome.errors[0], error, *outcome.errors[2:])
    report = Report(replace(outcome, errors=errors))
    assert report.joints[1].status != "worse"
    assert report.uses[0].allowed
    text = "collision detection (joint 2: held-out error rose, within chance; joint 2:"
    assert text in line_of(report)
    provenance = outcome.provenance | {"export": ("identified.xml moves",)}
    report = Report(replace(outcome, errors=errors, provenance=provenance))
    assert "within chance; identified.json" in report.uses[1].reason


def test_a_large_error_is_noted_with_the_uses():
    for after in (0.4, 0.6):
        outcome = make_outcome(channels=(), after=np.full(6, after))
        use, *_ = Report(outcome).uses
        assert f"above {'a fifth' if after < 0.5 else 'half'} of the" in use.reason
        for floor in (0.01, np.nan):
            more = {"after": np.full(6, after), "floor": np.full(6, floor)}
            outcome = make_outcome(unexplained=(2,), channels=(), **more)
            assert Report(outcome).uses[0].allowed == (after < 0.5)


def test_any_increase_on_a_joint_with_an_effect_is_noted():
    outcome = make_outcome(channels=(), n_effects=1)
    (effect,) = outcome.findings["effects"]
    for joint in (effect.joint, effect.joint + 1):
        errors = list(outcome.errors)
        row = errors[joint]
        errors[joint] = replace(row, after=1.03 * row.before, floor=0.5 * row.before)
        reason = Report(replace(outcome, errors=tuple(errors))).uses[0].reason
        assert ("error rose" in reason) == (joint == effect.joint)


def test_a_faulty_channel_forbids_every_use():
    wrong = replace(finding("Wrong unit.", "warning"), kind="torque_unit")
    report = Report(make_outcome(channels=(wrong,)))
    assert "The log contradicts this: Wrong unit." in report.to_html()
    assert report.status == "faulty"
    assert set(allowed_uses(report).values()) == {False}


@pytest.mark.parametrize("status", STATUS)
def test_forbidden_uses_have_a_warning(status):
    report = Report(make_outcome(**({"channels": ()} | STATUS[status])))
    forbidden = not all(allowed_uses(report)[x] for x in ("feedforward", "simulation"))
    assert forbidden <= bool(report.warnings)


def test_masses_are_split_by_identifiability():
    sources = enumerate(("yes", "yes", "in combination", "no"), 1)
    masses = tuple(make_mass(f"link{k}", 1.0, 1.0, x, 0.1) for k, x in sources)
    report = Report(make_outcome(channels=(), facts=masses))
    assert allowed_uses(report)["link masses of link1 and link2"]
    assert not allowed_uses(report)["link masses of link3 and link4"]
    assert report.to_dict()["uses"][-1]["allowed"] is False
    assert "(only 2 of 4 are individually identifiable)" in report.to_html()


def test_an_implausible_mass_next_to_a_spring_is_a_warning():
    (effect,) = make_outcome(n_effects=1).findings["effects"]
    warned = ("spring", 87.0, "no")
    others = ("spring", 20.0, "no"), ("spring", 87.0, "yes"), ("stribeck", 87.0, "no")
    for name, mass, source in (warned, *others):
        effects = (replace(effect, name=name, joint=0),)
        facts = (make_mass("link1", mass, 8.0, source),)
        report = Report(make_outcome(channels=(), effects=effects, facts=facts))
        found = any("87 kg" in line for line in report.warnings)
        assert found == ((name, mass, source) == warned)


def test_uses_do_not_depend_on_the_size_of_errors():
    small = make_outcome(channels=())
    more = {k: 3.0 * small.column(k) for k in ("before", "after", "floor")}
    large = make_outcome(channels=(), intervals={}, **more)
    assert allowed_uses(Report(small)) == allowed_uses(Report(large))
    assert np.isfinite(large.column("floor")).all()
