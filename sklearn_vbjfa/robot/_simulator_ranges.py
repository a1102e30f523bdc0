"""Ranges of the values of an identified robot, in the words of simulators."""

from dataclasses import dataclass
from numbers import Real

import numpy as np

from sklearn_vbjfa._core import write_whole
from sklearn_vbjfa.model._trees import is_prismatic
from sklearn_vbjfa.robot._channels import note_of_units
from sklearn_vbjfa.robot._posterior import Posterior

FORMAT, VERSION = "sklearn_vbjfa ranges", 1
# What simulators call a value: MuJoCo an attribute of a joint or its actuator, Isaac
# Lab a field of an actuator's configuration, Genesis a method of an entity. By the name
# behind the joint, by its beginning (an effect), or by its end (a coefficient).
_PROGRAMS = "mujoco", "isaac_lab", "genesis"
_WORDS = {
    "rotor_inertia": ("armature", "armature", "set_dofs_armature"),
    "viscous": ("damping", "viscous_friction", "set_dofs_damping"),
    "coulomb": (
        "frictionloss",
        "friction and dynamic_friction",
        "set_dofs_frictionloss",
    ),
    "spring:k": ("stiffness", None, "set_dofs_stiffness"),
    "kp": ("kp", "stiffness", "set_dofs_kp"),
    "kd": ("kv", "damping", "set_dofs_kv"),
    "delay": ("delay", "min_delay and max_delay, in steps of the physics", None),
}
_BY_EFFECT = ("rotor_inertia", "viscous", "coulomb")
_BY_COEFFICIENT = ("kp", "kd", "delay")
# Why a value is left out of a file.
_LEFT_OUT = {
    "no": "no torque of the recordings depends on it significantly",
    "from the description": "its value is that of the description more than a measured "
    "one",
}


