"""Recordings in JSON: arrays by their names, records, or a record in each line."""

import json
from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording._table import (
    CUT,
    Format,
    NotATable,
    Source,
    Table,
    check_size,
    flattened,
    nameless,
    quoted,
    table_of_arrays,
    table_of_records,
    text_of,
    without_common_part,
)

# Lists and numbers of Python take so many times the bytes of their text.
_SPREAD = 4


def read_json(path: Source, wanted) -> Table:
    """Read a list of records or rows, one a line or not, or arrays by their names."""
    check_size(path, _SPREAD * path.file.stat().st_size, what="as objects")
    found, notes = _parsed(path, text_of(path))
    if isinstance(found, dict):
        table, note = _of_object(path, found)
        return replace(table, notes=(*table.notes, *notes, *note))
    if not isinstance(found, list) or not found:
        raise _no_records(path, found, 1)
    if all(map(_is_row, found)):
        return nameless(path, _matrix(path, found), notes=notes)
    for k, record in enumerate(found):
        if not isinstance(record, dict) or not record:
            raise _no_records(path, record, k + 1)
    return replace(table_of_records(path, found), notes=notes)


def _of_object(path, found):
    """Return the table of an object and notes: records in it, trials, or arrays."""
    lists = [x for x, one in found.items() if _is_list_of(one, dict)]
    # The records are those of the only list, unless they have arrays, as joints do.
    if len(lists) == 1 and _longest(found[lists[0]][0]) <= len(found[lists[0]]):
        (name,) = lists
        note = f"the records are those of {name!r}."
        return table_of_records(path, found[name]), (note,)
    for name in lists:
        lengths = {_longest(one) for one in found[name]}
        if len(lengths) > 1 and _longest(found) < max(lengths):
            arrays = _one_after_another(path, name, found[name])
            return table_of_arrays(path, arrays), (
                f"the {len(found[name])} entries of {name!r} are one recording each.",
            )
    return table_of_arrays(path, without_common_part(flattened(found))), ()


def _is_list_of(one, kind):
    return isinstance(one, list) and bool(one) and all(isinstance(x, kind) for x in one)


def _longest(record):
    return max((len(x) for x in record.values() if isinstance(x, list)), default=0)


def _one_after_another(path, name, records):
    """Return the arrays of recordings end to end, with a column segment."""
    arrays = [{k: x for k, x in one.items() if isinstance(x, list)} for one in records]
    counts = [{len(x) for x in one.values()} for one in arrays]
    if len({tuple(x) for x in arrays}) > 1 or any(len(x) != 1 for x in counts):
        raise ValueError(
            f"{path}: the list {name!r} has {len(records)} records with arrays of "
            "different lengths; write one file each, or rows with a column segment."
        )
    found = {key: [x for one in arrays for x in one[key]] for key in arrays[0]}
    segment = np.repeat(np.arange(len(records)), [count.pop() for count in counts])
    return {**found, "segment": segment}


def _is_row(one):
    return isinstance(one, list) and all(isinstance(x, (int, float)) for x in one)


def _matrix(path, rows):
    """Return rows of numbers as a matrix; refuse rows that differ in length."""
    lengths = [len(row) for row in rows]
    usual = max(set(lengths), key=lengths.count)
    if not usual or len(set(lengths)) > 1:
        k = next((k for k, n in enumerate(lengths) if n != usual or not n), 0)
        raise ValueError(
            f"{path}: record {k + 1} has {lengths[k]} numbers, others have {usual}; "
            "all need as many."
        )
    return np.array(rows, dtype=float)


def _parsed(path, text):
    """Return the content of a text, all of it or a list of its lines, and notes."""
    try:
        return json.loads(text), ()
    except (ValueError, RecursionError) as error:
        lines = text.strip().split("\n")
        if getattr(error, "msg", "") != "Extra data" or len(lines) < 2:
            raise _broken(path, error) from error
    found = []
    for k, line in enumerate(lines):
        try:
            found += [json.loads(line)] if line.strip() else []
        except (ValueError, RecursionError) as error:
            if k == len(lines) - 1 and not text.endswith("\n"):
                return found, (CUT,)
            raise _broken(path, error, k) from error
    return found, ()


def _broken(path, error, line=0):
    """Return the refusal of what is not JSON, with the line."""
    where = f" in line {line + getattr(error, 'lineno', 1)}"
    return ValueError(
        f"{path}: is not a complete JSON file ({getattr(error, 'msg', error)}{where}); "
        "write it again."
    )


def _no_records(path, found, number):
    return NotATable(
        path.shown,
        f"{path}: holds {quoted(found)} as record {number}; expected objects such as "
        '{"t": 0.0, "q": [0.1, 0.2], "tau": [1.5, 0.4]}, rows of numbers, or arrays by '
        "their names.",
    )


JSON = Format(
    name="JSON",
    endings=(".json", ".jsonl", ".ndjson"),
    shown=(".json", ".jsonl"),
    read=read_json,
    begins=tuple((begin, ".json") for begin in (b"{", b"[{", b"[\n", b"[\r", b"[ ")),
)
