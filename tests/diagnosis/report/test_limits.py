"""What reports say of the limits of their figures."""

from dataclasses import replace

import numpy as np
import pytest

from sklearn_vbjfa.diagnosis import Report
from sklearn_vbjfa.diagnosis.explain import (
    ConsistencyCost,
    Contradiction,
    Contradictions,
    Deviation,
    MotionLimit,
    NextRecording,
    Pushed,
)
from sklearn_vbjfa.diagnosis.report import judge, sections
from sklearn_vbjfa.recording import RepeatedMotion
from sklearn_vbjfa.robot import AlikeValue, BodyMass, Departure
from tests.diagnosis.report._outcomes import make_outcome


def sentences(heading, outcome):
    """Sentences of a section of a report."""
    found = sections(outcome, judge(outcome))
    own = (section.sentences for section in found if section.heading == heading)
    return next(own, ())


def recordings_of(outcome):
    return sentences("Limits of the recordings", outcome)


def masses_of(outcome):
    return sentences("Masses", outcome)


def price_of(outcome):
    return sentences("Price of physical consistency", outcome)


def with_band(outcome=None, **changes):
    """Sentences on an outcome whose band is another."""
    outcome = make_outcome(nv=2) if outcome is None else outcome
    outcome = replace(outcome, band=replace(outcome.band, **changes))
    told = sentences("Method", outcome)
    return " ".join(told[: [x.startswith("Held out") for x in told].index(True)])


def test_band_of_the_motion():
    after = 100 * make_outcome(nv=2).error_after.mean()
    assert with_band() == (
        "Errors are for 0 to 10 Hz (five times the motion's bandwidth: 99 % of the "
        "power of the speed of joint 2, the fastest joint, is below 2 Hz; its position "
        "is smoothed at 4.2 Hz, where the motion falls below the encoder noise). This "
        "band has over 99.9 % of the power of the speeds and 91.0 % to 97.4 % of the "
        f"power of the torques. Up to 40 Hz the error is {1.4 * after:.1f} % "
        f"({after:.1f} % in the fitted band)."
    )


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"decided_by": "given", "automatic": 3.0},
            "Errors are for 0 to 10 Hz, as was asked for; the motion asks for 3 Hz.",
        ),
        (
            {"decided_by": "given", "automatic": np.inf},
            "0 to 10 Hz, as was asked for; the motion asks for no low-pass.",
        ),
        (
            {"decided_by": "given", "automatic": np.nan, "bandwidth": np.nan},
            "Errors are for 0 to 10 Hz, as was asked for. ",
        ),
        (
            {"decided_by": "length"},
            "0 to 10 Hz: a lower limit needs a longer recording (five times the "
            "motion's bandwidth would be lower: 99 % of the power of the speed of "
            "joint 2, the fastest joint, is below 2 Hz; its",
        ),
        ({"smoothed_at": np.inf}, "joint 2, the fastest joint, is below 2 Hz). This"),
    ],
)
def test_what_decided_the_band(changes, text):
    assert text in with_band(**changes)


@pytest.mark.parametrize(
    ("decided_by", "text"),
    [
        ("none", "Nothing is filtered, as was asked for; the motion asks for 10 Hz;"),
        ("states", "States were given, which are not filtered;"),
        (
            "sample rate",
            "Nothing is filtered: five times the motion's bandwidth is too close to "
            "half the sample rate (99 % of the power of the speed of joint 2, the "
            "fastest joint, is below 2 Hz);",
        ),
    ],
)
def test_without_a_band_the_torque_as_recorded_counts(decided_by, text):
    outcome = make_outcome(nv=2, wide_cutoff=np.nan, wide_after=np.full(2, np.nan))
    changes = {"cutoff": np.inf, "decided_by": decided_by, "smoothed_at": np.inf}
    assert with_band(outcome, **changes) == (
        f"{text} errors are for all frequencies of the recording."
    )


def test_no_room_for_a_wider_band():
    outcome = make_outcome(nv=2, wide_cutoff=np.nan, wide_after=np.full(2, np.nan))
    text = with_band(outcome, sample_rate=25.0)
    assert text.endswith("At 25 samples a second there is no wider band.")
    assert "fitted band" not in text


def test_an_unknown_band_is_not_described():
    outcome = make_outcome(nv=2, band=None)
    assert "Errors are for" not in Report(outcome).to_html()


def price(**changes):
    found = ConsistencyCost(
        free=np.array([0.05, 0.19, 0.08]),
        held=np.array([0.05, 0.241, 0.09]),
        interval=np.array([[-0.01, 0.02, 0.001], [0.01, 0.07, 0.02]]),
        price=np.array([0.0, 0.051, 0.01]),
    )
    return make_outcome(nv=3, projection=replace(found, **changes))


