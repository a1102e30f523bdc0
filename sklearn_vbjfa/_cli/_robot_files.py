"""Files of an identified robot."""

import csv
import math

from sklearn_vbjfa._cli._input import no_formula
from sklearn_vbjfa.diagnosis.explain import parameter_values

# The parameters, and the robot: as a description, for MuJoCo, and with everything that
# was identified.
ROBOT_FILES: tuple[str, ...] = (
    "parameters.csv",
    "identified.urdf",
    "identified.xml",
    "identified.json",
)
_COLUMNS: tuple[str, ...] = ("parameter", "value", "unit", "std", "identifiable")
_COLUMNS += ("description", "scatter")
# Effects that a line names.
_NAMED = 3


def write_robot(robot, folder):
    """Write the robot; return a line for each file with the effects that it lacks."""
    _write_parameters(robot, folder / "parameters.csv")
    robot.save(folder / "identified.json")
    lacking = {
        "identified.urdf": robot.to_urdf(folder / "identified.urdf"),
        "identified.xml": robot.to_mjcf(folder / "identified.xml"),
    }
    lines = []
    for name, effects in lacking.items():
        named = [f"{one.name} on {one.joint_name}" for one in effects[:_NAMED]]
        named += [f"{len(effects) - _NAMED} more"] if len(effects) > _NAMED else []
        if named:
            lines.append(
                f"{name} has no place for {', '.join(named)}; its first lines list "
                "why, and identified.json has all."
            )
    return lines


def _write_parameters(robot, path):
    """Write one row per parameter, and those of values that joints share."""
    relative = ""
    if robot.gains_ is not None and not robot.gains_.absolute:
        names = [robot.joint_names_[j] for j in robot.gains_.references]
        relative = f", times the gain of {' or '.join(names) or 'each channel'}"
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(_COLUMNS)
        for name, value, unit, *rest in (*_parameters(robot), *_shared(robot)):
            if unit.startswith(("N", "kg")):
                unit += relative
            row = [name, value, unit, *rest]
            table.writerow([no_formula(_text(cell)) for cell in row])


def _text(cell):
    """Write a cell; one without a finite number is empty."""
    if isinstance(cell, str):
        return cell
    return repr(float(cell)) if math.isfinite(cell) else ""


def _parameters(robot):
    """Yield the rows of the parameters."""
    facts = parameter_values(robot)
    for one, std in zip(facts, robot.theta_std_):
        row = [one.name, one.value, one.unit, std, one.source]
        yield [*row, one.described, math.nan]


def _shared(robot):
    """Yield the rows of values that joints share."""
    for one in robot.alike_:
        row = [f"{one.group}:{one.parameter}", one.value, one.unit, one.std]
        yield [*row, "yes", math.nan, one.scatter]
