"""Consistency checks for every report."""

import numpy as np

from sklearn_vbjfa.diagnosis.report import _facts, words
from sklearn_vbjfa.effects import InModel
from tests.diagnosis.report._pages import section_of, text_of


def assert_consistent(report):
    """Check odds, intervals, gains, verdict and remedies against each other."""
    outcome = report.outcome
    effects, possible = (outcome.findings[k] for k in ("effects", "possible"))
    settings = outcome.provenance["settings"]
    search = settings["search"]
    for effect in effects:
        text = f"{effect.name} on joint {effect.joint}: {effect.evidence}"
        assert effect.warning == "", text
        assert effect.probability >= 1 - settings["alpha"] - 1e-12, text
        assert effect.evidence.errors > search["significance"], text
        assert effect.evidence.gain > search["min_gain"], text
        assert _is_known(effect), f"{text}, {effect.intervals}"
    for effect in possible:
        text = f"{effect.name} on joint {effect.joint}: {effect.evidence}"
        assert effect.warning, text
        assert effect.evidence.probability >= search["min_probability"], text
    for effect in (*effects, *possible):
        for key, (low, high) in effect.intervals.items():
            assert np.isfinite([low, high]).all(), key
            assert low <= effect.parameters[key] <= high, key
        assert settings["n_candidates"] > 0
    keys = {(e.name, e.joint, str(e.parameters)) for e in (*effects, *possible)}
    assert len(keys) == len(effects) + len(possible)
    text = set(_facts.remedies(outcome, report.status))
    uncertain = {(e.name, e.joint) for e in possible}
    assert not text & uncertain, f"to be corrected on a possible: {text & uncertain}"
    _assert_words(report)


def _is_known(effect):
    """Whether the interval of one parameter excludes its neutral value."""
    idle, shape = {}, set()
    if effect.effect is not None:
        shape = set(effect.effect.shape())
        if isinstance(effect.effect, InModel):
            idle = dict(zip(effect.effect.coefficients, effect.effect.nominal))
    ends = {k: v for k, v in effect.intervals.items() if k not in shape}
    ends = ends or effect.intervals
    # Parameters may have no interval. With a tuned shape, only products of parameters
    # may be identifiable.
    return (
        not ends
        or bool(shape & effect.intervals.keys())
        or any(
            low > idle.get(key, 0.0) or high < idle.get(key, 0.0)
            for key, (low, high) in ends.items()
        )
    )


def _assert_words(report):
    """Compare the printed report with the outcome."""
    findings, data = report.outcome.findings, report.to_dict()
    page = text_of(report)
    for key in ("effects", "possible"):
        effects = findings[key]
        for saved, effect in zip(data[key], effects, strict=True):
            assert saved["log_odds"] == effect.log_odds
            assert saved["probability"] == effect.probability
    for effect in findings["effects"]:
        odds = words.odds_text(effect.log_odds)
        gain = words.whole_percent(effect.evidence.gain)
        assert not odds.startswith(("1 :", "<")), odds
        assert odds in page
        assert gain in page
    for effect in findings["possible"]:
        assert effect.warning in page
    assert bool(section_of(report, "Possible effects")) == bool(findings["possible"])
    missing = section_of(report, r"Effects that were \w+")
    assert bool(missing) == bool(findings["effects"])
    headline = report.headline
    if findings["effects"] or findings["possible"]:
        assert "othing is missing" not in headline, headline
    if report.status in ("complete", "partial"):
        assert findings["effects"], headline
        fell = "missing" in headline
        assert fell != ("though the held-out error did not fall" in headline), headline
    if report.status in ("nothing", "exhausted"):
        assert not findings["effects"], headline