def test_price_with_body_and_channel():
    body = Pushed(
        joint=1,
        name="forearm",
        kind="body",
        share=0.93,
        parameter="m",
        unit="kg",
        free=12.1,
        held=8.3,
        deviations=9.0,
    )
    outcome = price(pushed=(body,), channel=2, channel_share=0.88)
    assert " ".join(price_of(outcome)) == (
        "Requiring physically possible masses raises the error of joint 2 from 19.0 to "
        "24.1 % and joint 3 from 8.0 to 9.0 %: forearm (the body of joint 2) is held "
        "at the border (m 12.1 to 8.3 kg). Without the torque of joint 3 88 % of this "
        "disappears; possible causes there: a wrong gain of the torque channel, a "
        "wrong geometry or a missing effect."
    )
    assert "forearm" in Report(outcome).to_html()


def test_price_that_comes_from_nowhere_in_particular():
    assert price_of(price()) == (
        "Requiring physically possible masses raises the error of joint 2 from 19.0 to "
        "24.1 % and joint 3 from 8.0 to 9.0 %.",
        "Possible causes: a wrong gain of the torque channel, a wrong geometry or a "
        "missing effect.",
    )


def test_nothing_is_said_where_the_projection_costs_nothing():
    assert price_of(price(price=np.zeros(3))) == ()
    assert price_of(price(price=np.full(3, np.nan))) == ()
    assert price_of(make_outcome(nv=3)) == ()


def body(name, mass, nominal, known, std=np.inf):
    return BodyMass(
        joint=0, name=name, mass=mass, std=std, nominal=nominal, known=known
    )


def masses(*bodies):
    return " ".join(masses_of(make_outcome(nv=3, bodies=bodies)))


def test_masses_that_are_not_measured_are_said_to_be_so():
    text = masses(
        body("base", 9.0, 10.0, "no"),
        body("upper", 257.0, 339.0, "in combination", std=80.0),
        body("fore", 902.0, 339.0, "in combination", std=300.0),
        body("tool", 3.0, 3.1, "yes", std=0.1),
    )
    assert text == (
        "Masses that this recording does not determine: base (not at all); upper and "
        "fore (only together with others). The files hold values that agree with the "
        "torques, not measured ones: fore 902 kg, where the robot description has "
        "339 kg."
    )


def test_one_word_for_all_bodies():
    text = masses(
        body("a", 1.0, 1.0, "in combination"), body("b", 1.0, 1.1, "in combination")
    )
    assert text == (
        "Masses that this recording does not determine: all bodies (only together with "
        "others). The files hold values that agree with the torques, not measured ones."
    )


def test_measured_masses_are_compared_with_the_description():
    text = masses(
        body("slide", 94.3, 95.1, "yes", std=0.175),
        body("tool", 3.0, 2.0, "yes", std=0.1),
        body("same", 5.0, 5.1, "yes", std=0.1),
    )
    assert text == (
        "Heavier than in the robot description: tool 3.00 +- 0.16 kg instead of 2 kg; "
        "lighter than in the robot description: slide 94.3 +- 0.3 kg instead of "
        "95.1 kg."
    )


def test_known_masses_need_no_words():
    assert masses_of(make_outcome(nv=3)) == ()
    assert masses(body("same", 5.0, 5.1, "yes", std=0.1)) == ""


def limit(kind, joint=0, recordings=(0,), low=0.2, high=0.21):
    return MotionLimit(
        kind=kind, joint=joint, recordings=recordings, low=low, high=high
    )


def motion(*limits, recordings=("1",), **changes):
    outcome = make_outcome(nv=3, motion_limits=limits, recordings=recordings, **changes)
    return " ".join(recordings_of(outcome))


def test_a_joint_that_never_reverses():
    text = (
        "Joint 2 never reverses in this recording: Coulomb friction and an offset "
        "cannot be told apart, and hysteresis, backlash and friction that depends on "
        "the direction cannot be seen."
    )
    assert motion(limit("one way", 1)) == text
    several = motion(limit("one way", 1, (0, 1)), recordings=("1", "2"))
    assert several == text.replace("this recording", "any recording")
    both = motion(limit("one way", 0), limit("one way", 1))
    assert both.startswith("Joints 1 and 2 never reverse in this recording:")


def test_limits_name_the_only_recording_in_which_a_joint_moves():
    text = motion(limit("one way", 1, (2,)), recordings=("a", "b", "c"))
    assert text.startswith(
        "Joint 2 never reverses in recording c, and moves in no other: Coulomb"
    )


