"""Helpers to read a file and collect its warnings or its error."""

import re
import warnings

import pytest

from sklearn_vbjfa.datasets import read_recording


def read(path, **options):
    """Return a recording and its warnings, list of str."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read_recording(path, **options)
    return recording, [str(x.message) for x in caught]


def read_text(path, **options):
    """Return a recording and its warnings as one string."""
    recording, messages = read(path, **options)
    return recording, " ".join(messages)


def refusal(path, **options):
    """Return the error for a file; it must be one line that names the file."""
    with pytest.raises(ValueError, match=re.escape(str(path))) as caught:
        read_recording(path, **options)
    assert "\n" not in str(caught.value)
    return caught.value
