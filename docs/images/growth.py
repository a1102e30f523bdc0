"""Draw what grows with the rows and the joints, from the recorded tables.

Run ``python docs/images/growth.py``; it reads ``docs/tables/growth.rst``, which
``tests/benchmarks/bench_growth.py`` writes, and writes ``growth.svg`` beside itself.
"""

import re
import sys
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "_ext"))

from recorded import read, tables_in

PICTURE = Path(__file__).with_name("growth.svg")
STUDIES = ("rows", "columns", "joints")
_CELL = re.compile(r"([\d.e+]+) s, (\d+) MB, ([\d.]+) %")
OURS, SEARCH, RIVAL, OTHER = "#0063a3", "#007a5e", "#b34700", "#777777"


@dataclass(frozen=True, kw_only=True)
class Line:
    """A method in a panel: its row of the table, the label beside it, its colour.

    The label stands beside the last point, or above it to the left.
    """

    method: str
    label: str
    colour: str
    above: bool = False


@dataclass(frozen=True, kw_only=True)
class Panel:
    """One message: a quantity of a study, and the methods that show it."""

    message: str
    study: str
    quantity: str
    unit: str
    lines: tuple


PANELS = (
    Panel(
        message="Time is in proportion to the rows",
        study="rows",
        quantity="seconds",
        unit="processor time [s]",
        lines=(
            Line(method="LassoCV", label="LassoCV", colour=OTHER, above=True),
            Line(method="Ridge", label="Ridge", colour=RIVAL),
            Line(method="VB-JFA", label="VB-JFA", colour=OURS),
        ),
    ),
    Panel(
        message="Memory is not: chunks need no more",
        study="rows",
        quantity="megabytes",
        unit="peak memory [MB]",
        lines=(
            Line(method="Ridge", label="Ridge", colour=RIVAL),
            Line(method="VB-JFA", label="VB-JFA,\nin chunks", colour=OURS),
        ),
    ),
    Panel(
        message="Error falls only where the noise is known",
        study="rows",
        quantity="error",
        unit="error of the coefficients [%]",
        lines=(
            Line(method="Ridge", label="Ridge", colour=RIVAL),
            Line(
                method="VB-JFA, noise given",
                label="VB-JFA,\nnoise given",
                colour=OURS,
            ),
        ),
    ),
    Panel(
        message="With the joints the search grows fastest",
        study="joints",
        quantity="seconds",
        unit="processor time [s]",
        lines=(
            Line(
                method="EffectDiscovery",
                label="EffectDiscovery",
                colour=SEARCH,
                above=True,
            ),
            Line(method="RobotIdentifier", label="RobotIdentifier", colour=OURS),
            Line(method="PhysicalProjector", label="projection\nalone", colour=OTHER),
        ),
    ),
)


def figures_of(text):
    """Study -> method -> size -> (seconds, megabytes, error in per cent)."""
    found = {}
    for study, table in zip(STUDIES, tables_in(text), strict=True):
        sizes = [int(name.replace(",", "")) for name in table.headers[1:]]
        found[study] = {}
        for method, *cells in table.rows:
            pairs = ((n, _CELL.fullmatch(cell)) for n, cell in zip(sizes, cells))
            found[study][method] = {
                n: dict(
                    zip(("seconds", "megabytes", "error"), map(float, match.groups()))
                )
                for n, match in pairs
                if match
            }
    return found


def draw(found, panels=PANELS):
    """One panel for each message, two in a row, logarithmic, names beside lines."""
    rows = len(panels) // 2
    picture = Figure(figsize=(9.2, 3.5 * rows), facecolor="white", layout="constrained")
    for axis, panel in zip(picture.subplots(rows, 2).flat, panels, strict=True):
        smallest, largest = float("inf"), 1
        for line in panel.lines:
            values = found[panel.study][line.method]
            sizes = list(values)
            heights = [entry[panel.quantity] for entry in values.values()]
            axis.loglog(sizes, heights, "o-", color=line.colour, lw=2, ms=5)
            axis.annotate(
                line.label,
                (sizes[-1], heights[-1]),
                (4, 9) if line.above else (8, 0),
                textcoords="offset points",
                ha="right" if line.above else "left",
                va="center",
                color=line.colour,
                annotation_clip=False,
            )
            smallest, largest = min(smallest, *sizes), max(largest, *sizes)
        # Room for the names to the right.
        axis.set_xlim(0.7 * smallest, largest * (largest / smallest) ** 0.42)
        known = set().union(*found[panel.study].values())
        axis.set_xticks([n for n in sorted(known) if n <= largest])
        axis.xaxis.set_major_formatter(_short)
        if panel.quantity == "megabytes":
            # Little more than a decade.
            axis.set_yticks([300, 1000, 3000])
        axis.yaxis.set_major_formatter(_short)
        axis.minorticks_off()
        axis.margins(y=0.14)
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(axis="y", color="0.9")
        axis.set_title(panel.message, loc="left", fontsize=11, weight="bold")
        axis.set_xlabel(panel.study)
        axis.set_ylabel(panel.unit)
    return picture


def _short(value, _position):
    """Write 10,000,000 as 10M, and no powers of ten."""
    for unit, letter in ((1e6, "M"), (1e4, "k")):
        if value >= unit:
            return f"{value * (1e-3 if letter == 'k' else 1e-6):.0f}{letter}"
    return f"{value:,.0f}" if value >= 1 else f"{value:g}"


def main():
    """Write the picture."""
    # The same file from the same figures.
    with mpl.rc_context({"svg.hashsalt": "growth"}):
        draw(figures_of(read("growth"))).savefig(PICTURE, metadata={"Date": None})


if __name__ == "__main__":
    main()
