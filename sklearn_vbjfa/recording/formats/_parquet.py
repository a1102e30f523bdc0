"""Parquet and feather files, and LeRobot data sets: parquet with a folder meta."""

import json
from pathlib import Path

import numpy as np

from sklearn_vbjfa.recording._table import (
    Format,
    Source,
    Table,
    check_names,
    check_size,
    pandas_of,
    parsing,
)

_INFO = Path("meta") / "info.json"


def read_parquet(path: Source, wanted) -> Table:
    """Read a parquet or feather file; lists become columns with numbers."""
    return _table(path, _columns(path, _lerobot_info(path.file)))


def read_lerobot(path: Path, wanted, unpacked) -> Table | None:
    """Read all episodes of a LeRobot data set; None for other folders."""
    if not (path / _INFO).is_file():
        return None
    files = sorted((path / "data").rglob("*.parquet"))
    if not files:
        raise ValueError(
            f"{path}: is a LeRobot data set without parquet files in its folder data; "
            "expected data/chunk-000/*.parquet (is it downloaded completely?)."
        )
    size = sum(file.stat().st_size for file in files)
    check_size(path, size, f"give one of them, such as {files[0]}", "of parquet files")
    info = _lerobot_info(files[0])
    parts = [_columns(Source(x, x), info) for x in files]
    shared = [x for x in parts[0] if all(x in part for part in parts)]
    columns = {x: np.concatenate([part[x] for part in parts]) for x in shared}
    return _table(Source(path, path), columns)


def _table(path, columns):
    frame = pandas_of(path).DataFrame(columns)
    frame.index += 1
    return Table(path=path.shown, frame=frame)


def _columns(path, info):
    """Return the columns of a file as arrays, lists of numbers as columns each."""
    try:
        import pyarrow
        from pyarrow import ipc, parquet
    except ImportError as error:
        raise PARQUET.missing(path) from error
    with parsing(path, "parquet file of plain columns", "write it again"):
        if path.file.suffix.lower() in PARQUET.endings[:2]:
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
        matrix = _matrix(values)
        if matrix is None:
            found[name] = values
            continue
        motors = _motors(info, name)
        if len(motors) != matrix.shape[1]:
            motors = range(matrix.shape[1])
        found |= {f"{name}.{motor}": x for motor, x in zip(motors, matrix.T)}
    return found


def _matrix(values):
    """Return a column of equally long lists of numbers as a matrix, else None."""
    if values.dtype.kind != "O" or not values.size:
        return None
    if not all(isinstance(x, np.ndarray) and x.ndim == 1 for x in values):
        return None
    if len({x.size for x in values}) > 1 or values[0].dtype.kind not in "biuf":
        return None
    return np.stack(list(values)) if values[0].size else None


# -- LeRobot ---------------------------------------------------------------------------


def _lerobot_info(file):
    """Return what meta/info.json above a parquet file says, a dict."""
    for path in (folder / _INFO for folder in list(file.resolve().parents)[:4]):
        if path.is_file():
            with parsing(path, "JSON file", "download the data set again"):
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


PARQUET = Format(
    name="parquet",
    endings=(".parquet", ".pq", ".feather", ".arrow"),
    read=read_parquet,
    begins=((b"PAR1", ".parquet"), (b"ARROW1", ".feather")),
    read_folder=read_lerobot,
    marks=(_INFO.as_posix(),),
    needs=("pyarrow", "parquet files", "parquet"),
)
