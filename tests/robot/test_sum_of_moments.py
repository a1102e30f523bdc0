"""Moments of pieces of a recording, added up."""

import numpy as np
from numpy.testing import assert_allclose

from sklearn_vbjfa.equations import piece_moments, sum_moments


def joint_moments(*rows):
    return sum_moments([piece_moments(*rows)])


def pieces(rng, sizes=(30, 1, 20)):
    """Rows of a robot whose torques depend on some of the parameters each."""
    depends = np.array([[1, 1, 1, 1, 0], [0, 1, 0, 1, 0], [0, 0, 0, 0, 0]])
    for n in sizes:
        Phi, noise = rng.normal(size=(2, n, 3, 5)) * depends
        yield Phi, rng.normal(size=(n, 3)), rng.uniform(size=(n, 3)), noise


def test_the_sum_is_that_of_all_rows():
    parts = list(pieces(np.random.default_rng(0)))
    whole = joint_moments(*(np.concatenate(x) for x in zip(*parts)))
    each = [joint_moments(*part) for part in parts]
    first = each[0].G.copy(), each[0].noise.copy()
    total = sum_moments(each)
    for name in ("n", "n_rows", "G", "g", "yy", "noise"):
        assert_allclose(getattr(total, name), getattr(whole, name), atol=1e-12)
    # what is added up stays as it is
    assert_allclose(each[0].G, first[0], rtol=0)
    assert_allclose(each[0].noise, first[1], rtol=0)
    in_ranges = sum_moments(piece_moments(*part) for part in parts)
    for name in ("n", "n_rows", "G", "g", "yy", "noise"):
        assert_allclose(getattr(in_ranges, name), getattr(whole, name), atol=1e-12)
    assert sum_moments([]) is None
    assert sum_moments(joint_moments(*p[:3]) for p in parts).noise is None


def test_weight_two_is_a_row_twice():
    Phi, tau, weight, difference, *_ = next(iter(pieces(np.random.default_rng(1))))
    weight = np.ones_like(weight)
    weight[::3] = 2.0
    weight[:, 1] = 2.0  # the same in all rows: they are not multiplied with it
    again = weight > 1
    once = joint_moments(Phi, tau, weight, difference)
    first = joint_moments(Phi, tau, np.ones_like(weight), difference)
    twice = first + joint_moments(Phi, tau, again.astype(float), difference)
    for name in ("n", "G", "g", "yy", "noise"):
        one, two = getattr(once, name), getattr(twice, name)
        assert_allclose(one, two, rtol=0, atol=1e-13 * np.abs(two).max(), err_msg=name)
