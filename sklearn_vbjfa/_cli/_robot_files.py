"""Files of an identified robot."""

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
_COLUMNS = ["parameter", "value", "unit", "std", "identifiable", "description"]
_COLUMNS += ["scatter"]
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
        named = [*dict.fromkeys(f"{one.name} on {one.joint_name}" for one in effects)]
        named[_NAMED:] = [f"{len(named) - _NAMED} more"] if named[_NAMED:] else []
        if named:
            lines.append(
                f"{name} has no place for {', '.join(named)}; its first lines list "
                "why, and identified.json has all."
            )
    return lines


def _write_parameters(robot, path):
    import pandas as pd

    rows = [
        (one.name, one.value, one.unit, std, one.source, one.described, math.nan)
        for one, std in zip(parameter_values(robot), robot.theta_std_)
    ]
    for one in robot.alike_:
        name = f"{one.group}:{one.parameter}"
        rows.append((name, one.value, one.unit, one.std, "yes", math.nan, one.scatter))
    table = pd.DataFrame(rows, columns=_COLUMNS).replace([math.inf, -math.inf], None)
    if robot.gains_ is not None and not robot.gains_.absolute:
        names = [robot.joint_names_[j] for j in robot.gains_.references]
        is_scaled = table["unit"].str.match("N|kg")
        relative = f", times the gain of {' or '.join(names) or 'each channel'}"
        table.loc[is_scaled, "unit"] += relative
    for name in ("parameter", "unit", "identifiable"):
        table[name] = table[name].map(no_formula)
    table.to_csv(path, index=False, encoding="utf-8")
