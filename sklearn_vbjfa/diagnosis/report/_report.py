"""The report of a search for effects: verdict first, then the evidence."""

import dataclasses
import functools
import math
import numbers

import numpy as np
from sklearn.base import BaseEstimator

from sklearn_vbjfa.diagnosis.report import (
    _evidence,
    _findings,
    _limits,
    _render,
    _uses,
    _verdict,
)
from sklearn_vbjfa.diagnosis.report import _words as words

# Fields of an outcome that `to_dict` leaves out: pictures, and classes for the words.
_NOT_DATA = ("curves", "library")

# Functions of the outcome and the verdict on it, each of which returns a section.
SECTIONS = (
    _verdict.headline,
    _verdict.joints,
    _findings.effects,
    _findings.possible,
    _findings.to_do,
    _render.paragraph(
        "Drive", _limits.drive_sentences, terminal_of=_limits.drive_found
    ),
    _limits.channel_gains,
    _evidence.commands_alone,
    _evidence.effect_pictures,
    _evidence.torques,
    _evidence.friction,
    _evidence.spectra,
    _findings.unexplained,
    _findings.hidden,
    _render.paragraph("Limits of the recordings", _limits.recording_sentences),
    _findings.outside,
    _render.paragraph("Cost of physical consistency", _limits.projection_sentences),
    _render.paragraph("Masses", _limits.mass_sentences),
    _limits.alike,
    _evidence.parameters,
    _evidence.provenance,
    _evidence.method,
)


def sections(outcome, verdict):
    """Return the sections that have something to show, in order."""
    found = [make(outcome, verdict) for make in SECTIONS]
    return _render.explained(s for s in found if s.sentences or s.table or s.drawn)


class Report:
    """What a robot model lacked, what that was worth, and what is still open.

    ``print(report)`` is for a terminal 80 characters wide: the verdict, the error of
    each joint, the effects and what to do next. All else is on the page of `to_html`,
    which a notebook shows.

    Parameters
    ----------
    outcome : Outcome
        What the search found.

    Attributes
    ----------
    outcome : Outcome
        The same.
    joints : tuple of JointVerdict
        Verdict on each joint.
    status : {"complete", "nothing", "partial", "exhausted", "unsettled", "unknown", \
            "worse", "failed", "no data", "unsearched", "faulty"}
        Effects found and only noise left; nothing was missing; effects found and
        something remains; nothing found though something is missing; at the noise
        floor in the search but not on held-out data; no noise floor to compare with;
        a joint got worse on held-out data; a joint is predicted worse than by its
        mean torque; nothing to judge by; no torque shows enough to be searched; a
        channel of the recording is wrong.
    headline, verdict : str
        The same in words, without and with the mean errors.
    uses : tuple of Use
        Feedforward, simulation, collision detection and link masses, each with `name`,
        `allowed` and `reason`.

    See Also
    --------
    sklearn_vbjfa.EffectDiscovery : Makes reports.
    """

    def __init__(self, outcome):
        self.outcome = outcome
        self._verdict = _verdict.judge(outcome)
        self.joints = self._verdict.joints
        self.status = self._verdict.status
        self.headline = self._verdict.headline
        self.verdict = self._verdict.text
        self.uses = _uses.uses(outcome, self._verdict)

    def __repr__(self):
        errors = self._verdict.errors
        count = words.plural(len(self.outcome.effects), "effect")
        return (
            f"<Report: {self.status}, {count}, mean error "
            f"{words.percent(errors.before)} before, {words.percent(errors.after)} "
            "after>"
        )

    def __str__(self):
        return _render.plain_text(self._sections)

    @functools.cached_property
    def _sections(self):
        # A command prints some of them and writes all to a page.
        return sections(self.outcome, self._verdict)

    def to_dict(self):
        """Return everything but the curves, ready for `json.dumps`.

        Returns
        -------
        dict
            Lists instead of arrays, None instead of nan, joints from zero.
            ``"effects"`` have a name,
            ``"possible"`` are more probable than not and have none; both with
            ``"log_odds"`` and ``"probability"``. Values are in SI units; an effect
            of the robot model has them in degrees, mm or per cent as well, under
            ``"plain"``, and ``"corrections"`` has what is to be changed: the tilt of
            the base, zeros of encoders, axes and gains of torque channels.
        """
        data = {
            "status": self.status,
            "headline": self.headline,
            "verdict": self.verdict,
            "joints": _json(self.joints),
            "uses": _json(self.uses),
        }
        for field in dataclasses.fields(self.outcome):
            if field.name not in _NOT_DATA:
                data[field.name] = _json(getattr(self.outcome, field.name))
        for key in ("effects", "possible"):
            for told, effect in zip(data[key], getattr(self.outcome, key)):
                told |= {"log_odds": effect.log_odds, "probability": effect.probability}
                if _findings.in_model(self.outcome, effect):
                    told["plain"] = _json(_findings.plain_values(effect))
        return data

    def to_html(self):
        """Return the report as one self-contained page.

        Returns
        -------
        str
            HTML with its style and pictures inside; nothing is loaded from elsewhere.
        """
        return _render.page(self._sections)

    def _repr_html_(self):
        return _render.fragment(self._sections)


def _json(value):
    """Turn a value into what JSON knows; nan and infinity become None."""
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, numbers.Integral):
        return int(value)
    if isinstance(value, numbers.Real):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.ndarray):
        return _json(value.tolist())
    if isinstance(value, dict):
        return {str(key): _json(one) for key, one in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [_json(one) for one in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {
            field.name: _json(getattr(value, field.name))
            for field in dataclasses.fields(value)
        }
    if isinstance(value, BaseEstimator):
        parameters = value.get_params(deep=False)
        return {"class": type(value).__name__, "parameters": _json(parameters)}
    return str(value)