def test_one_speed_has_its_unit():
    assert motion(limit("one speed")) == (
        "Joint 1 keeps to one speed in this recording (0.2 to 0.21 rad/s): viscous "
        "and Coulomb friction can hardly be told apart, and what friction is at other "
        "speeds is a guess."
    )
    slides = motion(limit("one speed"), torque_units=("N", "N m", "N m"))
    assert "(0.2 to 0.21 m/s)" in slides


def test_one_pose_is_in_degrees():
    text = motion(limit("one pose", 2, (0, 1)), recordings=("1", "2"))
    assert text == (
        "Joint 3 keeps to one pose in all recordings (11.5 to 12 degrees): the weight "
        "of its link and an offset cannot be told apart, and springs and ripple cannot "
        "be seen."
    )


def contradiction(recording=0, joint=1, together=0.072):
    return Contradiction(
        recording=recording, joint=joint, alone=0.011, together=together
    )


def contradicted(*found, recordings=("1", "2", "3"), **changes):
    made = Contradictions(found=found, **changes)
    outcome = make_outcome(nv=3, contradictions=made, recordings=recordings)
    return " ".join(recordings_of(outcome))


def test_two_recordings_contradict_each_other():
    cause = deviation(1, name="gain", joints=(1,), value=1.2, log_odds=np.log(350))
    both = contradiction(), contradiction(1, 2, 0.05)
    assert contradicted(*both, recordings=("1", "2"), deviations=(cause,)) == (
        "Recordings 1 and 2 contradict each other on joints 2 and 3: a fit to "
        "recording 1 alone predicts joint 2 there to 1.1 % of its torque, one to all "
        "of them only to 7.2 % (both on parts that were not fitted). A torque of joint "
        "2 that is 1.2 times as large in recording 2 accounts for it (odds 350 : 1). "
        "No one robot has these torques: mend the recording, or identify them apart."
    )


def test_the_headline_says_so_first():
    made = Contradictions(found=(contradiction(),))
    outcome = make_outcome(nv=3, contradictions=made, recordings=("1", "2"))
    report = Report(outcome)
    first = "Recordings 1 and 2 contradict each other on joint 2. "
    assert report.headline.startswith(first)
    assert str(report).startswith(first.strip())
    plain = Report(make_outcome(nv=3)).headline
    assert report.headline == first + plain


def deviation(*recordings, name="model", joints=(0, 1, 2), **changes):
    given = {"name": name, "joints": joints, "log_odds": 20.0, **changes}
    return Deviation(recordings=recordings, **given)


def test_who_contradicts_whom():
    def told(*causes):
        return contradicted(contradiction(), deviations=causes)

    assert told(deviation(2)).startswith(
        "Recording 3 contradicts the others on joint 2: a fit"
    )
    both = told(deviation(2), deviation(0))
    assert both.startswith("Recordings 1 and 3 contradict the others on joint 2: a fit")
    assert both.count(" accounts for part of it (odds > 1e6 : 1).") == 2
    for causes in [deviation(2, 1)], [deviation(2), deviation(0, 1, 2, scatters=True)]:
        assert told(*causes).startswith("The recordings contradict each other on joint")


ALL = (0, 1, 2)


@pytest.mark.parametrize(
    ("name", "joints", "value", "text"),
    [
        ("offset", (1,), -0.5, "An offset of -0.5 N m on joint 2"),
        ("friction", (0,), np.nan, "Another friction of joint 1"),
        ("gain", ALL, np.nan, "Another gain of the torques of all joints"),
        ("payload", ALL, np.nan, "Another load"),
        ("model", ALL, np.nan, "More than a gain, an offset, friction or the load"),
    ],
)
def test_causes_in_words(name, joints, value, text):
    one = deviation(0, name=name, joints=joints, value=value)
    told = contradicted(contradiction(), deviations=(one,))
    told = told.replace(" is another in recording", " in recording")
    assert f"{text} in recording 1 accounts for it (odds > 1e6 : 1)." in told
    either = contradicted(contradiction(), deviations=(replace(one, recordings=ALL),))
    opposite = "the opposite in " if np.isfinite(value) else ""
    assert f"in recording 1 (or {opposite}2 or 3) accounts" in either
    rivals = replace(one, rivals=("gain", "friction"))
    assert "; a gain or other friction would say nearly the same)" in contradicted(
        contradiction(), deviations=(rivals,)
    )


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("offset", 0.3, "An offset of joint 2 that scatters by 0.3 N m from"),
        ("gain", 0.1, "A gain of joint 2 that scatters by 10.0 % from"),
        ("friction", np.nan, "Another friction of joint 2 from"),
    ],
)
def test_scatter_in_words(name, value, text):
    one = deviation(*ALL, name=name, joints=(1,), value=value, scatters=True)
    told = contradicted(contradiction(), deviations=(one,))
    assert f"{text} recording to recording accounts for it" in told


