"""Files of an identified robot."""

import csv

import numpy as np

from sklearn_vbjfa._cli._input import no_formula

# The parameters, and the robot: as a description, for MuJoCo, and with everything that
# was identified.
ROBOT_FILES: tuple[str, ...] = ("parameters.csv", "identified.urdf", "identified.xml")
ROBOT_FILES += ("identified.json",)
_COLUMNS: tuple[str, ...] = (
    "parameter",
    "value",
    "unit",
    "std",
    "identifiable",
    "known",
)
_COLUMNS += ("description", "description_std", "learned", "scatter")


# Effects that a line names.
_NAMED = 3


def write_robot(robot, folder):
    """Write the robot; return a line for each file with the effects that it lacks."""
    from sklearn_vbjfa.diagnosis.explain._identified import parameter_values

    _write_parameters(robot, parameter_values(robot), folder / "parameters.csv")
    robot.save(folder / "identified.json")
    return _left_out(
        {
            "identified.urdf": robot.to_urdf(folder / "identified.urdf"),
            "identified.xml": robot.to_mjcf(folder / "identified.xml"),
        }
    )


def _left_out(files):
    """Return a line for each file with the effects that it lacks."""
    # files: dict of str to tuple of LeftOut, by the names of the files.
    lines = []
    for name, left in files.items():
        if not left:
            continue
        named = [f"{one.name} on {one.joint_name}" for one in left[:_NAMED]]
        more = len(left) - len(named)
        named += [f"{more} more"] if more else []
        lines.append(
            f"{name} has no place for {', '.join(named)}; its first lines list why, "
            "and identified.json has all."
        )
    return lines


def _write_parameters(robot, values, path):
    """Write one row per parameter; cells without a finite number are empty."""
    # values: of `parameter_values`. Those that alike joints share come last.
    from sklearn_vbjfa.diagnosis.explain._identified import alike_values

    relative = ""
    if robot.gains_ is not None and not robot.gains_.absolute:
        names = [robot.joint_names_[j] for j in robot.gains_.references]
        relative = " or ".join(names) or "each channel"

    def cells(one, std, identifiable, scatter=np.nan):
        unit = one.unit
        if relative and unit.startswith(("N", "kg")):
            unit = f"{unit}, times the gain of {relative}"
        numbers = (one.value, std, one.nominal, one.before, one.learned, scatter)
        value, std, *rest = (repr(float(x)) if np.isfinite(x) else "" for x in numbers)
        alone = "yes" if identifiable else "no"
        return map(no_formula, [one.name, value, unit, std, alone, one.known, *rest])

    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(_COLUMNS)
        for row in zip(values, robot.theta_std_, robot.identifiable_):
            table.writerow(cells(*row))
        for one, std, scatter in alike_values(robot.alike_):
            table.writerow(cells(one, std, True, scatter))
