"""Test case, robot, and a valid recording."""

import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from sklearn_vbjfa.datasets import make_robot_recording

SEED = 20261124
DT = 0.005
N = 1600  # rows of the valid recording

LINK = """
<link name="{name}"><inertial><origin xyz="{centre} 0 0"/><mass value="{mass}"/>
  <inertia ixx="0.01" iyy="0.05" izz="0.05" ixy="0" ixz="0" iyz="0"/>
</inertial></link>
<joint name="{joint}" type="revolute"><parent link="{parent}"/><child link="{name}"/>
  <origin xyz="{origin} 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" effort="100" velocity="10"/>
</joint>"""
URDF = (
    '<robot name="arm"><link name="base"/>'
    + LINK.format(
        name="upper", joint="shoulder", parent="base", origin=0, centre=0.2, mass=3
    )
    + LINK.format(
        name="lower", joint="elbow", parent="upper", origin=0.4, centre=0.15, mass=2
    )
    + "</robot>"
)
OPTIONS = ("--urdf", "arm.urdf", "--effects", "spring", "--out", "out")


@dataclass(frozen=True, kw_only=True)
class Case:
    """An input and its expected result.

    ``build(folder, rng)`` writes files into a folder that contains ``arm.urdf`` and
    returns the arguments. ``expect``: ``"refused"`` in one line, ``"read"``,
    ``"same"``: read with the verdict of the valid recording, or ``"either"``.
    """

    name: str
    build: Callable[[Path, np.random.Generator], list]
    expect: str = "either"
    message: str = ""
    slow: bool = False

    def rng(self):
        """Return a generator that depends on the name only."""
        return np.random.default_rng([SEED, zlib.crc32(self.name.encode())])


@cache
def recording():
    """Simulate two joints and a spring that the model lacks."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(URDF)
        return make_robot_recording(
            str(path),
            duration=N * DT,
            dt=DT,
            n_harmonics=8,
            undeclared={"spring": (0, 4.0)},
            random_state=6,
        )


def columns():
    """Return the valid columns t, q1, q2, tau1, tau2."""
    made = recording()
    motion = {f"q{j + 1}": made.q[:, j] for j in range(2)}
    return {"t": made.t} | motion | {f"tau{j + 1}": made.tau[:, j] for j in range(2)}


def cells(table):
    """Return header and formatted cells as a list of rows."""
    rows = [list(table)]
    texts = [
        [x if isinstance(x, str) else f"{x:.9g}" for x in column]
        for column in table.values()
    ]
    rows.extend(map(list, zip(*texts)))
    return rows


def csv_text(table):
    """Return columns as CSV."""
    return "\n".join(",".join(row) for row in cells(table)) + "\n"


@cache
def clean_text():
    """Return the valid recording as CSV."""
    return csv_text(columns())


def clean_lines():
    """Return the lines of the valid CSV file."""
    return clean_text().splitlines()


def argv(source="arm.csv", *options):
    """Return the arguments for a recording; later options replace earlier ones."""
    return [source, *OPTIONS, *options]
