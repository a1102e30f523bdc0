"""Benchmarks for airspeed velocity (asv); see CONTRIBUTING.md for how to run them.

Problems and models are those of `bench_growth`, in `_growth_problems`.
"""

import sys
from pathlib import Path

# asv imports this folder as a package of its own; what it shares lies above it.
_ABOVE = str(Path(__file__).resolve().parents[1])
if _ABOVE not in sys.path:
    sys.path.insert(0, _ABOVE)
