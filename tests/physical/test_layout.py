"""Layout of the parameter vector: deduced, given, refused."""

import warnings

import numpy as np
import pytest

from sklearn_vbjfa.physical import resolve_layout


@pytest.mark.parametrize(
    ("n_features", "starts", "kept"),
    [
        (10, [0], []),
        (70, range(0, 70, 10), []),
        (11, [0], [10]),
        (33, [0, 11, 22], [10, 21, 32]),
    ],
)
def test_auto_knows_ten_and_eleven_columns(n_features, starts, kept):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        layout = resolve_layout(n_features)
    assert layout.body_starts.tolist() == list(starts)
    assert layout.nonnegative.tolist() == kept


def test_auto_warns_when_both_fit():
    with pytest.warns(UserWarning, match="both at 10 and at 11 parameters"):
        layout = resolve_layout(110)
    assert len(layout.body_starts) == 10


def test_explicit_width_settles_what_auto_guesses():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        layout = resolve_layout(110, parameters_per_joint=10)
    assert len(layout.body_starts) == 11
    assert layout.nonnegative.size == 0


def test_too_few_columns_hold_no_body():
    with pytest.warns(UserWarning, match="9 columns are too few for a body"):
        layout = resolve_layout(9)
    assert layout.body_columns.shape == (0, 10)
    assert layout.nonnegative.size == 0


def test_body_starts_admit_joints_of_different_width():
    layout = resolve_layout(23, body_starts=[11, 0], nonnegative=np.arange(23) == 22)
    assert layout.body_starts.tolist() == [0, 11]
    assert layout.nonnegative.tolist() == [22]


@pytest.mark.parametrize(
    ("n_features", "options", "message"),
    [
        (24, {}, "24 columns are not a whole number of joints with 10 or 11"),
        (25, {"parameters_per_joint": 12}, "whole number of joints with 12 parameters"),
        (20, {"parameters_per_joint": 9}, "integer >= 10, got 9"),
        (20, {"parameters_per_joint": "ten"}, "integer >= 10, got 'ten'"),
        (
            24,
            {"parameters_per_joint": 12},
            "List the columns that must not be negative",
        ),
        (21, {"body_starts": [0, 9]}, "two bodies overlap"),
        (21, {"body_starts": [0, 0]}, "names a column twice"),
        (21, {"body_starts": [12]}, "needs 10 columns; the vector has 21"),
        (
            21,
            {"body_starts": [-1]},
            "body_starts must hold column numbers from 0 to 20",
        ),
        (21, {"body_starts": [0.5]}, "must be a list of column numbers"),
        (11, {"nonnegative": [3]}, "column 3, which is an inertial parameter"),
        (
            11,
            {"nonnegative": [11]},
            "nonnegative must hold column numbers from 0 to 10",
        ),
        (
            11,
            {"nonnegative": [True, False]},
            r"mask must have shape \(11,\), got \(2,\)",
        ),
    ],
)
def test_wrong_layouts_are_refused(n_features, options, message):
    with pytest.raises(ValueError, match=message):
        resolve_layout(n_features, **options)
