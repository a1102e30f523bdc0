"""Ranges of the parameters of an identified robot, for domain randomisation."""

from dataclasses import asdict, dataclass
from numbers import Real

import numpy as np

from sklearn_vbjfa._core import write_whole
from sklearn_vbjfa.robot._channels import note_of_units
from sklearn_vbjfa.robot._model_file import readable
from sklearn_vbjfa.robot._posterior import Posterior

FORMAT, VERSION = "sklearn_vbjfa ranges", 1
# Values of `known_` for parameters that the recordings do not determine.
_NOT_MEASURED = ("no", "from the description")


@dataclass(frozen=True, kw_only=True)
class ParameterRange:
    """Range of one parameter in a robot's next recording."""

    name: str  # as in `parameter_names_`
    joint: str  # empty for a parameter of the whole robot
    unit: str  # of all values
    value: float  # of the identified robot, `theta_`
    # ends of the interval; nan for an undetermined parameter
    lower: float
    upper: float
    # standard deviations within recordings (`theta_std_`) and between recordings,
    # before truncation; zero for a single recording
    within: float
    between: float
    known: str  # as in `IdentifiedRobot.known_`


@dataclass(frozen=True, kw_only=True, eq=False)
class Ranges:
    """Ranges of all parameters of an identified robot.

    `RobotIdentifier.ranges` makes them. They are iterated in the order of the
    parameters, and indexed by their names.

    Attributes
    ----------
    level : float
        Probability that the next recording's value of a parameter is in its range.
    recordings : int
        Recordings, or groups of them, whose scatter the ranges have; one if none.
    parameters : tuple of ParameterRange
        In the order of `parameter_names_`: `name`, `joint`, `unit`, `value`, the ends
        `lower` and `upper`, the standard deviations `within` and `between` recordings,
        and whether the recordings determine it, `known`.
    note : str
        Units of the values, if they are not SI units.

    Examples
    --------
    With the robot of the example of `RobotIdentifier`:

    >>> ranges = robot.ranges(level=0.9)
    >>> len(ranges.parameters), ranges.recordings
    (84, 2)
    >>> ranges["joint_1:viscous"].unit
    'N m s/rad'
    """

    level: float
    recordings: int
    parameters: tuple
    note: str = ""

    def __iter__(self):
        return iter(self.parameters)

    def __getitem__(self, name):
        """Return the `ParameterRange` of a name."""
        return {one.name: one for one in self.parameters}[name]

    def save(self, path):
        """Write the parameters that the recordings determine to a JSON file.

        Parameters
        ----------
        path : str or os.PathLike
            File to write, see ``docs/simulation.rst``.
        """
        content = {
            "format": FORMAT,
            "version": VERSION,
            "level": self.level,
            "recordings": self.recordings,
            "note": self.note,
            "values": [
                asdict(one)
                for one in self.parameters
                if np.isfinite(one.upper - one.lower) and one.known not in _NOT_MEASURED
            ],
        }
        write_whole(path, f"{readable(content)}\n")


def ranges_of(robot, level):
    is_number = isinstance(level, Real) and not isinstance(level, bool)
    if not (is_number and 0 < level < 1):
        raise ValueError(
            "level must be a probability between 0 and 1, such as 0.9 for 5 % of the "
            f"values on each side; got {level!r}."
        )
    posterior, between = Posterior.of(robot), robot.recording_variance
    settings, count = (robot, posterior, float(level)), robot.theta_.size
    return Ranges(
        level=float(level),
        recordings=1 if between is None else between.count,
        parameters=tuple(_range_of(*settings, k) for k in range(count)),
        note=note_of_units(robot.gains_),
    )


def _range_of(robot, posterior, level, k):
    marginal, ends = posterior.marginal(k), (np.nan, np.nan)
    if marginal is not None:
        ends = marginal.quantiles([0.5 - level / 2, 0.5 + level / 2])
    name = robot.parameter_names_[k]
    joint = name.partition(":")[0]
    return ParameterRange(
        name=name,
        joint=joint if joint in robot.joint_names_ else "",
        unit=robot.parameter_units_[k],
        value=float(robot.theta_[k]),
        lower=float(ends[0]),
        upper=float(ends[1]),
        within=float(robot.theta_std_[k]),
        between=float(posterior.between_std[k]),
        known=robot.known_[k],
    )
