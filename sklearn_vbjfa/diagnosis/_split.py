"""The last part of every recording is kept for the end."""

import numpy as np

from sklearn_vbjfa.robot._groups import contiguous_groups


def split_in_time(n_samples, groups, test_size):
    """Return the rows of the search and of the test part.

    Parameters
    ----------
    n_samples : int
        Number of rows.
    groups : array-like of shape (n_samples,) or None
        Labels of recordings.
    test_size : float
        Share of each recording, from its end, that is kept for the test.

    Returns
    -------
    search, test : ndarray of int
        Row numbers.
    """
    try:
        share = float(test_size)
    except (TypeError, ValueError):
        share = np.nan
    if not 0 < share < 1:
        raise ValueError(
            "test_size must be the share of each recording that is kept for the test, "
            f"between 0 and 1; got {test_size!r}."
        )
    search, test = [], []
    for part in contiguous_groups(groups, n_samples):
        border = part.stop - round(share * (part.stop - part.start))
        search.append(np.arange(part.start, border))
        test.append(np.arange(border, part.stop))
    return np.concatenate(search), np.concatenate(test)
