"""Which of many tests of a kind are quick; the others are slow tests."""

from itertools import product

import pytest


def _params(values, quick):
    return [
        pytest.param(*value, marks=[] if is_quick else [pytest.mark.slow])
        for value, is_quick in zip(values, quick)
    ]


def one_in(every, values):
    """Return parameters of which the first of every so many is quick."""
    values = list(values)
    return _params([(x,) for x in values], [k % every == 0 for k in range(len(values))])


def checkered(*axes):
    """Return all combinations; every other one is quick, so that each value is in one.

    With two factors of two values, for example, those are two of the four.
    """
    places = product(*(range(len(axis)) for axis in axes))
    return _params(list(product(*axes)), [sum(place) % 2 == 0 for place in places])
