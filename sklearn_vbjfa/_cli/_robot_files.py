"""Files of an identified robot."""

import math
import warnings

from sklearn_vbjfa._cli._input import escape_formula
from sklearn_vbjfa.diagnosis.explain import parameter_values
from sklearn_vbjfa.diagnosis.report._words import join
from sklearn_vbjfa.model import DoubtWarning

# Parameters, URDF, MJCF, and the saved model with all identified effects.
ROBOT_FILES: tuple[str, ...] = (
    "parameters.csv",
    "identified.urdf",
    "identified.xml",
    "identified.json",
)
_COLUMNS = "parameter value unit std identifiable description scatter".split()


def write_robot(robot, folder):
    """Write the robot; return a line for each file that cannot hold all effects."""
    _write_parameters(robot, folder / "parameters.csv")
    robot.save(folder / "identified.json")
    exports = {"identified.urdf": robot.to_urdf, "identified.xml": robot.to_mjcf}
    lines = []
    for name, export in exports.items():
        try:
            effects = export(folder / name)
        except ValueError as error:
            warnings.warn(f"{name} is not written: {error}", DoubtWarning, stacklevel=2)
            continue
        named = dict.fromkeys(f"{e.name} on {e.joint_name}" for e in effects)
        if named:
            lines.append(
                f"{name} has no place for {join(named)}; its first lines list "
                "why, and identified.json has all."
            )
    return lines


def _write_parameters(robot, path):
    import pandas as pd

    rows, gains = [], robot.gains_
    for x, std in zip(parameter_values(robot), robot.theta_std_):
        unit = x.unit
        if gains is not None and not gains.absolute and unit.startswith(("N", "kg")):
            own = gains.references if x.joint is None else [gains.reference[x.joint]]
            names = " or ".join(robot.joint_names_[j] for j in own) or "each channel"
            unit += f", times the gain of {names}"
        rows.append((x.name, x.value, unit, std, x.source, x.described, math.nan))
    for x in robot.alike_:
        name = f"{x.group}:{x.parameter}"
        rows.append((name, x.value, x.unit, x.std, "yes", math.nan, x.scatter))
    table = pd.DataFrame(rows, columns=_COLUMNS).replace([math.inf, -math.inf], None)
    for name in ("parameter", "unit", "identifiable"):
        table[name] = table[name].map(escape_formula)
    table.to_csv(path, index=False, encoding="utf-8")
