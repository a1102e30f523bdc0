"""Parquet and feather files, and data sets of LeRobot, by pyarrow."""

import json
from pathlib import Path

import numpy as np

from sklearn_vbjfa.recording._table import (
    Source,
    Table,
    check_names,
    check_size,
    missing,
    parsing,
)
from sklearn_vbjfa.recording.formats._arrays import table_of

PARQUET = (".parquet", ".pq", ".feather", ".arrow")
_INFO = Path("meta") / "info.json"


def read_parquet(path: Source) -> Table:
    """Read a parquet or feather file; lists become columns with numbers."""
    return table_of(path, _columns(path, _lerobot_info(path.file)))


def read_lerobot(folder: Path) -> Table:
    """Read all episodes of a LeRobot data set."""
    files = sorted((folder / "data").rglob("*.parquet"))
    if not files:
        raise ValueError(
            f"{folder}: is a LeRobot data set without parquet files in its folder data;"
            " expected data/chunk-000/*.parquet (is it downloaded completely?)."
        )
    size = sum(file.stat().st_size for file in files)
    check_size(folder, size, f"give one of them, such as {files[0]}", "of files")
    info = _lerobot_info(files[0])
    parts = [_columns(Source(x, x), info) for x in files]
    shared = [x for x in parts[0] if all(x in part for part in parts)]
    columns = {x: np.concatenate([part[x] for part in parts]) for x in shared}
    return table_of(Source(folder, folder), columns)


def _columns(path, info):
    """Return the columns of a file as arrays, lists of numbers as columns each."""
    try:
        import pyarrow
        from pyarrow import ipc, parquet
    except ImportError as error:
        raise missing(path, "pyarrow", "parquet files need", "parquet") from error
    with parsing(path, "parquet file of plain columns", "write it again."):
        if path.file.suffix.lower() in PARQUET[:2]:
            with parquet.ParquetFile(path.file) as file:
                groups = map(file.metadata.row_group, range(file.num_row_groups))
                check_size(path, sum(group.total_byte_size for group in groups))
                read = file.read()
        else:
            with ipc.open_file(path.file) as file:
                batches = []
                for k in range(file.num_record_batches):
                    batches.append(file.get_batch(k))
                    check_size(path, sum(one.nbytes for one in batches))
                read = pyarrow.Table.from_batches(batches, file.schema)
        arrays = [column.to_numpy() for column in read.columns]
    check_names(path, read.column_names or [""], "has")
    found = {}
    for name, values in zip(read.column_names, arrays):
        lists = values.dtype.kind == "O" and values.size and values[0] is not None
        if lists and {np.shape(x) for x in values} == {(np.size(values[0]),)}:
            matrix = np.stack(list(values))
            motors = _motors(info, name)
            if len(motors) != matrix.shape[1]:
                motors = range(matrix.shape[1])
            found |= {f"{name}.{motor}": x for motor, x in zip(motors, matrix.T)}
        else:
            found[name] = values
    return found


def _lerobot_info(file):
    """Return what meta/info.json above a parquet file says, a dict."""
    for path in (folder / _INFO for folder in list(file.resolve().parents)[:4]):
        if path.is_file():
            with parsing(path, "JSON file", "download the data set again."):
                info = json.loads(path.read_text(encoding="utf-8"))
            return info if isinstance(info, dict) else {}
    return {}


def _motors(info, name):
    """Return the names of the motors in a column of lists, [] if unknown."""
    names = info
    for key in ("features", name, "names"):
        names = names.get(key) if isinstance(names, dict) else None
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    if not isinstance(names, list):
        return []
    return [str(motor).removesuffix(".pos") for motor in names]
