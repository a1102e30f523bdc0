"""Layout of the parameter vector: deduced, given, refused."""

import warnings

import numpy as np
import pytest

from sklearn_vbjfa.physical import INERTIAL_NAMES, resolve_layout


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
            "or set nonnegative to the columns that must not be neg",
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


# -- by the names of the columns


def named(*joints):
    """Names of the columns of joints, each given with its extra columns."""
    names = []
    for joint, extras in joints:
        names += [f"{joint}:{name}" for name in (*INERTIAL_NAMES, *extras)]
    return names


def test_names_tell_bodies_and_signs():
    names = named(
        ("a", ("viscous", "offset", "coulomb")), ("b:1", ()), ("c", ("rotor_inertia",))
    )
    names = ["temperature", *names, "a:spring", "coulomb"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        layout = resolve_layout(len(names), parameter_names=names)
    assert layout.body_starts.tolist() == [1, 14, 24]
    # "coulomb" alone is a friction too; a spring may be of either sign
    assert [names[k] for k in layout.nonnegative] == [
        "a:viscous",
        "a:coulomb",
        "c:rotor_inertia",
        "coulomb",
    ]


def test_names_settle_what_the_number_of_columns_leaves_open():
    names = named(*((f"j{k}", ()) for k in range(11)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        layout = resolve_layout(110, parameter_names=np.array(names, dtype=object))
    assert layout.body_starts.tolist() == list(range(0, 110, 10))
    assert layout.nonnegative.size == 0


def test_what_is_given_goes_before_names():
    names = named(("a", ("viscous", "offset")), ("b", ("viscous", "offset")))
    layout = resolve_layout(24, parameter_names=names, nonnegative=[11])
    assert layout.body_starts.tolist() == [0, 12]
    assert layout.nonnegative.tolist() == [11]
    layout = resolve_layout(24, parameter_names=names, body_starts=[12])
    assert layout.body_starts.tolist() == [12]
    assert layout.nonnegative.tolist() == [10, 22]


def test_names_without_a_body_say_nothing():
    plain = resolve_layout(11)
    layout = resolve_layout(11, parameter_names=[f"x{k}" for k in range(11)])
    assert layout.body_starts.tolist() == plain.body_starts.tolist()
    assert layout.nonnegative.tolist() == plain.nonnegative.tolist() == [10]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (named(("a", ()))[:-1] + ["a:viscous"], "columns named 'a' are not the body"),
        (named(("a", ()))[::-1], "expected a:m, a:mc_x to a:I_zz in the order of"),
        (named(("a", ()))[:9], "are not the body of one joint from column 0"),
        (["b:m", *named(("a", ()))], "columns named 'b' are not the body"),
    ],
)
def test_torn_bodies_are_refused(names, message):
    with pytest.raises(ValueError, match=message):
        resolve_layout(len(names), parameter_names=names)


def test_one_name_a_column():
    with pytest.raises(ValueError, match="12 names, one for each column; got 11"):
        resolve_layout(12, parameter_names=named(("a", ("viscous",))))


@pytest.mark.parametrize("columns", [(12, {"parameters_per_joint": 12}), (24, {})])
def test_without_names_the_message_says_how_to_get_them(columns):
    n_features, options = columns
    with pytest.raises(ValueError, match=r'Either name .*set_output\(transform="pand'):
        resolve_layout(n_features, **options)
