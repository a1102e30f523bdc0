"""What a report says of unknown gains, on made-up outcomes."""

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import Report
from sklearn_vbjfa.robot import BodyMass, ChannelGains, CommonGain, KnownMass
from tests.diagnosis.report._outcomes import make_effect, make_outcome, make_possible

NAMES = tuple(f"joint{j + 1}" for j in range(3))


def known(name="payload", found=12.0, *, used=False, shown=True):
    return KnownMass(name=name, mass=1.5, found=found, std=0.1, shown=shown, used=used)


def told(reference=(1, 1, 1), common=None, first=0.5, **changes):
    """Return what a terminal and Markdown show, in one line, tables as words."""
    reference = np.array(reference)
    gains = ChannelGains(
        joint_names=NAMES,
        gain=np.array([first, 1.0, 2.0]),
        std=np.array([0.01, 0.0, 0.02]),
        reference=reference,
        common=common or CommonGain(),
    )
    outcome = make_outcome(nv=3, names=NAMES, gains=gains, **changes)
    report = Report(outcome)
    text = f"{report}\n{report.to_markdown()}".replace("±", "+-")
    return " ".join(text.replace("|", " ").split())


def test_relative_gains():
    text = told()
    assert "Gains are relative to the channel of joint 2, from which" in text
    assert "units of that channel" in text
    assert "joint 1 0.500 +- 0.016 relative to joint 2" in text
    assert "joint 2 1 the unit" in text


def test_hidden_gains():
    text = told(reference=(1, 1, 2))
    assert "The gain of joint 3 is not shown relative to the others" in text
    assert "joint 3 not shown" in text
    assert "no two of them feel enough of the same bodies" in told((0, 1, 2))


def test_gains_that_are_far_from_the_others():
    assert "more than five times" not in told()
    text = told(first=0.19)
    assert "The gain of joint 1 is more than five times from the others'" in text


def test_what_a_common_gain_rests_on():
    common = CommonGain(factor=8.0, std=0.08, masses=(known(used=True), known("hand")))
    text = told(common=common)
    assert "The common gain rests on the payload of 1.5 kg (to 1.6 %, 90 %)" in text
    assert "joint 1 0.500 +- 0.016 per N m" in text
    assert "The mass of hand (1.5 kg) cannot fix the common gain" in text
    assert "disagree" not in text


@pytest.mark.parametrize(
    ("mass", "sentence"),
    [
        (known("hand", shown=False), "torques show it only together with moments and"),
        (known("hand", shown=False), "known payload that is picked up or put down"),
        (known("hand"), "the recording shows it too poorly"),
        (known(found=np.nan), "no change of payload was found. Record motion"),
    ],
)
def test_why_a_mass_fixes_nothing(mass, sentence):
    assert sentence in told(common=CommonGain(masses=(mass,)))


def test_masses_that_disagree():
    masses = (known(used=True), known("hand", 6.0, used=True))
    text = told(common=CommonGain(factor=7, std=0.1, masses=masses, p_value=1e-5))
    assert "The known masses disagree by more than chance" in text
    assert "the payload asks for 8 +- 0.11 and the mass of hand asks for 4" in text


def test_masses_in_another_unit_are_not_compared():
    body = BodyMass(joint=0, name="arm", mass=40.0, std=0.1, nominal=3.0, known="yes")
    outcome = make_outcome(nv=3, names=NAMES, bodies=(body,))
    assert "in the robot description" in Report(outcome).to_markdown()
    assert "in the robot description" not in told(bodies=(body,))


@pytest.mark.parametrize("n_effects", [3, 6, 12])
def test_gains_are_a_line_of_a_terminal(n_effects):
    names = tuple(f"joint{j + 1}" for j in range(6))
    gains = ChannelGains(
        joint_names=names,
        gain=np.array([0.1, 1.0, 2.0, 1.0, 1.0, 1.0]),
        std=np.full(6, 0.01),
        reference=np.array([1, 1, 1, 1, 1, 5]),
        common=CommonGain(),
    )
    effects = tuple(make_effect(k, k % 6, names) for k in range(n_effects))
    possible = tuple(make_possible(k, k + 2, names) for k in range(2))
    outcome = make_outcome(
        names=names, gains=gains, effects=effects, possible=possible, channels=()
    )
    lines = str(Report(outcome)).splitlines()
    (line,) = (x for x in lines if "Gains are relative" in x)
    assert line == (
        "Gains are relative to joint 2; not shown: joint 6; hardly credible: joint 1"
    )
    assert len(lines) <= 16 + n_effects
    # Those that are perhaps there follow the others in one line.
    first = next(k for k, x in enumerate(lines) if x[:2] == "- ")
    assert all(x[:2] == "- " for x in lines[first : first + n_effects + 1])
    assert lines[first + n_effects].endswith("%) and 1 more (page)")
    page = Report(outcome).to_html()
    assert "relative to joint 2" in page
    assert "from which those of" in page


def test_gains_in_the_dictionary():
    outcome = make_outcome(nv=3, names=NAMES)
    assert Report(outcome).to_dict()["gains"] is None
