"""Draw how the loop grows with the length and the joints, from the recorded table.

Run ``python docs/images/long_recordings.py``; it reads
``docs/tables/long_recordings.rst`` and writes ``long_recordings.svg`` beside itself.
``tests/benchmarks/bench_long_recordings.py --write`` runs it.
"""

import re
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl

sys.path.insert(0, str(Path(__file__).resolve().parent))

from growth import OURS, RIVAL, Line, Panel, draw, read, tables_in

PICTURE = Path(__file__).with_name("long_recordings.svg")
# Study -> name of a recording, and the sentence with its powers.
CASES = {
    "minutes": (r"7 joints, (\d+) min", "With the length"),
    "joints": (r"(\d+) joints", "With the joints"),
}
LINES = (
    Line(method="time [s]", label="time [s]", colour=OURS),
    Line(method="memory [GB]", label="memory [GB]", colour=RIVAL),
)
PANELS = (
    Panel(
        message="With the length",
        study="minutes",
        quantity="figure",
        unit="time [s], memory [GB]",
        lines=LINES,
    ),
    Panel(
        message="With the joints, in 165 s",
        study="joints",
        quantity="figure",
        unit="time [s], memory [GB]",
        lines=LINES,
    ),
)


def figures_of(text):
    """Study -> column of the table -> size -> its figure."""
    (table,) = tables_in(text)
    found = {}
    for study, (name, _) in CASES.items():
        matches = [re.fullmatch(name, first) for first in table.column("recording")]
        found[study] = {
            line.method: {
                int(match[1]): {"figure": float(cell)}
                for match, cell in zip(matches, table.column(line.method), strict=True)
                if match
            }
            for line in LINES
        }
    return found


def with_powers(text):
    """Panels with the exponents that stand below the table, beside the names."""
    panels = []
    for panel in PANELS:
        words = (
            f"{CASES[panel.study][1]}.*time to the power of (.*), memory .* of (.*)\\."
        )
        said = re.search(words, text)
        powers = said.groups() if said else ()
        lines = [
            replace(line, label=f"{line.label},\n{panel.study}$^{{{power}}}$")
            for line, power in zip(panel.lines, powers)
        ]
        panels.append(replace(panel, lines=tuple(lines) or panel.lines))
    return tuple(panels)


def main():
    """Write the picture."""
    text = read("long_recordings")
    # The same file from the same figures.
    with mpl.rc_context({"svg.hashsalt": "long_recordings"}):
        picture = draw(figures_of(text), with_powers(text))
        picture.savefig(PICTURE, metadata={"Date": None})


if __name__ == "__main__":
    main()
