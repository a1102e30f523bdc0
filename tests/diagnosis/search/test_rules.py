"""Every rule of the search, on recordings that come out otherwise without it."""

import numpy as np
import pytest

pytest.importorskip("pinocchio")

from sklearn_vbjfa import effects
from sklearn_vbjfa.diagnosis.search import _search, _split
from tests.diagnosis._recordings import record
from tests.diagnosis.search._searches import CLEAN, search
from tests.diagnosis.search._searches import coulomb as coulomb_of

ONE = record("Y", seed=0, duration=24.0)
# The search sees the first three quarters.
SEARCHED = 18.0
GRAVITY = 9.81


@pytest.fixture(autouse=True, scope="module")
def at_the_end():
    """One untouched stretch, at the end: rules are told by what they have before it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_split, "_STRETCHES", 1)
        yield


def ripple(r):
    return np.cos(9.0 * r.q[:, 0])


def coulomb(r):
    return np.sign(r.v[:, 0])


def carried(r, begin, end=np.inf):
    """Torque of a mass on the arm between two times."""
    there = (r.t > begin) & (r.t < end)
    return 0.06 * GRAVITY * np.sin(r.q[:, 0]) * there


def close(torque, library, **given):
    return ONE.discover(ONE.torque(joint_1=torque), library, **given)


def story(loop):
    return [(r.action, r.name) for r in loop.rounds_]


def names(loop):
    return [e.name for e in loop.effects_]


@pytest.fixture(scope="module")
def far():
    """Search for a counterbalance that rises over most of the range: a spring first."""
    return close(
        lambda r: 3.0 * np.sin(2 * r.q[:, 0] + 0.8),
        ["spring", "counterbalance"],
    )


def test_the_plainer_effect_goes_first_and_is_dropped_once_superfluous(far):
    assert story(far) == [
        ("add", "spring"),
        ("add", "counterbalance"),
        ("drop", "spring"),
    ]
    assert names(far) == ["counterbalance"]


def test_an_offset_that_a_spring_holds_is_the_spring_s():
    """Whatever was fitted on the joint before: all of the constant is told with it."""
    loop = close(lambda r: 2.0 * (r.q[:, 0] + 1.0), ["spring", "offset", "coulomb"])
    assert story(loop) == [("add", "spring")]
    (spring,) = loop.effects_
    assert spring.parameters["k"] == pytest.approx(2.0, rel=0.05)
    assert spring.parameters["q0"] == pytest.approx(-1.0, rel=0.1)
    low, high = spring.intervals["q0"]
    assert low < -1.0 < high
    assert 0.5 * (low + high) == pytest.approx(spring.parameters["q0"])


def test_what_does_harm_on_later_data_is_refused():
    loop = close(lambda r: 2.0 * ripple(r) * (r.t < 0.6 * SEARCHED), ["ripple"])
    assert story(loop) == [("refuse", "ripple")]
    assert names(loop) == []
    (step,) = loop.rounds_
    assert step.rule == _search.HARM
    assert np.isnan(step.level)
    assert step.n_tests == 0
    # However much it explains of the data that it was found in.
    assert step.tried[0].evidence.gain > 0.25


def test_an_effect_of_time_must_help_on_later_data():
    """A load that is half put down again: with it the rest is as bad as without."""
    loop = close(lambda r: carried(r, 9.0, 13.5) + 0.65 * carried(r, 13.5), ["payload"])
    assert story(loop) == [("refuse", "payload")]
    (step,) = loop.rounds_
    assert step.rule == _search.LATER
    assert (step.level, step.n_tests) == (0.05, 1)
    assert step.evidence.p_value >= step.level
    # No harm, as anything else is asked for.
    assert step.evidence.gain > -step.evidence.gain_std


@pytest.mark.parametrize("begin", [9.0, 14.0])
def test_late_loads_are_tried_on_still_later_data(begin):
    loop = close(lambda r: carried(r, begin), ["payload"])
    assert names(loop) == ["payload"]
    assert loop.effects_[0].parameters["instant"] == pytest.approx(begin, abs=0.2)
    # What was there for a while only does not hold.
    middle = 0.5 * (begin + SEARCHED)
    loop = close(lambda r: carried(r, begin, middle), ["payload"])
    assert names(loop) == []


def test_what_begins_at_the_very_end_cannot_be_tried(monkeypatch):
    """All later than the last block: refused, not waved through."""
    monkeypatch.setattr(_search, "_ACTIVE", 30)
    loop = close(lambda r: carried(r, 14.0), ["payload"])
    assert names(loop) == []
    (step,) = loop.rounds_
    assert (step.action, step.rule) == ("refuse", _search.TOO_LATE)


def test_a_refused_effect_gets_another_trial_beside_another_model_only():
    """And its p-value is doubled by every trial."""
    loop = close(
        lambda r: 2.0 * ripple(r) * (r.t < 0.6 * SEARCHED) + 3.0 * r.q[:, 0],
        ["ripple", "spring"],
    )
    assert names(loop) == ["spring"]
    assert story(loop) == [
        ("refuse", "ripple"),
        ("add", "spring"),
        ("refuse", "ripple"),
    ]


# -- levels


def test_rounds_say_the_rule_and_the_level_that_were_applied(far):
    by_action = {r.action: r for r in far.rounds_}
    for step in far.rounds_:
        if step.action == "add" and step.rule == _search.STEP_UP:
            # Those that pass it, of which each has raised it.
            passing = len(step.tried)
            assert step.level == pytest.approx(0.05 * passing / step.n_tests)
            assert all(t.evidence.p_value < step.level for t in step.tried)
            assert step.evidence.p_value < step.level
    assert all(r.level <= 0.05 for r in far.rounds_ if r.action == "add")
    drop = by_action["drop"]
    assert drop.rule == _search.ABSORBED
    assert np.isnan(drop.level)
    assert drop.evidence.gain < 0.01


def test_what_is_superfluous_is_dropped_by_its_own_rule():
    torque = CLEAN.torque(joint_2=coulomb_of(1.0), joint_1=lambda r: 2.0 * r.q[:, 0])
    now = search(torque, ["spring", "ripple", "coulomb"])
    spring, ripple = effects.Spring(0), effects.Ripple(0, period=0.4)
    now.accept([spring, effects.Coulomb(1), ripple])
    now.prune()
    assert [effect.name for effect in now.model.effects] == ["spring", "coulomb"]
    (step,) = now.steps
    assert (step.action, step.effect) == ("drop", ripple)
    assert step.rule.name == _search.SUPERFLUOUS
    assert step.evidence.p_value >= step.rule.level or step.evidence.gain < 0.01


def test_alpha_is_the_level():
    """The same recording at two levels, between which its p-value lies."""

    def torque(r):
        return 0.35 * ripple(r) * (r.t % 6.0 < 2.0)

    found = close(torque, ["ripple"], alpha=0.5)
    p_value = found.rounds_[0].evidence.p_value
    assert found.rounds_[0].action in ("add", "refuse")
    assert found.rounds_[0].level == pytest.approx(0.5)
    assert close(torque, ["ripple"], alpha=p_value / 2).rounds_ == ()
    again = close(torque, ["ripple"], alpha=min(2 * p_value, 0.9))
    assert again.rounds_[0].tried[0].evidence.p_value == pytest.approx(p_value)


def test_the_report_prints_what_was_applied(far):
    text = " ".join(str(far.report_).split())
    settings = far.report_.to_dict()["settings"]
    assert settings["rule"] == _search.STEP_UP
    level, count = settings["last_level"], settings["last_n_tests"]
    assert level * count / 0.05 == pytest.approx(round(level * count / 0.05))
    said = f"Named: {_search.STEP_UP}, alpha 0.05 (last round: p < {level:.2g}, "
    assert said in text
    markdown = far.report_.to_markdown()
    for step, told in zip(far.rounds_, far.report_.to_dict()["rounds"]):
        level = None if np.isnan(step.level) else step.level
        assert (told["rule"], told["level"]) == (step.rule, level)
        if level is not None:
            assert f"{step.rule} (p \\< {step.level:.2g}" in markdown
    assert _search.ABSORBED in " ".join(far.report_.to_html().split())


# -- what is left


@pytest.mark.parametrize("size", [0.03, 0.1])
def test_the_unexplained_share_is_that_of_the_mean_square(size):
    """A vibration of known size over white noise of known size."""
    loop = close(lambda r: size * np.sqrt(2) * np.sin(10.7 * r.t), ["coulomb"])
    (rest,) = loop.unexplained_
    assert rest.share == pytest.approx(1 - (rest.floor / rest.rms) ** 2)
    assert rest.rms**2 == pytest.approx(size**2 + rest.floor**2, rel=0.15)
    # the noise of one recording is not quite its expectation, which is the floor
    assert rest.share == pytest.approx(size**2 / rest.rms**2, abs=0.15)


def test_the_report_says_where_a_recording_is_too_short():
    rng = np.random.default_rng(0)
    walk = 0.03 * np.cumsum(rng.normal(size=ONE.t.size))
    loop = close(lambda r: walk, ["offset", "drift"])
    assert names(loop) == []
    settings = loop.report_.to_dict()["settings"]
    ((joint, seconds),) = settings["too_short"]
    assert joint == 0
    assert seconds is None or seconds > SEARCHED / 12
    for text in (str(loop.report_), loop.report_.to_markdown()):
        said = " ".join(text.split())
        assert "Too short for the residual of joint 1, which stays correlated" in said
    assert "Too short" in loop.report_.to_html()
    clean = close(lambda r: 0.0, ["offset", "drift"])
    assert clean.report_.to_dict()["settings"]["too_short"] == []
    assert "Too short" not in str(clean.report_)


def test_slow_noise_does_not_hide_fast_effects_nor_make_slow_ones():
    rng = np.random.default_rng(3)
    keep = np.exp(-0.02 / 5.0)
    noise = np.zeros(ONE.t.size)
    for i in range(1, noise.size):
        noise[i] = keep * noise[i - 1] + np.sqrt(1 - keep**2) * rng.normal()
    library = ["drift", "payload", "ripple", "viscous_quadratic", "spring"]
    assert names(close(lambda r: noise, library)) == []
    # Half of the noise.
    size = 0.5 * np.sqrt(2)
    found = close(lambda r: noise + size * ripple(r), library)
    assert names(found) == ["ripple"]
    low, high = found.effects_[0].intervals["A"]
    assert low < size < high
    assert low > 0


def named_too_early():
    """Coulomb friction that looked quadratic while a spring was missing."""
    torque = ONE.torque(joint_1=lambda r: 2.0 * r.q[:, 0] + coulomb(r))
    now = search(torque, ["coulomb", "viscous_quadratic", "spring"], ONE)
    assert now.threshold == now.alpha
    now.accept(())
    now.accept([effects.ViscousQuadratic(0), effects.Spring(0)])
    return now


def test_what_was_named_before_its_rivals_had_a_place_is_replaced():
    now = named_too_early()
    now.compete(0)
    assert [e.name for e in now.model.effects] == ["spring", "coulomb"]
    (step,) = now.steps
    assert (step.action, step.effect.name) == ("replace", "coulomb")
    assert step.replaced.name == "viscous_quadratic"
    assert (step.rule.name, step.rule.level) == (_search.BETTER, 0.05)
    assert step.evidence.p_value < step.rule.level


def test_the_search_does_not_run_in_circles():
    """Nothing is taken back and found again, and no replacement leads back."""
    once, now = named_too_early(), named_too_early()
    once.compete(0)
    # As if the search had been there before.
    there = _search.keys_of(once.model.effects)
    now.been.add(there)
    now.compete(0)
    assert _search.keys_of(now.model.effects) != there

    recording = record("Y", seed=1, duration=20.0, noise=0.1)

    def torque(r):
        return 0.73 * np.cos(2.0 * r.q[:, 0]) + 0.3 * r.v[:, 0] * np.abs(r.v[:, 0])

    loop = recording.discover(
        recording.torque(joint_1=torque),
        ["spring", "stribeck", "viscous_quadratic"]
        + ["asymmetric_friction", "counterbalance", "ripple"],
    )
    assert sorted(names(loop)) == ["counterbalance", "viscous_quadratic"]
    added = [r.name for r in loop.rounds_ if r.action in ("add", "replace")]
    assert len(added) == len(set(added))


def test_trials_after_a_refusal_double_the_p_value():
    torque = ONE.torque(joint_1=lambda r: 0.1 * ripple(r))
    now = search(torque, ["ripple"], ONE)
    now.accept(())

    def p_value():
        tried, _ = now.try_joint(0, now.model)
        return tried["ripple"].evidence.p_value

    first = p_value()
    assert 0 < first < 0.1
    now.refusals[("ripple", 0, ())] = 2
    assert p_value() / first == pytest.approx(4)
    # What was refused is not offered again beside the same model.
    now.refused.add(("ripple", 0, ()))
    assert now.try_joint(0, now.model)[0] == {}
