"""How tests read a file: with what was said, or refused in one line."""

import re
import warnings

import pytest

from sklearn_vbjfa.datasets import read_recording


def read(path, **options):
    """Return a recording and what was said, list of str."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read_recording(path, **options)
    return recording, [str(x.message) for x in caught]


def read_text(path, **options):
    """Return a recording and what was said, in one text."""
    recording, said = read(path, **options)
    return recording, " ".join(said)


def refusal(path, **options):
    """Return the error of a file: one line that names it."""
    with pytest.raises(ValueError, match=re.escape(str(path))) as caught:
        read_recording(path, **options)
    assert "\n" not in str(caught.value)
    return caught.value
