"""What the search for effects found, in the form in which it is read."""

from dataclasses import dataclass, field

import numpy as np

from sklearn_vbjfa.diagnosis.explain._band import Band
from sklearn_vbjfa.diagnosis.explain._contradictions import Contradictions
from sklearn_vbjfa.diagnosis.explain._dependence import Dependence
from sklearn_vbjfa.diagnosis.explain._identified import ParameterValue, RecordedMotion
from sklearn_vbjfa.diagnosis.explain._next_recording import NextRecording
from sklearn_vbjfa.diagnosis.explain._price import ProjectionPrice
from sklearn_vbjfa.diagnosis.search._found import Evidence
from sklearn_vbjfa.effects import EffectRange
from sklearn_vbjfa.robot._corrections import Corrections
from sklearn_vbjfa.robot._gains import ChannelGains


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Where a report comes from, as the program that ran the search knows it."""

    file: str | tuple = ""  # recording; the files if there were several
    description: str = ""  # its file
    held: tuple = ()  # joints that were held at zero
    warnings: tuple = ()  # what the run warned of
    files: tuple = ()  # files beside the page, which links to them


@dataclass(frozen=True, kw_only=True)
class Afterwards:
    """What is known of an effect of time after the recording."""

    seconds: float  # last time of the fit [s]
    how: str  # what the effect is taken to do from then on
    # what is left of its coefficients at that time; empty if it stays as it is
    left: dict
    intervals: dict  # 90 %


@dataclass(frozen=True, kw_only=True)
class DiscoveredEffect:
    """An effect that the declared model lacked."""

    name: str  # of its class, in the library or of one's own
    joint: int  # from zero
    joint_name: str
    parameters: dict  # coefficients and shape parameters, as an engineer calls them
    units: dict
    # 90 %: Student's t, from the scatter between blocks of time of the completed
    # model's residuals; none for a shape parameter that was not searched on, what the
    # recording does not excite, and an instant
    intervals: dict
    # posterior odds, and what it saves on stretches of time that were not fitted
    evidence: Evidence
    # effects that this data cannot tell from it; another use of the same one with what
    # sets it apart, such as "signal: voltage"
    rivals: tuple = ()
    effect: object = None  # the transformer itself
    # whether it belongs to its joint, or to the robot as a whole; its joint is the
    # first one then
    scope: str = "joint"
    # positions, speeds and loads of its joint that it was fitted on, in the model that
    # is handed over
    ranges: EffectRange | None = None
    # what an effect of time is taken to do after the recording
    afterwards: Afterwards | None = None
    doubt: str = ""  # why it is told as "perhaps" only; empty for one that has a name

    @property
    def log_odds(self):
        """Logarithm of the posterior odds that the declared model lacked it [nats]."""
        return self.evidence.log_odds

    @property
    def probability(self):
        """Probability that the declared model lacked it."""
        # The posterior one, or the probability that it lowers the error on stretches of
        # time that were not fitted, if that is less.
        return self.evidence.probability


@dataclass(frozen=True, kw_only=True)
class Trial:
    """What would have taken the place of an effect."""

    name: str
    joint: int  # from zero
    shape: dict  # parameters of its best variant
    log_odds: float  # posterior, in that place [nats]


@dataclass(frozen=True, kw_only=True)
class Round:
    """One step of the path to the most probable model."""

    action: str
    name: str
    joint: int  # from zero
    joint_name: str
    shape: dict  # parameters
    replaced: str  # empty otherwise
    # posterior, beside the others as they were then [nats]: above zero for what came,
    # below for what went
    log_odds: float
    rivals: tuple  # what would have come in its place within the rivals' nats


@dataclass(frozen=True, kw_only=True)
class Unexplained:
    """What remains of a joint's residual above the noise and has no name."""

    joint: int  # from zero
    joint_name: str
    # out-of-sample residual and noise floor [N m or N]; the floor is nan if unknown
    rms: float
    floor: float
    share: float  # share of the residual's mean square above the floor
    # root mean square of what is above the floor over the spread of the torque, on the
    # untouched part (on the search part where the untouched one shows nothing above the
    # floor, or is too short); of the whole residual, if the floor is unknown
    of_torque: float
    # signals that it varies with, the strongest first
    signals: tuple[Dependence, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Ceiling:
    """How much of a joint's residual a function of any form explains."""

    # Of its own speed and load; of its own state and history; of the states and loads
    # of all joints. Each includes the signals of the one before.

    joint: int  # from zero
    joint_name: str
    # shares of the squared residual that functions fitted to other blocks of time
    # explain; zero where that is no more than chance
    within: tuple
    # same of functions fitted to other recordings, as far as these reach the joint's
    # speeds and loads; nan if that is less than half of the time, or for one recording
    across: tuple
    # what repeats: the smaller of those that are known
    share: tuple = field(init=False)

    def __post_init__(self):
        share = tuple(map(float, np.fmin(self.within, self.across)))
        object.__setattr__(self, "share", share)


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """An effect that this data cannot show."""

    name: str
    joint: int  # from zero
    joint_name: str
    # it lies in the span of the declared columns whatever the motion; it does so in
    # this recording; it needs a signal that is not there; or it shows, but only
    # together with another effect
    reason: str
    remedy: str = ""  # what to record; the name of the other effect


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """Everything that a discovery found out; the report is made from it."""

    # declared model: robot, joints, friction, number of parameters, cut-off
    declared: dict
    effects: tuple  # those that have a name
    # those that are more probable than not and have none; in the completed model too
    perhaps: tuple
    rounds: tuple  # the path of the search
    unexplained: tuple  # joints that stay above their noise floor
    # what functions of any form explain on joints above their floor; empty if not asked
    # for
    ceiling: tuple
    hidden: tuple  # effects that could not be looked for
    channels: tuple  # what is wrong with channels of the recording
    joint_names: tuple
    torque_units: tuple  # "N m" or "N"
    unsearched: tuple  # joints whose channels show too little to be searched
    added: tuple  # plain terms that were fitted on every joint beyond what was declared
    # (nv,): errors on the untouched part over `spread`: declared, plain, completed
    error_before: object
    error_plain: object
    error_after: object
    # (nv,): deviation of the torque in the moving time of the whole recording [N m or
    # N]
    spread: object
    # (nv,): errors in a wider band than that of the fit; nan for none
    wide_before: object
    wide_plain: object
    wide_after: object
    wide_cutoff: float  # where that band ends [Hz]; nan for none
    seconds: object  # (nv,): untouched time in which each joint moves [s]
    enough: object  # (nv,): whether that is enough for a verdict
    # (2, nv): where the errors ``"before"``, ``"plain"``, ``"after"``, and after minus
    # before (``"difference"``) and minus plain (``"added"``), over the next 50 s of the
    # same motion lie in 90 % of cases
    intervals: dict
    floor: object  # (nv,): noise floor over the spread
    # what was looked for, by name: what an effect is called and what to record
    library: dict
    settings: dict  # thresholds, split, blocks, what intervals are of, seed, versions
    band: Band | None = None  # of the fit; None if nothing is known of it
    # what physically consistent parameters cost; None if they were not asked for
    projection: ProjectionPrice | None = None
    recordings: tuple = ()  # what each recording is called
    motion_limits: tuple = ()  # what joints do in no recording
    next_recording: NextRecording | None = None
    repeated: tuple = ()  # motion that was recorded more than once
    # recordings that are not of one robot
    contradictions: Contradictions = field(default_factory=Contradictions)
    # masses of the model that is handed over, and which of them are known
    bodies: tuple = ()
    # residuals and signals for pictures; "seconds" is the time in the untouched part,
    # its recordings joined [s]; "maps" has a `Map` of some joints, "effects" an
    # `EffectCurves` or None of each effect, "line" the `TimeLine`
    curves: dict = field(default_factory=dict)
    # where the untouched part leaves what the judged model was fitted on
    outside: tuple = ()
    # those of the torque channels in the model that is handed over, if unknown
    gains: ChannelGains | None = None
    # what effects in the model that is handed over ask for
    corrections: Corrections = field(default_factory=Corrections)
    # bodies that are not as described; see `RobotIdentifier.departures_`
    departures: tuple = ()
    # how many times as heavy all bodies together are as described
    common_size: float = 1.0
    parameters: tuple[ParameterValue, ...] = ()  # of the model that is handed over
    recorded: RecordedMotion | None = None
    provenance: Provenance | None = None


def named_beside(effect, chosen, names):
    """Name an effect beside another, with its joint where that is a different one."""
    if effect.joint == chosen.joint or effect.scope == "robot":
        return effect.told_beside(chosen)
    return f"{effect.told_beside(chosen)} on {names[effect.joint]}"
