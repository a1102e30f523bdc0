"""The report of a search for effects: data, a page and a terminal of one outcome."""

import dataclasses
import functools
import math
import numbers

import numpy as np
from sklearn.base import BaseEstimator

from sklearn_vbjfa.diagnosis.report import _facts
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.report._render import Voice
from sklearn_vbjfa.diagnosis.report._verdict import NO_ANSWER, judge

# Fields of an outcome with a value for each joint, by their names in `to_dict`.
_OF_JOINTS = {
    "before": "error_before",
    "plain": "error_plain",
    "after": "error_after",
    "floor": "floor",
    "wide": "wide_after",
    "spread": "spread",
    "seconds": "seconds",
    "enough": "enough",
}
# Fields that `to_dict` leaves out: pictures, and classes for the words.
_NOT_DATA = ("curves", "expectation", "library", "intervals", *_OF_JOINTS.values())
# Channels with these faults are left out of what was asked for.
_LEFT_OUT = ("coarse_torque", "still_joint")


class Report:
    """Result of a search for effects.

    ``print(report)`` is for a terminal 80 characters wide: the verdict, the error of
    each joint, the effects and the next steps. All else is on the page of `to_html`,
    which a notebook shows.

    Parameters
    ----------
    outcome : Outcome
        Result of the search.

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
    warnings : tuple of str
        Warnings that forbid a use; the command line then ends with exit code 3.

    See Also
    --------
    sklearn_vbjfa.EffectDiscovery : Makes reports.
    """

    def __init__(self, outcome):
        self.outcome = outcome
        found = judge(
            outcome, functools.partial(words.joint_label, outcome.joint_names)
        )
        self._errors, self._voice = found.errors, Voice(outcome, found)
        say = self._voice
        self.status = found.status
        self.joints = tuple(
            dataclasses.replace(one, text=say("joint_text", one))
            for one in found.joints
        )
        self.uses = tuple(
            one
            if one.allowed
            else dataclasses.replace(one, reason=say("use_reason", one))
            for one in found.uses
        )
        self.headline = say("headline")
        self.verdict = f"{self.headline} {say('errors')}".rstrip()
        gains = [] if outcome.gains is None else self._gains()
        self._voice.tell(
            verdict=self.verdict,
            joint_verdicts=self.joints,
            uses=self.uses,
            gain_warnings=gains,
        )
        self.warnings = self._warnings(gains)

    def _gains(self):
        """Name gains that are unknown or implausible, and masses that do not help."""
        say, masses = self._voice, self.outcome.gains.common.masses
        told = [say("gains_unknown"), say("gains_hidden"), say("gains_far")]
        told += [say("mass_unused", known) for known in masses]
        return list(filter(None, [*told, say("masses_disagree")]))

    def _warnings(self, gains):
        """Name what forbids a use, faults of the recording first."""
        channels = self.outcome.channels
        joints = _facts.grouped(
            (one for one in self.joints if one.status in NO_ANSWER),
            lambda one: one.text,
        )
        names = self.outcome.joint_names
        apart = self.outcome.contradictions.found
        return (
            *([self._voice("contradiction")] if apart else []),
            *(c.message for c in channels if c.severity != "warning"),
            *(
                f"{text} ({words.joint_list(names, [one.joint for one in own], 0)})"
                for text, own in joints
            ),
            *gains,
            *(
                c.message
                for c in channels
                if c.severity == "warning" and c.kind in _LEFT_OUT
            ),
        )

    @property
    def has_open_questions(self):
        """Whether another motion could decide what this recording leaves open."""
        outcome = self.outcome
        return bool(
            outcome.unexplained
            or any(effect.rivals for effect in outcome.effects)
            or any(one.reason == "excitation" for one in outcome.hidden)
        )

    def __reduce__(self):
        # Templates are no data.
        return type(self), (self.outcome,)

    def __repr__(self):
        count = words.plural(len(self.outcome.effects), "effect")
        return (
            f"<Report: {self.status}, {count}, mean error "
            f"{words.percent(self._errors.before)} before, "
            f"{words.percent(self._errors.after)} after>"
        )

    def __str__(self):
        return self._voice.text()

    def to_dict(self):
        """Return everything but the curves, ready for `json.dumps`.

        Returns
        -------
        dict
            Lists instead of arrays, None instead of nan, joints from zero.
            ``"errors"`` has a row for each joint: the errors ``before``, ``plain`` and
            ``after`` and the noise ``floor`` over the ``spread`` of the torque [N m or
            N], their ``intervals``, and the verdict.
            ``"effects"`` are reported,
            ``"possible"`` are more probable than not; both with
            ``"log_odds"`` and ``"probability"``. Values are in SI units; an effect
            of the robot model has them in degrees, mm or per cent as well, under
            ``"plain"``, and ``"corrections"`` has what is to be changed: the tilt of
            the base, zeros of encoders, axes and gains of torque channels.
        """
        data = {
            "status": self.status,
            "headline": self.headline,
            "verdict": self.verdict,
            "errors": [self._row(one) for one in self.joints],
            "uses": [
                {"name": x.name, "allowed": x.allowed, "reason": x.reason}
                for x in self.uses
            ],
            "warnings": list(self.warnings),
        }
        for field in dataclasses.fields(self.outcome):
            if field.name not in _NOT_DATA:
                data[field.name] = _json(getattr(self.outcome, field.name))
        for key in ("effects", "possible"):
            for told, effect in zip(data[key], getattr(self.outcome, key)):
                told |= {"log_odds": effect.log_odds, "probability": effect.probability}
                if _facts.in_model(self.outcome, effect):
                    told["plain"] = _json(_facts.plain_values(effect))
        return data

    def _row(self, verdict):
        """Return the errors of a joint and the verdict on it."""
        outcome, j = self.outcome, verdict.joint
        row = {"joint": outcome.joint_names[j], "unit": outcome.torque_units[j]}
        row |= {key: getattr(outcome, name)[j] for key, name in _OF_JOINTS.items()}
        ends = {key: x[:, j] for key, x in outcome.intervals.items()}
        row |= {"intervals": ends, "status": verdict.status, "text": verdict.text}
        return _json(row | {"n_effects": verdict.n_effects})

    def to_html(self):
        """Return the report as one self-contained page.

        Returns
        -------
        str
            HTML with its style and pictures inside; nothing is loaded from elsewhere.
        """
        return self._voice.page()

    def _repr_html_(self):
        return self._voice.page(whole=False)


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
