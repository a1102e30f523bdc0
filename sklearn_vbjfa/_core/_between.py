"""Channels between their samples: delayed, and differentiated."""

import numpy as np
from scipy.interpolate import make_interp_spline

# Samples that a cubic spline needs.
_CUBIC = 4


def between(values, parts, t, delay=0.0, order=0):
    """Channels (n, ...) a delay [s] earlier, or their derivative by time there."""
    # parts: recordings, across whose borders nothing is interpolated; t (n,) [s].
    # Splines: straight lines would take 1 % of what moves at a twentieth of the
    # sampling frequency. Before a recording its first value is held.
    out = np.empty(values.shape)
    for part in parts:
        own, clock = values[part], t[part]
        degree = 3 if clock.size >= _CUBIC else min(clock.size - 1, 1)
        if not degree:
            out[part] = own if order == 0 else 0.0
            continue
        # Counted in the recording, times are as exact at noon as at midnight.
        clock = clock - clock[0]
        made = make_interp_spline(clock, own, k=degree)
        asked = clock - delay
        out[part] = made(np.clip(asked, 0.0, clock[-1]), nu=order)
        if order:
            out[part][(asked < 0.0) | (asked > clock[-1])] = 0.0
    return out