@dataclass(frozen=True, kw_only=True)
class ParameterRange:
    """Range of one parameter in a robot's next recording."""

    name: str  # as in `parameter_names_`
    joint: str  # empty if it is of the robot as a whole
    unit: str  # of all values
    value: float  # of the identified robot, `theta_`
    # ends of the interval; nan where nothing tells the parameter
    lower: float
    upper: float
    # of the distribution that has these ends
    mean: float
    std: float
    # deviations within recordings (`theta_std_`) and from recording to recording,
    # before anything is cut off; zero for a single recording
    within: float
    between: float
    known: str  # as in `IdentifiedRobot.known_`, or "given" for a setting of the drive
    nonnegative: bool  # whether negative values are cut off

    @property
    def measured(self):
        """Whether the recordings determine it, individually or in combination."""
        return self.known not in _LEFT_OUT

    @property
    def words(self):
        """What MuJoCo, Isaac Lab and Genesis call it, a dict; None for no name."""
        own = self.name.removeprefix(f"{self.joint}:").split(":")
        found = _WORDS.get(":".join(own))
        if found is None and own[0] in _BY_EFFECT:
            found = _WORDS[own[0]]
        if found is None and own[-1] in _BY_COEFFICIENT:
            found = _WORDS[own[-1]]
        return dict(zip(_PROGRAMS, found or (None, None, None)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Ranges:
    """Ranges of all parameters of an identified robot.

    `RobotIdentifier.ranges` makes them. They are iterated over and indexed by the names
    of the parameters.

    Attributes
    ----------
    level : float
        Probability that the next recording's value of a parameter is in its range.
    recordings : int
        Recordings, or groups of them, whose scatter the ranges have; one if none.
    parameters : tuple of ParameterRange
        In the order of `parameter_names_`: `name`, `joint`, `unit`, `value`, ends
        `lower` and `upper`, `mean`, `std`, and whether it is `known`.
    correlation : ndarray of shape (p, p)
        Their correlations; nan for those that do not vary.
    joint_names : tuple of str
        The joints.
    torque_units : tuple of {"N m", "N"}
        Units of their torques.
    notes : tuple of str
        What else a reader of the values has to know.
    given : tuple of ParameterRange
        Gains of a `PDDrive`, and its delay if that is known: values without a range,
        for which the others were found.

    Examples
    --------
    With the robot of the example of `RobotIdentifier`:

    >>> ranges = robot.ranges(level=0.9)
    >>> len(ranges), ranges.recordings
    (84, 2)
    >>> ranges["joint_1:viscous"].words["mujoco"]
    'damping'
    """

    level: float
    recordings: int
    parameters: tuple
    correlation: np.ndarray
    joint_names: tuple
    torque_units: tuple
    notes: tuple = ()
    given: tuple = ()

    def __iter__(self):
        """Iterate over the parameters."""
        return iter(self.parameters)

    def __len__(self):
        """Count the parameters."""
        return len(self.parameters)

    def __getitem__(self, name):
        """Return the `ParameterRange` of a name."""
        for one in (*self.parameters, *self.given):
            if one.name == name:
                return one
        raise KeyError(name)

    def to_json(self):
        """Return the ranges as JSON by joint, the text of a ``ranges.json``."""
        # What reads a robot imports it.
        from sklearn_vbjfa.robot._model_file import readable

        return f"{readable(self._content())}\n"

    def save(self, path):
        """Write the ranges to a file, ``ranges.json``.

        Parameters
        ----------
        path : str or os.PathLike
            File to write, see ``docs/simulation.rst``.
        """
        write_whole(path, self.to_json())

    def _content(self):
        taken = [k for k, one in enumerate(self) if _has_place(one)]
        left = [one for one in self if not _has_place(one)]
        joints = [
            {"name": name, "torque_unit": unit, **self._values(taken, name)}
            for name, unit in zip(self.joint_names, self.torque_units)
        ]
        return {
            "format": FORMAT,
            "version": VERSION,
            "level": self.level,
            "recordings": self.recordings,
            "notes": list(self.notes),
            "joints": joints,
            "robot": self._values(taken, ""),
            "left_out": [
                {
                    "parameter": one.name,
                    "reason": _LEFT_OUT.get(one.known, "its deviation is not known"),
                }
                for one in left
            ],
        }

    def _values(self, taken, joint):
        own = [k for k in taken if self.parameters[k].joint == joint]
        among = self.correlation[np.ix_(own, own)].copy()
        # What does not vary goes together with nothing.
        among[np.isnan(among)] = 0.0
        np.fill_diagonal(among, 1.0)
        given = [_value(one) for one in self.given if one.joint == joint]
        return {
            "values": [_value(self.parameters[k]) for k in own],
            "correlation": among.tolist(),
            **({"given": given} if given else {}),
        }


def _has_place(one):
    finite = np.isfinite([one.lower, one.upper, one.std]).all()
    return bool(finite and one.measured)


def _value(one):
    return {
        "parameter": one.name,
        **one.words,
        "unit": one.unit,
        "distribution": _distribution(one),
        "value": one.value,
        "low": one.lower,
        "high": one.upper,
        "mean": one.mean,
        "std": one.std,
        "std_within_recordings": one.within,
        "std_between_recordings": one.between,
        "known": one.known,
    }


def _distribution(one):
    if one.known == "given":
        return "fixed"
    kind = "normal" if one.between == 0 else "mixture of normals"
    return f"{kind}, cut off at zero" if one.nonnegative else kind


def ranges_of(robot, level, drive=None):
    """Return the `Ranges` of an `IdentifiedRobot`, with the settings of a `PDDrive`."""
    is_number = isinstance(level, Real) and not isinstance(level, bool)
    if not (is_number and 0 < level < 1):
        raise ValueError(
            "level must be a probability between 0 and 1, such as 0.9 for 5 % of the "
            f"values on each side; got {level!r}."
        )
    posterior, level = Posterior.of(robot), float(level)
    kinds = is_prismatic(robot.features_.model_)
    note = note_of_units(robot.gains_).replace("This file", "These values")
    return Ranges(
        level=level,
        recordings=1
        if robot.recording_variance is None
        else robot.recording_variance.count,
        parameters=tuple(
            _range_of(robot, posterior, k, level) for k in range(robot.theta_.size)
        ),
        correlation=posterior.correlation(),
        joint_names=robot.joint_names_,
        torque_units=tuple("N" if slides else "N m" for slides in kinds),
        notes=(note,) if note else (),
        given=() if drive is None else tuple(_given(robot.joint_names_, kinds, drive)),
    )


def _given(names, kinds, drive):
    units = {"kp": ("N m/rad", "N/m"), "kd": ("N m s/rad", "N s/m")}
    for (word, unit), gains in zip(units.items(), drive.law(names)):
        for name, slides, gain in zip(names, kinds, gains.tolist()):
            yield _fixed(f"{name}:{word}", name, unit[int(slides)], gain)
    if drive.waits is not None:
        yield _fixed("drive:delay", "", "s", drive.waits)


def _fixed(name, joint, unit, value):
    where = dict.fromkeys(("value", "lower", "upper", "mean"), value)
    spread = dict.fromkeys(("std", "within", "between"), 0.0)
    return ParameterRange(
        name=name,
        joint=joint,
        unit=unit,
        known="given",
        nonnegative=value >= 0,
        **where,
        **spread,
    )


def _range_of(robot, posterior, k, level):
    found, ends, mean, spread = posterior.marginal(k), (np.nan, np.nan), np.nan, np.nan
    if found is not None:
        ends = found.quantiles([0.5 - level / 2, 0.5 + level / 2])
        mean, spread = found.moments()
    name = robot.parameter_names_[k]
    joint = name.partition(":")[0]
    return ParameterRange(
        name=name,
        joint=joint if joint in robot.joint_names_ else "",
        unit=robot.parameter_units_[k],
        value=float(robot.theta_[k]),
        lower=float(ends[0]),
        upper=float(ends[1]),
        mean=float(mean),
        std=float(spread),
        within=float(robot.theta_std_[k]),
        between=float(posterior.off[k]),
        known=robot.known_[k],
        nonnegative=bool(posterior.nonnegative[k]),
    )
