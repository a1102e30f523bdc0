"""A LeRobot data set of two episodes at 100 Hz."""

import json

import numpy as np
import pyarrow
from pyarrow import parquet


def write_lerobot(folder, names, values, files, **info):
    """Write values (n, 2) by their keys, split evenly over the files."""
    (folder / "meta").mkdir(parents=True)
    feature = {"dtype": "float32", "shape": [2], "fps": 100, "names": names}
    info |= {"fps": 100, "features": dict.fromkeys(values, feature)}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    n = len(values["action"])
    half = n // 2
    for name, rows in zip(files, np.array_split(np.arange(n), len(files))):
        columns = {key: list(x[rows]) for key, x in values.items()}
        columns["timestamp"] = (0.01 * (rows % half)).astype("f4")
        columns |= {"frame_index": rows % half, "index": rows}
        columns |= {"episode_index": rows // half, "task_index": 0 * rows}
        parquet.write_table(pyarrow.table(columns), data / f"{name}.parquet")
    return folder
