"""The robots of the paper, which the gallery simulates."""

import sys

from _report import ROOT

sys.path.insert(0, str(ROOT / "examples" / "3_articles"))

from paper_robots import (
    draw_motion,
    load_paper_robot,
    make_closed_loop_recording,
    simulate_tracking,
)

__all__ = [
    "draw_motion",
    "load_paper_robot",
    "make_closed_loop_recording",
    "simulate_tracking",
]
