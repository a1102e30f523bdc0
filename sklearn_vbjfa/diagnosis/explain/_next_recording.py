"""The error to expect on the next recording, from how recordings differ."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

# Logarithm of the error on another recording over that on untouched data of a single
# one, to be divided by how many were fitted, and its deviation between recordings: of
# measured robots with several.
_AGAIN, _DIFFER = np.log(1.5), 0.45
# Least share of an error that is said to differ.
_LEAST = 0.1
# Recordings that this deviation counts for, and this mean.
_FREEDOM, _COUNTS = 4.0, 2.0
# From so many recordings on the deviation is called measured.
_MEASURED = 3
_LEVEL = 0.9


@dataclass(frozen=True, kw_only=True, eq=False)
class NextRecording:
    """Error of the completed model on a recording that was not fitted."""

    # (nv,): median, over the spread of the torque; nan for a joint that was not judged
    error: np.ndarray
    interval: np.ndarray  # (2, nv): its ends in nine of ten recordings
    # (2,): the same of the mean of the joints
    mean: float
    mean_interval: np.ndarray
    recordings: int  # recordings that were left out in turns; zero with a single one
    # where the differences between recordings are from: other robots, both, these
    source: str


def next_recording(left_out, untouched, floor):
    """Tell what to expect of the next recording, as `NextRecording`."""
    # left_out (r, nv): errors on each recording of a model fitted to the others, over
    # the spread, nan where there is none; r may be zero. untouched (nv,): error on
    # untouched data of the recordings that were fitted; floor (nv,): error that noise
    # alone would leave, nan if unknown.
    # What differs between recordings is the part of the error above the noise.
    # Logarithms of the errors are normal between recordings, conjugate to what is
    # assumed: its mean, that of the untouched error and a share more, counts for two
    # recordings, its variance for four.
    source = "assumed" if len(left_out) < 2 else "mixed"
    if len(left_out) >= _MEASURED:
        source = "measured"
    of_joints = [_expected(*own) for own in zip(left_out.T, untouched, floor)]
    error, low, high = np.array(of_joints).T
    with np.errstate(invalid="ignore"):
        means = np.array([_mean(row) for row in left_out])
    judged = np.where(np.isfinite(untouched), floor, np.nan)
    mean, *ends = _expected(means, _mean(untouched), _mean(judged))
    return NextRecording(
        error=error,
        interval=np.array([low, high]),
        mean=mean,
        mean_interval=np.array(ends),
        recordings=len(left_out),
        source=source,
    )


def _mean(errors):
    """Mean of the joints that have an error; nan without any."""
    known = errors[np.isfinite(errors)]
    return float(known.mean()) if known.size else np.nan


def _expected(errors, untouched, floor):
    """Median and ends of the next error, by those that there are."""
    known = errors[np.isfinite(errors) & (errors > 0)]
    if not untouched > 0:
        return np.nan, np.nan, np.nan
    # The share of the squared error that is no noise.
    above = 1.0 - (np.nan_to_num(floor) / untouched) ** 2
    differ = max(above, _LEAST)
    logs = np.log(known) if known.size > 1 else np.empty(0)
    expected = np.log(untouched) + differ * _AGAIN / max(logs.size, 1)
    # Fits to one recording less know a little less than one to all.
    again = max(logs.size - 1, 0)
    middle = (logs.sum() / max(logs.size, 1) * again + _COUNTS * expected) / (
        again + _COUNTS
    )
    square = _FREEDOM * (differ * _DIFFER) ** 2 + ((logs - middle) ** 2).sum()
    freedom = _FREEDOM + again
    spread = np.sqrt(square / freedom * (1.0 + 1.0 / (again + _COUNTS)))
    half = stats.t.ppf(0.5 + 0.5 * _LEVEL, freedom) * spread
    return tuple(np.exp([middle, middle - half, middle + half]))
