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
    """Where a report comes from, as the program that ran the search knows it.

    Attributes
    ----------
    file : str or tuple of str
        Recording; the files if there were several.
    description : str
        File of the robot description.
    held : tuple of str
        Joints that were held at zero.
    warnings : tuple of str
        What the run warned of.
    files : tuple of str
        Files beside the page, which links to them.
    """

    file: str | tuple = ""
    description: str = ""
    held: tuple = ()
    warnings: tuple = ()
    files: tuple = ()


@dataclass(frozen=True, kw_only=True)
class Afterwards:
    """What is known of an effect of time after the recording.

    Attributes
    ----------
    seconds : float
        Last time of the fit [s].
    how : str
        What the effect is taken to do from then on.
    left : dict of str to float
        What is left of its coefficients at that time; empty if it stays as it is.
    intervals : dict of str to (float, float)
        Their 90 % intervals.
    """

    seconds: float
    how: str
    left: dict
    intervals: dict


@dataclass(frozen=True, kw_only=True)
class DiscoveredEffect:
    """An effect that the declared model lacked.

    Attributes
    ----------
    name : str
        Name of its class, in the library or of one's own.
    joint : int
        Joint, from zero.
    joint_name : str
        Its name.
    scope : {"joint", "robot"}
        Whether it belongs to its joint, or to the robot as a whole; its joint is the
        first one then.
    parameters : dict of str to float
        Coefficients and shape parameters, as an engineer calls them.
    units : dict of str to str
        Their units.
    intervals : dict of str to (float, float)
        90 % intervals around the parameters: Student's t, from the scatter between
        blocks of time of the completed model's residuals. A shape parameter that was
        not searched between the values of a grid has none, nor has what the recording
        does not excite, or an instant.
    evidence : Evidence
        What speaks for it: its posterior odds beside the other effects, and what it
        saves on stretches of time that were not fitted.
    rivals : tuple of str
        Other effects that this data cannot tell from it; another use of the same one
        with what sets it apart, such as "signal: voltage".
    effect : Effect
        The transformer itself.
    ranges : EffectRange or None
        Positions, speeds and loads of its joint that it was fitted on, in the model
        that is handed over.
    afterwards : Afterwards or None
        What an effect of time is taken to do after the recording; None for others.
    doubt : str
        Why it is told as "perhaps" only; empty for one that has a name.
    """

    name: str
    joint: int
    joint_name: str
    parameters: dict
    units: dict
    intervals: dict
    evidence: Evidence
    rivals: tuple = ()
    effect: object = None
    scope: str = "joint"
    ranges: EffectRange | None = None
    afterwards: Afterwards | None = None
    doubt: str = ""

    @property
    def log_odds(self):
        """Logarithm of the posterior odds that the declared model lacked it [nats]."""
        return self.evidence.log_odds

    @property
    def probability(self):
        """Probability that the declared model lacked it.

        The posterior one, or the probability that it lowers the error on stretches of
        time that were not fitted, if that is less.
        """
        return self.evidence.probability


@dataclass(frozen=True, kw_only=True)
class Trial:
    """What would have taken the place of an effect.

    Attributes
    ----------
    name : str
        Effect.
    joint : int
        Joint, from zero.
    shape : dict
        Shape parameters of its best variant.
    log_odds : float
        Logarithm of the posterior odds in that place [nats].
    """

    name: str
    joint: int
    shape: dict
    log_odds: float


@dataclass(frozen=True, kw_only=True)
class Round:
    """One step of the path to the most probable model.

    Attributes
    ----------
    action : {"add", "replace", "drop"}
        What was done.
    name : str
        Effect.
    joint : int
        Joint, from zero.
    joint_name : str
        Its name.
    shape : dict
        Shape parameters.
    replaced : str
        What it replaced; empty otherwise.
    log_odds : float
        Logarithm of the posterior odds of the effect beside the others as they were
        then [nats]: above zero for what came, below for what went.
    rivals : tuple of Trial
        What would have come in its place within the rivals' nats.
    """

    action: str
    name: str
    joint: int
    joint_name: str
    shape: dict
    replaced: str
    log_odds: float
    rivals: tuple


