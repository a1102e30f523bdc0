"""Records or arrays out of JSON, as a list, one record a line, or arrays by names."""

import json

from sklearn_vbjfa.recording._table import (
    Format,
    Source,
    Table,
    check_size,
    flattened,
    quoted,
    table_of_arrays,
    table_of_records,
    text_of,
    without_common_part,
)

# Lists and numbers of Python take so many times the bytes of their text.
_SPREAD = 4


def read_json(path: Source, wanted) -> Table:
    """Read a list of records, records one a line, or arrays by their names."""
    check_size(path, _SPREAD * path.file.stat().st_size, what="as objects")
    found = _parsed(path, text_of(path))
    if isinstance(found, dict):
        return table_of_arrays(path, without_common_part(flattened(found)))
    for k, record in enumerate(found if isinstance(found, list) else [found]):
        if not isinstance(record, dict) or not record:
            raise ValueError(
                f"{path}: holds {quoted(record)} as record {k + 1}; expected objects "
                'such as {"t": 0.0, "q": [0.1, 0.2], "tau": [1.5, 0.4]}, or arrays '
                "by their names."
            )
    return table_of_records(path, found)


def _parsed(path, text):
    """Return what a text says: all of it, or a list of what its lines say."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        lines = text.strip().split("\n")
        if getattr(error, "msg", "") != "Extra data" or len(lines) < 2:
            raise _broken(path, error) from error
    found = []
    for k, line in enumerate(lines):
        try:
            found += [json.loads(line)] if line.strip() else []
        except (ValueError, RecursionError) as error:
            raise _broken(path, error, k) from error
    return found


def _broken(path, error, line=0):
    """Return the refusal of what is no JSON, with the line from which on."""
    where = f" in line {line + getattr(error, 'lineno', 1)}"
    return ValueError(
        f"{path}: is no whole JSON file ({getattr(error, 'msg', error)}{where}); write "
        "it anew."
    )


JSON = Format(
    name="JSON",
    endings=(".json", ".jsonl", ".ndjson"),
    shown=(".json", ".jsonl"),
    read=read_json,
    begins=tuple((begin, ".json") for begin in (b"{", b"[{", b"[\n", b"[\r", b"[ ")),
)
