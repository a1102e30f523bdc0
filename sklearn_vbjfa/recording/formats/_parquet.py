"""Parquet files, and LeRobot data sets, which are parquet files with a folder meta."""

import json
from collections import Counter
from pathlib import Path

import numpy as np

from sklearn_vbjfa.recording._table import Format, Source, Table, check_size

# Columns of several numbers per row, as LeRobot calls those of a robot's state.
_INFO = Path("meta") / "info.json"
# What the robot's calibration is called where it was put beside it.
_CALIBRATION = Path("meta") / "calibration.json"
# Positions of a motor, and counts of its encoder in a turn: motors of LeRobot's arms
# have 12 bits.
_POSITIONS, _COUNTS = ("observation.state.", "action."), 4096
# Grippers go from 0 to 100 of their range, and all else from -100 to 100; lerobot/
# motors/motors_bus.py and robots/so_follower of github.com/huggingface/lerobot.
_GRIPPER = "gripper"
_ENDS = ("range_min", "range_max")


def read_parquet(path: Source, wanted) -> Table:
    """Read a parquet file with pyarrow; lists become columns with numbers."""
    columns, shares = _columns(path), {}
    info = _lerobot_info(path.file)
    if info is not None:
        columns = _with_names(columns, info)
        shares = _shares(path.file, columns)
    return Table(path=path.shown, columns=_flat(columns), shares=shares)


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
    info = _lerobot_info(files[0]) or {}
    parts = [_flat(_with_names(_columns(Source(x, x)), info)) for x in files]
    shared = [x for x in parts[0] if all(x in part for part in parts)]
    columns = {x: np.concatenate([part[x] for part in parts]) for x in shared}
    return Table(path=path, columns=columns, shares=_shares(files[0], columns))


def _columns(path):
    """Return the columns of a parquet file."""
    try:
        from pyarrow import ArrowException, parquet
    except ImportError as error:
        raise PARQUET.missing(path) from error
    try:
        with parquet.ParquetFile(path.file) as file:
            groups = (file.metadata.row_group(k) for k in range(file.num_row_groups))
            check_size(path, sum(group.total_byte_size for group in groups))
            read = file.read()
        arrays = [column.to_numpy() for column in read.columns]
    except (ArrowException, OSError, UnicodeDecodeError) as error:
        reason = str(error).splitlines()[0].rstrip(".")
        raise ValueError(
            f"{path}: is not a complete parquet file of plain columns ({reason}); "
            "write it anew."
        ) from error
    twice = [name for name, count in Counter(read.column_names).items() if count > 1]
    if twice:
        raise ValueError(
            f"{path}: has column {twice[0]!r} twice; each column needs its own name."
        )
    return dict(zip(read.column_names, arrays))


def _lerobot_info(file, name=_INFO):
    """Return what the folder meta above a parquet file says of its columns, or None."""
    for folder in list(file.resolve().parents)[:4]:
        if (folder / name).is_file():
            try:
                info = json.loads((folder / name).read_text(encoding="utf-8"))
            except (ValueError, OSError, RecursionError) as error:
                raise ValueError(
                    f"{folder / name}: is not a complete JSON file ({error}); "
                    "download the data set anew."
                ) from error
            return info if isinstance(info, dict) else {}
    return None


def _shares(file, columns):
    """Return [rad] of one per cent of a motor's range, by column; empty if unknown."""
    found = {}
    for motor, one in (_lerobot_info(file, _CALIBRATION) or {}).items():
        ends = [one.get(x) if isinstance(one, dict) else None for x in _ENDS]
        if not all(type(x) is int for x in ends) or not ends[0] < ends[1]:
            raise ValueError(
                f"{_CALIBRATION}: motor {motor!r} has the ends {ends}; expected "
                f"{' and '.join(_ENDS)}, counts of the encoder that rise, as LeRobot "
                "calibrates them."
            )
        per_cent = 2 * np.pi / _COUNTS * (ends[1] - ends[0]) / 100
        if motor != _GRIPPER:
            per_cent /= 2
        names = (f"{position}{motor}" for position in _POSITIONS)
        found |= {name: per_cent for name in names if name in columns}
    return found


def _with_names(columns, info):
    """Spread lists of one number per motor over columns with the motors' names."""
    features = info.get("features")
    features = features if isinstance(features, dict) else {}
    spread = {}
    for name, values in columns.items():
        feature = features.get(name)
        names = feature.get("names") if isinstance(feature, dict) else None
        if isinstance(names, dict):
            names = next(iter(names.values()), None)
        matrix = _matrix(values)
        if (
            matrix is None
            or not isinstance(names, list)
            or len(names) != matrix.shape[1]
        ):
            spread[name] = values
            continue
        for motor, column in zip(names, matrix.T):
            spread[f"{name}.{str(motor).removesuffix('.pos')}"] = column
    return spread


def _flat(columns):
    """Spread what is left of lists over columns with numbers from 0."""
    spread = {}
    for name, values in columns.items():
        matrix = _matrix(values)
        if matrix is None:
            spread[name] = values
        else:
            spread |= {f"{name}.{k}": x for k, x in enumerate(matrix.T)}
    return spread


def _matrix(values):
    """Return a column of equally long lists of numbers as a matrix, else None."""
    if values.dtype.kind != "O" or not values.size:
        return None
    if not all(isinstance(x, np.ndarray) and x.ndim == 1 for x in values):
        return None
    if len({x.size for x in values}) > 1 or values[0].dtype.kind not in "biuf":
        return None
    return np.stack(list(values)) if values[0].size else None


PARQUET = Format(
    name="parquet",
    endings=(".parquet", ".pq"),
    read=read_parquet,
    begins=((b"PAR1", ".parquet"),),
    read_folder=read_lerobot,
    marks=(_INFO.as_posix(),),
    needs=("pyarrow", "parquet files"),
)
