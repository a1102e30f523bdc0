"""Records or arrays out of JSON, as a list, one record a line, or arrays by names."""

import json
from dataclasses import replace

import numpy as np

from sklearn_vbjfa.recording._table import (
    CUT,
    Format,
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
        records = _records_in(found)
        if not records:
            trials = _trials_in(found)
            arrays = without_common_part(flattened(found))
            if trials:
                arrays = _one_after_another(path, trials, found[trials])
                notes = (
                    *notes,
                    f"the {len(found[trials])} entries of {trials!r} are one recording "
                    "each.",
                )
            table = table_of_arrays(path, arrays)
            return replace(table, notes=(*table.notes, *notes))
        found = found[records]
        notes = (*notes, f"the records are those of {records!r}.")
    if isinstance(found, list) and found and all(map(_is_row, found)):
        return _rows(path, found, notes)
    for k, record in enumerate(found if isinstance(found, list) else [found]):
        if not isinstance(record, dict) or not record:
            raise ValueError(
                f"{path}: holds {quoted(record)} as record {k + 1}; expected objects "
                'such as {"t": 0.0, "q": [0.1, 0.2], "tau": [1.5, 0.4]}, rows of '
                "numbers, or arrays by their names."
            )
    return replace(table_of_records(path, found), notes=notes)


def _lists_of_objects(found):
    """Return the names of the lists of objects in an object."""
    return [
        name
        for name, one in found.items()
        if isinstance(one, list) and one and all(isinstance(x, dict) for x in one)
    ]


def _records_in(found):
    """Return the name of the only list of records in an object, "" for none."""
    lists = _lists_of_objects(found)
    # A list of joints has arrays in it, not samples.
    if len(lists) != 1 or any(
        isinstance(x, list) and len(x) > len(found[lists[0]])
        for x in found[lists[0]][0].values()
    ):
        return ""
    return lists[0]


def _trials_in(found):
    """Return the name of a list of recordings: arrays that differ in length; or ""."""
    for name in _lists_of_objects(found):
        longest = [max(map(len, _lists(one)), default=0) for one in found[name]]
        beside = max(map(len, _lists(found)))
        if len(set(longest)) > 1 and beside < max(longest):
            return name
    return ""


def _lists(record):
    return [x for x in record.values() if isinstance(x, list)]


def _one_after_another(path, name, records):
    """Return the arrays of recordings end to end, with a column segment."""
    counts = [{len(x) for x in _lists(record)} for record in records]
    channels = {
        tuple(k for k, x in record.items() if isinstance(x, list)) for record in records
    }
    if len(channels) > 1 or any(len(count) != 1 for count in counts):
        raise ValueError(
            f"{path}: the list {name!r} has {len(records)} records with arrays of "
            "different lengths; write one file each, or rows with a column segment."
        )
    found = {k: [x for one in records for x in one[k]] for k in channels.pop()}
    segment = np.repeat(np.arange(len(records)), [count.pop() for count in counts])
    return {**found, "segment": segment}


def _is_row(one):
    return isinstance(one, list) and all(isinstance(x, (int, float)) for x in one)


def _rows(path, found, notes):
    """Make a table without names of rows of numbers, or refuse rows that differ."""
    lengths = [len(row) for row in found]
    usual = max(set(lengths), key=lengths.count)
    if not usual or len(set(lengths)) > 1:
        k = next((k for k, n in enumerate(lengths) if n != usual or not n), 0)
        raise ValueError(
            f"{path}: record {k + 1} has {lengths[k]} numbers, others have {usual}; "
            "all need as many."
        )
    return nameless(path, np.array(found, dtype=float), notes=notes)


def _parsed(path, text):
    """Return what a text says, all of it or a list of its lines, and notes."""
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
    """Return the refusal of what is not JSON, with the line from which on."""
    where = f" in line {line + getattr(error, 'lineno', 1)}"
    return ValueError(
        f"{path}: is not a complete JSON file ({getattr(error, 'msg', error)}{where}); "
        "write it anew."
    )


JSON = Format(
    name="JSON",
    endings=(".json", ".jsonl", ".ndjson"),
    shown=(".json", ".jsonl"),
    read=read_json,
    begins=tuple((begin, ".json") for begin in (b"{", b"[{", b"[\n", b"[\r", b"[ ")),
)