@dataclass(frozen=True, kw_only=True)
class Unexplained:
    """What remains of a joint's residual above the noise and has no name.

    Attributes
    ----------
    joint : int
        Joint, from zero.
    joint_name : str
        Its name.
    rms, floor : float
        Out-of-sample residual and noise floor [N m or N]; the floor is nan if unknown.
    share : float
        Share of the residual's mean square above the floor.
    of_torque : float
        Root mean square of what is above the floor over the spread of the torque, on
        the untouched part (on the search part where the untouched one shows nothing
        above the floor, or is too short); of the whole residual, if the floor is
        unknown.
    signals : tuple of Dependence
        Signals that it varies with, the strongest first.
    """

    joint: int
    joint_name: str
    rms: float
    floor: float
    share: float
    of_torque: float
    signals: tuple[Dependence, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Ceiling:
    """How much of a joint's residual a function of any form explains.

    Of its own speed and load; of its own state and history; of the states and loads of
    all joints. Each includes the signals of the one before.

    Attributes
    ----------
    joint : int
        Joint, from zero.
    joint_name : str
        Its name.
    within : tuple of 3 float
        Shares of the squared residual that functions fitted to other blocks of time
        explain; zero where that is no more than chance.
    across : tuple of 3 float
        The same of functions fitted to other recordings, as far as these reach the
        joint's speeds and loads; nan if that is less than half of the time, or there is
        only one recording.
    share : tuple of 3 float
        What repeats: the smaller of those that are known.
    """

    joint: int
    joint_name: str
    within: tuple
    across: tuple
    share: tuple = field(init=False)

    def __post_init__(self):
        share = tuple(map(float, np.fmin(self.within, self.across)))
        object.__setattr__(self, "share", share)


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """An effect that this data cannot show.

    Attributes
    ----------
    name : str
        Effect.
    joint : int
        Joint, from zero.
    joint_name : str
        Its name.
    reason : {"span", "excitation", "signal", "together"}
        It lies in the span of the declared columns whatever the motion; it does so in
        this recording; it needs a signal that is not there; or it shows, but only
        together with another effect.
    remedy : str
        What to record; the name of the other effect.
    """

    name: str
    joint: int
    joint_name: str
    reason: str
    remedy: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """Everything that a discovery found out; the report is made from it.

    Attributes
    ----------
    declared : dict
        The declared model: robot, joints, friction, number of parameters, cut-off.
    effects : tuple of DiscoveredEffect
        Effects that have a name.
    perhaps : tuple of DiscoveredEffect
        Effects that are more probable than not and have none; they are part of the
        completed model.
    rounds : tuple of Round
        The path of the search.
    unexplained : tuple of Unexplained
        Joints that stay above their noise floor.
    ceiling : tuple of Ceiling
        What functions of any form explain on joints above their floor that move for
        long enough; empty if that was not asked for.
    hidden : tuple of Hidden
        Effects that could not be looked for.
    channels : tuple of ChannelFinding
        What is wrong with channels of the recording.
    joint_names : tuple of str
        Joints.
    torque_units : tuple of str
        Units of the torques, "N m" or "N".
    unsearched : tuple of int
        Joints whose channels show too little to be searched.
    added : tuple of str
        Plain terms that were fitted on every joint beyond what was declared.
    error_before, error_plain, error_after : ndarray of shape (nv,)
        Errors on the untouched part, over `spread`: declared, with the four plain
        terms, completed.
    spread : ndarray of shape (nv,)
        Standard deviation of the torque in the moving time of the whole recording
        [N m or N].
    wide_before, wide_plain, wide_after : ndarray of shape (nv,)
        Errors on the untouched part in a wider band than that of the fit, over the same
        spread; nan where there is none.
    wide_cutoff : float
        Where that band ends [Hz]; nan where there is none.
    seconds : ndarray of shape (nv,)
        Untouched time in which each joint moves [s].
    enough : ndarray of shape (nv,), bool
        Whether that is enough for a verdict.
    intervals : dict of str to ndarray of shape (2, nv)
        Where the errors ``"before"``, ``"plain"``, ``"after"``, and after minus before
        (``"difference"``) and minus plain (``"added"``), over the next 50 s of the same
        motion lie in 90 % of cases.
    floor : ndarray of shape (nv,)
        Noise floor over the spread.
    library : dict of str to Effect
        What was looked for, by name: it says what an effect is called and what to
        record to see it.
    settings : dict
        Thresholds, split, blocks, what intervals are of, seed, versions.
    band : Band or None
        The band of the fit; None if nothing is known of it.
    projection : ProjectionPrice or None
        What physically consistent parameters cost; None if they were not asked for.
    recordings : tuple of str
        What each recording is called.
    motion_limits : tuple of MotionLimit
        What joints do in no recording.
    next_recording : NextRecording or None
        Error to expect on a recording that was not fitted.
    repeated : tuple of RepeatedMotion
        Motion that was recorded more than once.
    contradictions : Contradictions
        Recordings that are not of one robot.
    bodies : tuple of BodyMass
        Masses of the model that is handed over, and which of them are known.
    curves : dict
        Residuals and signals for pictures; "seconds" is the time in the untouched
        part, its recordings joined [s]; "maps" has a `Map` of some joints, "effects"
        an `EffectCurves` or None of each effect, "line" the `TimeLine`.
    outside : tuple of OutsideRange
        Where the untouched part leaves what the judged model was fitted on.
    gains : ChannelGains or None
        Gains of the torque channels in the model that is handed over; None unless they
        were unknown.
    corrections : Corrections
        What effects in the model that is handed over ask for: of the base, of encoders,
        of axes, of torque channels.
    departures : tuple of Departure
        Bodies that are not as described; see `RobotIdentifier.departures_`.
    common_size : float
        How many times as heavy all bodies together are as described.
    parameters : tuple of ParameterValue
        Parameters of the model that is handed over.
    recorded : RecordedMotion or None
        What was recorded.
    provenance : Provenance or None
        File, joints held and warnings, as the program that ran the search knows them.
    """

    declared: dict
    effects: tuple
    perhaps: tuple
    rounds: tuple
    unexplained: tuple
    ceiling: tuple
    hidden: tuple
    channels: tuple
    joint_names: tuple
    torque_units: tuple
    unsearched: tuple
    added: tuple
    error_before: object
    error_plain: object
    error_after: object
    spread: object
    wide_before: object
    wide_plain: object
    wide_after: object
    wide_cutoff: float
    seconds: object
    enough: object
    intervals: dict
    floor: object
    library: dict
    settings: dict
    band: Band | None = None
    projection: ProjectionPrice | None = None
    recordings: tuple = ()
    motion_limits: tuple = ()
    next_recording: NextRecording | None = None
    repeated: tuple = ()
    contradictions: Contradictions = field(default_factory=Contradictions)
    bodies: tuple = ()
    curves: dict = field(default_factory=dict)
    outside: tuple = ()
    gains: ChannelGains | None = None
    corrections: Corrections = field(default_factory=Corrections)
    departures: tuple = ()
    common_size: float = 1.0
    parameters: tuple[ParameterValue, ...] = ()
    recorded: RecordedMotion | None = None
    provenance: Provenance | None = None


def named_beside(effect, chosen, names):
    """Name an effect beside another, with its joint where that is a different one."""
    if effect.joint == chosen.joint or effect.scope == "robot":
        return effect.told_beside(chosen)
    return f"{effect.told_beside(chosen)} on {names[effect.joint]}"
