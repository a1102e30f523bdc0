"""Messages quote what a file holds; what is left out is counted, not dotted."""

import pytest

from sklearn_vbjfa.recording import listed, quoted


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("off", "'off'"),
        ("x" * 60, repr("x" * 60)),
        ("x" * 63, repr("x" * 60) + " and 3 characters more"),
        (5, "5"),
        ([1.0, None], "[1.0, None]"),
        (["x" * 100], "['" + 58 * "x" + " and 44 characters more"),
    ],
)
def test_quoted(value, expected):
    assert quoted(value) == expected


def test_listed():
    assert listed([]) == ""
    assert listed(["q1", 2]) == "q1, 2"
    names = [f"q{k}" for k in range(20)]
    assert listed(names) == ", ".join(names)
    more = [f"q{k}" for k in range(300)]
    assert listed(more) == ", ".join(more[:19]) + ", and 281 more"
    assert listed(["q" * 61]) == repr("q" * 60) + " and 1 characters more"
