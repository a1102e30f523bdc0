"""The report of a search for effects, as data, page and terminal text."""

import dataclasses
import math
import numbers
from dataclasses import replace
from functools import partial

import numpy as np
from sklearn.base import BaseEstimator

from sklearn_vbjfa.diagnosis.explain import NO_INFORMATION
from sklearn_vbjfa.diagnosis.report import _facts
from sklearn_vbjfa.diagnosis.report import _words as words
from sklearn_vbjfa.diagnosis.report._render import Renderer
from sklearn_vbjfa.diagnosis.report._verdict import NO_ANSWER, judge

_USE = ("name", "allowed", "reason")


class Report:
    """Result of a search for effects.

    ``print(report)`` is for a terminal 80 characters wide: the verdict, the error of
    each joint, the effects and the next steps. All details are on the page of
    `to_html`, which a notebook shows.

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
        verdict = judge(outcome)
        self._renderer = Renderer(outcome, verdict)
        say = self._renderer
        self.status = verdict.status
        joints, uses = verdict.joints, verdict.uses
        self.joints = tuple(replace(x, text=say("joint_text", x)) for x in joints)
        self.uses = tuple(replace(x, reason=say("use_reason", x)) for x in uses)
        self.headline = say("headline")
        self.verdict = f"{self.headline} {say('errors')}".rstrip()
        self.warnings = self._warnings(verdict.faults)
        texts = {"verdict": self.verdict, "joint_verdicts": self.joints}
        self._renderer.values |= texts | {"uses": self.uses}

    def _warnings(self, faults):
        """List the warnings that forbid a use, inconsistent recordings first."""
        say, findings, robot = self._renderer, self.outcome.findings, self.outcome.robot
        channels = [c for c in findings["channels"] if c.kind in NO_INFORMATION]
        excused = set().union(*(c.joints for c in channels))
        unusable = [
            joint
            for joint in self.joints
            if joint.status in NO_ANSWER
            or joint.detail == "large"
            or (joint.status == "unsearched" and joint.joint not in excused)
        ]
        joints = [
            f"{text} ({words.joint_list(robot['joints'], [x.joint for x in same], 0)})"
            for text, same in _facts.grouped(unusable, partial(say, "warning_text"))
        ]
        contradictions = [say("contradiction")] if findings["contradictions"] else []
        kinds = ("gains_unknown", "gains_hidden", "masses_unused")
        kinds = kinds if robot["gains"] else ("far_masses",)
        values = filter(None, map(say, ("law_fails", "bodies_apart", *kinds)))
        uninformative = [c.message for c in channels if c.severity == "warning"]
        export = self.outcome.provenance.get("export", ())
        return (*faults, *contradictions, *joints, *values, *uninformative, *export)

    @property
    def has_open_questions(self):
        """Whether another motion could answer open questions of this recording."""
        return bool(self._renderer.values["wanted"])

    def __reduce__(self):
        # Templates cannot be pickled.
        return type(self), (self.outcome,)

    def __repr__(self):
        count = words.plural(len(self.outcome.findings["effects"]), "effect")
        return f"<Report: {self.status}, {count}>"

    def __str__(self):
        return self._renderer.text()

    def to_dict(self):
        """Return everything but the curves, ready for `json.dumps`.

        Returns
        -------
        dict
            The content of ``report.json``, described in "Your robot": the verdict
            (``status``, ``headline``, ``verdict``, ``uses``, ``warnings``), ``errors``
            with a row for each joint, the findings by kind (``effects``, ``possible``,
            ``unexplained``, ``not_identifiable``, ``channels`` and others), ``facts``,
            ``robot`` and ``provenance``. Lists replace arrays, None replaces nan,
            joints count from zero, and values are in SI units.
        """
        outcome = self.outcome
        data = {
            "status": self.status,
            "headline": self.headline,
            "verdict": self.verdict,
            "uses": [{k: getattr(x, k) for k in _USE} for x in self.uses],
            "warnings": self.warnings,
            "joint_names": [joint.name for joint in outcome.errors],
            "errors": outcome.errors,
            **outcome.findings,
            "facts": outcome.facts,
            # The library consists of classes, used for their texts.
            "robot": {k: x for k, x in outcome.robot.items() if k != "library"},
            "provenance": outcome.provenance,
        }
        data = _json(data)
        for row, item in zip(data["errors"], self.joints):
            row |= {"status": item.status, "text": item.text}
        for key in ("effects", "possible"):
            for row, item in zip(data[key], outcome.findings[key]):
                row |= {"log_odds": item.log_odds, "probability": item.probability}
        return data

    def to_html(self):
        """Return the report as one self-contained page.

        Returns
        -------
        str
            HTML with its style and pictures inside; nothing is loaded from elsewhere.
        """
        return self._renderer.page()

    def _repr_html_(self):
        return self._renderer.page(whole=False)


def _json(value):
    """Convert a value to JSON types; nan and infinity become None."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    elif dataclasses.is_dataclass(value):
        value = {x.name: getattr(value, x.name) for x in dataclasses.fields(value)}
    elif isinstance(value, BaseEstimator):
        parameters = value.get_params(deep=False)
        value = {"class": type(value).__name__, "parameters": parameters}
    if isinstance(value, dict):
        return {str(key): _json(x) for key, x in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_json(x) for x in value]
    if value is None or isinstance(value, bool | str | int):
        return value
    if isinstance(value, numbers.Real):
        return float(value) if math.isfinite(value) else None
    return str(value)
