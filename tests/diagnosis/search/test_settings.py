"""SearchSettings."""

from dataclasses import FrozenInstanceError, asdict, fields, replace

import numpy as np
import pytest
from sklearn.base import clone

from sklearn_vbjfa import EffectDiscovery
from sklearn_vbjfa.diagnosis import SearchSettings
from tests.diagnosis._recordings import SPRINGY
from tests.diagnosis.report._pages import text_of


def discover(library=SPRINGY.library, **options):
    loop = EffectDiscovery(SPRINGY.robot(), effects=library, **options)
    return loop.fit(SPRINGY.position, SPRINGY.torque)


NAMES = [field.name for field in fields(SearchSettings)]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [0, np.nan, np.inf, "1", True])
def test_invalid_values_are_rejected(name, value):
    expected = "a positive integer" if name == "most" else "positive"
    with pytest.raises(
        ValueError, match=f"{name} of SearchSettings must be {expected}"
    ):
        SearchSettings(**{name: value})


def test_shares_are_below_one_and_most_is_a_whole_number():
    for name in ("min_probability", "min_gain"):
        message = f"{name} of .* positive and below 1; got 1.0"
        with pytest.raises(ValueError, match=message):
            SearchSettings(**{name: 1.0})
    with pytest.raises(ValueError, match="most of SearchSettings must be a positive"):
        SearchSettings(most=2.5)
    assert SearchSettings(most=np.int64(3)).most == 3


def test_settings_are_keyword_only_and_immutable():
    with pytest.raises(TypeError):
        SearchSettings(1.0)
    with pytest.raises(FrozenInstanceError):
        SearchSettings().expected = 2.0
    assert SearchSettings() == SearchSettings(expected=1.0)
    assert hash(SearchSettings()) == hash(SearchSettings())


def test_invalid_settings_are_rejected():
    with pytest.raises(ValueError, match=r"settings.*SearchSettings"):
        discover(settings={"expected": 1.0})


def test_clone_keeps_the_settings(springy):
    settings = SearchSettings(expected=0.5)
    loop = EffectDiscovery(SPRINGY.robot(), settings=settings)
    assert clone(loop).settings == settings
    assert loop.get_params(deep=False)["settings"] == settings
    assert clone(springy).settings is None
    # None means the defaults.
    assert springy.report_.outcome.provenance["settings"]["search"] == asdict(
        SearchSettings()
    )


def test_report_contains_the_settings(springy):
    settings = springy.report_.to_dict()["provenance"]["settings"]
    assert settings["n_candidates"] == 4
    assert settings["search"]["expected"] == 1.0
    assert settings["search"]["min_gain"] == 0.02
    text = text_of(springy.report_)
    assert "An effect is reported if its probability is at least 95 % and" in text
    assert "significantly and by at least 2 %. Of 4 candidates, 1 is expected" in text


@pytest.mark.slow
def test_prior_odds_are_proportional_to_expected_effects(springy):
    half = discover(settings=SearchSettings(expected=0.5))
    (first,), (second,) = springy.effects_, half.effects_
    assert second.log_odds == pytest.approx(first.log_odds - np.log(2.0), abs=1e-6)
    assert second.parameters == first.parameters
    assert half.report_.to_dict()["provenance"]["settings"]["search"]["expected"] == 0.5
    text = text_of(half.report_)
    assert "candidates, 0.5 is expected a priori" in text


@pytest.mark.slow
def test_min_gain_and_significance_are_required(springy):
    (effect,) = springy.effects_
    for name, value in (
        ("min_gain", 0.5 * (1 + effect.evidence.gain)),
        ("significance", 1.1 * effect.evidence.errors),
    ):
        loop = discover(settings=replace(SearchSettings(), **{name: value}))
        assert loop.effects_ == ()
        (possible,) = loop.possible_
        assert possible.warning not in ("", "undecided")
        # The model is the same.
        assert (loop.error_after_ == springy.error_after_).all()
