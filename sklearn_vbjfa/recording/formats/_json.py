"""Records or arrays out of JSON, as a list, one record a line, or arrays by names."""

import json

import numpy as np

from sklearn_vbjfa.recording._table import (
    Format,
    Source,
    Table,
    check_size,
    flattened,
    quoted,
    table_of_arrays,
)


def read_json(path: Source, wanted) -> Table:
    """Read a list of records, records one a line, or arrays by their names."""
    check_size(path, path.file.stat().st_size, what="of JSON")
    try:
        text = path.file.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: is no UTF-8 text ({error.reason}).") from error
    if not text.strip():
        raise ValueError(f"{path}: no rows of data; expected one record per sample.")
    found = _parsed(path, text)
    if isinstance(found, dict):
        return table_of_arrays(path, _arrays(path, flattened(found)))
    for k, record in enumerate(found if isinstance(found, list) else [found]):
        if not isinstance(record, dict) or not record:
            raise ValueError(
                f"{path}: holds {quoted(record)} as record {k + 1}; expected objects "
                'such as {"t": 0.0, "q": [0.1, 0.2], "tau": [1.5, 0.4]}, or arrays '
                "by their names."
            )
    records = [flattened(record) for record in found]
    names = dict.fromkeys(name for record in records for name in record)
    columns = {name: [record.get(name) for record in records] for name in names}
    return table_of_arrays(path, _arrays(path, columns))


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


def _arrays(path, columns):
    """Make arrays of values; nothing is nan, and a column of text stays text."""
    arrays = {}
    for name, values in columns.items():
        several = isinstance(values, list)
        first = next((x for x in values if x is not None), None) if several else values
        try:
            kind = str if isinstance(first, str) else float
            arrays[name] = np.array(values, dtype=kind)
        except (TypeError, ValueError, OverflowError) as error:
            raise ValueError(
                f"{path}: {quoted(name)} holds {quoted(first)} and others that are no "
                "numbers, or lists of other lengths; write one number, or equally long "
                "lists of them, for each sample."
            ) from error
    return arrays


JSON = Format(
    name="JSON",
    endings=(".json", ".jsonl", ".ndjson"),
    shown=(".json", ".jsonl"),
    read=read_json,
    begins=tuple((begin, ".json") for begin in (b"{", b"[{", b"[\n", b"[\r", b"[ ")),
)