def test_sound_recordings_need_no_words():
    outcome = make_outcome(nv=3, recordings=("1", "2"))
    assert recordings_of(outcome) == ()


def test_repeated_motion_says_where_it_is():
    one = RepeatedMotion(seconds=9.98, count=2.0, recordings=(0, 2))
    outcome = make_outcome(repeated=(one,), recordings=("a", "b", "c"))
    (text,) = recordings_of(outcome)
    assert "one of 9.98 s, 2 times in recordings a and c. What the" in text
    whole = replace(one, recordings=(0, 1, 2), count=3.0)
    outcome = make_outcome(repeated=(whole,), recordings=("a", "b", "c"))
    (text,) = recordings_of(outcome)
    assert "one of 9.98 s, 3 times. What the" in text


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("assumed", ", assumed from other robots; record another motion to know"),
        ("mixed", " (4 left out in turn, and other robots)"),
        ("measured", " (4 left out in turn)"),
    ],
)
def test_what_the_next_recording_will_show_says_what_that_rests_on(source, said):
    one = NextRecording(
        error=np.array([0.05]),
        interval=np.array([[0.03], [0.09]]),
        mean=0.05,
        mean_interval=np.array([0.03, 0.09]),
        recordings=4,
        source=source,
    )
    outcome = make_outcome(next_recording=one)
    text = sentences("What to do next", outcome)[-1]
    assert text == f"Next recording: expect an error of 5.0 % [3.0, 9.0]{said}."
    # What is only assumed is on the page.
    shown = text in " ".join(str(Report(outcome)).split())
    assert shown == (source != "assumed")


def test_a_departure_names_its_rivals():
    one = Departure(bodies=("j2",), factors=(1.98,), stds=(0.03,), log_odds=9.0)
    (text,) = masses_of(make_outcome(departures=(one,)))
    assert text.startswith(
        "The body of j2 (1.98 +- 0.05 times) weighs not as much as in"
    )
    both = Departure(
        bodies=("j2", "j3"), factors=(1.98, 3.0), stds=(0.03, 0.6), log_odds=9.0
    )
    size, text = masses_of(make_outcome(departures=(both,), common_size=0.001))
    assert "that of j2 (1.98 +- 0.05 times) or j3 (3.0 +- 1.0 times)" in text
    assert "as much as the other bodies would have it" in text
    assert "0.001 times what the robot" in size
    assert masses_of(make_outcome(common_size=0.9)) == ()


def test_alike_joints_share_values_and_those_that_do_not_are_named():
    def shared(parameter, apart=(), joints=("j1", "j2", "j3"), scatter=0.04):
        known = {"std": 0.0003 / 1.645, "unit": "kg m^2", "value": 0.0105}
        return AlikeValue(
            group="hip",
            parameter=parameter,
            joints=joints,
            places=(),
            scatter=scatter,
            apart=apart,
            **known,
        )

    one = Departure(bodies=("j2",), factors=(1.98,), stds=(0.03,), log_odds=9.0)
    both = Departure(
        bodies=("j2", "j3"), factors=(2.0, 0.5), stds=(0.06, 0.006), log_odds=9.0
    )
    outcome = make_outcome(
        alike=(
            shared("rotor_inertia", (one,)),
            shared("my_own:k", scatter=np.nan),
            shared("viscous", (both,), joints=()),
        )
    )
    (table,) = (
        one.table
        for one in sections(outcome, judge(outcome))
        if one.heading == "Alike joints"
    )
    assert table.heads[-2:] == ("scatter between them", "how many")
    assert table.rows == (
        ("hip", "rotor inertia", "0.0105 +- 0.0003", "kg m^2", "4 %", "3"),
        ("hip", "my own", "0.0105 +- 0.0003", "kg m^2", "", "3"),
    )
    assert sentences("Alike joints", outcome) == (
        "The rotor inertia of j2 (1.98 +- 0.05 times) is not that of the other hip "
        "joints.",
        "The viscous friction of one of the hip joints is not that of the others: of "
        "j2 (2.00 +- 0.10 times) or j3 (0.500 +- 0.010 times); the torques do not tell "
        "them apart.",
    )
    assert sentences("Alike joints", make_outcome()) == ()
