"""What a file holds, quoted in a message: what is left out of it is counted."""

# Entries of a list, and characters of a name or cell, that are quoted at most: a file
# may have thousands of columns and cells without an end.
_ENTRIES, _CHARACTERS = 20, 60


def quoted(value):
    """Write a cell, a name or another value as Python does; of a long one the begin."""
    if isinstance(value, str):
        text = repr(value[:_CHARACTERS])
        left = len(value) - _CHARACTERS
    else:
        text = repr(value)
        text, left = text[:_CHARACTERS], len(text) - _CHARACTERS
    return f"{text} and {left} characters more" if left > 0 else text


def listed(names):
    """Name columns, joints or topics one after another; of many the first."""
    names = [str(name) for name in names]
    names = [name if len(name) <= _CHARACTERS else quoted(name) for name in names]
    if len(names) > _ENTRIES:
        names[_ENTRIES - 1 :] = [f"and {len(names) - _ENTRIES + 1} more"]
    return ", ".join(names)
