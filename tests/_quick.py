"""Parameter sets of which a part is marked slow."""

from itertools import product

import pytest


def _params(values, quick):
    return [
        pytest.param(*value, marks=[] if is_quick else [pytest.mark.slow])
        for value, is_quick in zip(values, quick)
    ]


def one_in(every, values):
    """Return parameters; mark all but the first of every `every` as slow."""
    values = list(values)
    return _params([(x,) for x in values], [k % every == 0 for k in range(len(values))])


def checkered(*axes):
    """Return all combinations; mark every other one as slow, in a checkerboard pattern.

    The quick half still contains each value of each axis.
    """
    indices = product(*(range(len(axis)) for axis in axes))
    return _params(list(product(*axes)), [sum(index) % 2 == 0 for index in indices])
