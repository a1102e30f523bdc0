"""The measured sets: a table, a loader, and the readers of their files."""

import functools
import hashlib
import importlib.metadata
import io
import json
import os
import sys
import textwrap
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path, PurePosixPath
from urllib.parse import quote

import numpy as np
from scipy.io import loadmat
from sklearn.datasets import get_data_home

from sklearn_vbjfa.recording import Log, Recording, join

_BASE_ADDRESS = "https://raw.githubusercontent.com"
_TIMEOUT = 30.0  # [s] without data
_PACKAGE = resources.files("sklearn_vbjfa.datasets")
SETS = tomllib.loads(_PACKAGE.joinpath("measured.toml").read_text("utf-8"))

# -- files -----------------------------------------------------------------------------


@functools.cache
def remote_files(name):
    """Return a mapping of path to (address, SHA-256) of the public files of a set."""
    text = _PACKAGE.joinpath("remote_files.txt").read_text("utf-8")
    section = text.partition(f"[{name}] ")[2].partition("\n[")[0]
    source, *rows = section.splitlines() or [""]
    files = (row.split(maxsplit=2) for row in rows)
    folder = source.replace(" ", "/")
    return {path: (quote(f"{folder}/{path}"), sha256) for sha256, _, path in files}


@dataclass(frozen=True)
class _Files:
    """Files of a set, on disk or downloaded on request."""

    name: str
    folder: Path
    download: bool
    source: str  # of a set that cannot be downloaded, else empty

    def find(self, wanted=lambda path: not path.endswith((".urdf", ".xml"))):
        """Return a mapping of wanted paths to local files, by default of all data."""
        if not self.source:
            remote = remote_files(self.name)
            return {x: self._file(x, *remote[x]) for x in filter(wanted, remote)}
        files = (x for x in sorted(self.folder.rglob("*")) if x.is_file())
        below = {x.relative_to(self.folder).as_posix(): x for x in files}
        if not any(map(wanted, below)):
            raise FileNotFoundError(
                f"{self.name}: no data in {self.folder}; put the files of the set "
                f"there, which come from {self.source} and are not downloaded."
            )
        return {path: local for path, local in below.items() if wanted(path)}

    def description(self):
        """Return the path of the published URDF or MJCF, None if it is absent."""
        try:
            (local,) = self.find(lambda x: x.endswith((".urdf", ".xml"))).values()
        except FileNotFoundError:
            return None
        return str(local.resolve())

    def _file(self, path, address, sha256):
        address, local = f"{_BASE_ADDRESS}/{address}", self.folder / path
        for folder in (self.folder, self.folder / "original"):
            for candidate in (folder / path, folder / PurePosixPath(path).name):
                data = candidate.read_bytes() if candidate.is_file() else b""
                if hashlib.sha256(data).hexdigest() == sha256:
                    return candidate
        if not self.download:
            raise FileNotFoundError(
                f"{self.name}: no file {path} with SHA-256 {sha256} in {self.folder}; "
                f"set download_if_missing=True, or put {address} at {local}."
            )
        # The HTTP client is imported only if a download is needed.
        import pooch

        try:
            pooch.retrieve(
                address,
                known_hash=sha256,
                fname=local.name,
                path=local.parent,
                downloader=pooch.HTTPDownloader(timeout=_TIMEOUT),
            )
        except (OSError, ValueError) as error:
            raise OSError(
                f"Cannot download {address}: {' '.join(str(error).split())}. Without a "
                f"network, put the file at {local}."
            ) from error
        return local


def _urdf(where, files):
    """Return the path of the description that the table names, or None."""
    if where is None or where == "published":
        return where and files.description()
    if "/" not in where:
        return str(_PACKAGE.joinpath("robots", f"{where}.urdf"))
    # The package is located without an import, as that would load Pinocchio.
    try:
        collection = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        collection = []
    candidates = [
        files.folder / Path(where).name,
        *(Path(x.locate()) for x in collection if str(x).endswith(where)),
        Path(sys.prefix, "share/example-robot-data/robots", where),
    ]
    return next((str(x.resolve()) for x in candidates if x.is_file()), None)


# -- the loader ------------------------------------------------------------------------

_DOCUMENTATION = """\
{text}
Parameters
----------
data_home : path-like or None, default=None
    Folder that contains the folder ``{name}``; by default ``sklearn_vbjfa`` in
    scikit-learn's data folder.
download_if_missing : bool, default=True
    Whether to download absent files instead of raising an error.
{options}
Returns
-------
recording : Recording
    `q` and `tau` (n_samples, {nv}) of
    {joints}.

Raises
------
OSError
    If a file is absent and may not or cannot be downloaded.

Notes
-----
Licence: {licence}.

References
----------
{reference}
"""
_RESAMPLE = """\
resample : bool, default=True
    Whether to interpolate on a uniform time grid: positions by a cubic spline, all else
    linearly. If False, samples and stamps are as recorded.
"""


def _loader(read) -> Callable[..., Recording]:
    """Turn the function that reads the files of a set into its public loader."""
    name = read.__name__.removeprefix("fetch_")
    entry = SETS[name]

    def fetch(
        *,
        data_home: str | os.PathLike | None = None,
        download_if_missing: bool = True,
        resample: bool = True,
    ) -> Recording:
        home = data_home or Path(get_data_home(), "sklearn_vbjfa")
        folder, source = Path(home).expanduser() / name, entry.get("source", "")
        files = _Files(name, folder, download_if_missing, source)
        logs = list(read(files))
        steps = np.concatenate([np.diff(log.t) for log in logs])
        dt = entry.get("dt", round(float(np.median(steps)), 7))
        if resample and entry.get("drop_repeated"):
            logs = [_without_repeats(log) for log in logs]
        return Recording(
            name=name,
            **join(logs, dt=dt, resample=resample),
            joint_names=tuple(entry["joint_names"]),
            position_units=_units(entry, "position_units", "rad"),
            torque_units=_units(entry, "torque_units", "N m"),
            urdf=_urdf(entry.get("urdf"), files),
            source=source or _repository(name),
            licence=entry["licence"],
            citation=entry["citation"],
            description=entry["description"],
        )

    fetch.__name__ = fetch.__qualname__ = read.__name__
    fetch.__doc__ = _documentation(name)
    return fetch


def _without_repeats(log):
    """Remove rows that equal the previous one in every channel."""
    rows = np.column_stack(list(log.channels.values()))
    keep = np.r_[True, (np.diff(rows, axis=0) != 0).any(axis=1)]
    return Log(log.name, log.t[keep], {key: x[keep] for key, x in log.channels.items()})


def _units(entry, key, usual):
    units = tuple(entry.get(key, [usual]))
    return units if len(units) > 1 else units * len(entry["joint_names"])


def _repository(name):
    """Return the address of the repository of a set at its pinned commit."""
    address, _ = next(iter(remote_files(name).values()))
    owner, repository, commit, _ = address.split("/", 3)
    return f"https://github.com/{owner}/{repository}/tree/{commit}"


def _documentation(name):
    entry = SETS[name]
    units = _units(entry, "position_units", "rad"), _units(entry, "torque_units", "N m")
    joints = ", ".join(
        f"{joint} [{q}, {tau}]" for joint, q, tau in zip(entry["joint_names"], *units)
    )
    citation = f".. [1] {entry['citation']}"
    return _DOCUMENTATION.format(
        text=entry["text"],
        name=name,
        options=_RESAMPLE * entry.get("irregular", False),
        nv=len(entry["joint_names"]),
        joints=textwrap.fill(joints, 76, subsequent_indent="    "),
        licence=entry["licence"],
        reference=textwrap.fill(citation, 76, subsequent_indent="   "),
    )


# -- the sets --------------------------------------------------------------------------


@_loader
def fetch_emps(files):
    for name, local in zip(("DATA_EMPS", "PULSES"), files.find().values(), strict=True):
        raw = loadmat(local)
        volts = raw["vir"].ravel()
        channels = {
            "q": raw["qm"].reshape(-1, 1),
            "tau": raw["gtau"].item() * volts[:, None],
            "q_ref": raw["qg"].reshape(-1, 1),
            "volts": volts,
            "pulses": raw.get("pulses_N", np.zeros(volts.size)).ravel(),
        }
        yield Log(name, raw["t"].ravel(), channels)


# Ratio 101 times 0.125 (large) or 0.0922 (small drives) N m/A; not verified.
_UR5_GAINS = (12.63, 12.63, 12.63, 9.31, 9.31, 9.31)
_UR5_SIGNALS = ("i_actual", "m_target", "i_target")
_UR5_REFERENCE = ("q_target", "qd_target", "qdd_target")


@_loader
def fetch_ur5(files):
    movements = {}
    for path, local in files.find().items():
        *_, movement, _, _ = path.split("/")
        paths = movements.setdefault(movement.split("_")[1], {})
        paths[Path(path).stem.removeprefix("log_")] = local
    for name, paths in movements.items():
        keys = ("q_actual", "qd_actual", *_UR5_SIGNALS, *_UR5_REFERENCE)
        # The last line may be truncated.
        texts = {key: paths[key].read_text("ascii").rpartition("\n")[0] for key in keys}
        raw = {k: np.loadtxt(io.StringIO(x), delimiter=",") for k, x in texts.items()}
        n = min(map(len, raw.values()))
        t, raw = raw["q_actual"][:n, 0], {key: x[:n, 1:] for key, x in raw.items()}
        q, v = raw.pop("q_actual"), raw.pop("qd_actual")
        tau = np.array(_UR5_GAINS) * raw["i_actual"]
        yield Log(name, t, {"q": q, "v": v, "tau": tau, **raw})


_TX40_RATIOS = (32.0, 32.0, 45.0, -48.0, 45.0, 32.0)
_TX40_COUPLING = 32.0  # motor 6 also turns with joint 5
_TX40_ZEROS = (0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0)  # [rad] of the model


@_loader
def fetch_staubli_tx40(files):
    tables = {
        Path(path).stem: np.loadtxt(local, delimiter=",", skiprows=1)
        for path, local in files.find().items()
    }
    q_motor, tau_motor = tables["pos_read_data"], tables["curr_data"]
    to_motor = np.diag(_TX40_RATIOS)
    to_motor[5, 4] = _TX40_COUPLING
    channels = {
        # q_motor = R q and, by virtual work, tau = R' tau_motor.
        "q": np.linalg.solve(to_motor, q_motor.T).T + np.array(_TX40_ZEROS),
        "tau": tau_motor @ to_motor,
        "q_motor": q_motor,
        "tau_motor": tau_motor,
    }
    yield Log("trajectory", 0.0002 * np.arange(len(q_motor)), channels)


@_loader
def fetch_kuka_kr300(files):
    for path, local in files.find().items():
        raw = loadmat(local, simplify_cells=True)
        ratio = raw["para"]["u"]
        # Rows of the file are joints.
        rec = {key: np.transpose(x).copy() for key, x in raw["rec"].items()}
        channels = {
            "q": np.deg2rad(rec["act_pos_mot_deg"]),
            "v": np.deg2rad(rec["act_vel_mot_deg_per_s"]),
            "tau": ratio * rec["act_torque_abs_nm"],
            "torque_motor": rec["act_torque_abs_nm"],
            "torque_motor_rel": rec["act_torque_rel_nm"],
            "tau_ff": ratio * raw["tau_ff_all"].T,
            "tau_grav_model": raw["tau_g_all"].T,
            "q_ref": np.deg2rad(rec["ref_pos_deg"]),
            "v_ref": np.deg2rad(rec["ref_vel_simple_deg_per_s"]),
            "q_link": np.deg2rad(rec["act_pos_se_deg"])[:, :3],
            "v_link": np.deg2rad(rec["act_vel_se_deg_per_s"])[:, :3],
        }
        # The folder name is, for instance, "2020-10-21 10s FF A 08ms".
        yield Log(path.split("/")[-2].split()[3], rec["time_cont"], channels)


@_loader
def fetch_franka_panda(files):
    raw = {Path(path).stem: np.loadtxt(x) for path, x in files.find().items()}
    channels = {
        key: raw[f"exciting_traj_{name}"].reshape(-1, 7)
        for key, name in (("q", "positions"), ("v", "velocity"), ("tau", "torques"))
    }
    yield Log("exciting_traj_1", raw["exciting_traj_time"].ravel(), channels)


@_loader
def fetch_tflex_1dof(files):
    (local,) = files.find().values()
    raw = loadmat(local)
    channels = dict(zip("qva", np.hsplit(np.deg2rad(raw["X"]), 3)))
    channels["tau"] = raw["Y"].reshape(-1, 1).astype(float)
    yield Log("TFlexADRC_RN20", 0.001 * np.arange(len(raw["X"])), channels)


_XL330_FULL_SCALE = 885  # of the duty cycle in the register "present load"


@_loader
def fetch_bam_xl330(files):
    for local in files.find().values():
        raw = json.loads(local.read_text("utf-8"))
        powered = [row for row in raw["entries"] if row["torque_enable"] == 1]
        columns = {key: np.array([row[key] for row in powered]) for key in powered[0]}
        # The register holds a signed number, logged as an unsigned one.
        duty = columns["load"].astype(np.uint16).view(np.int16) / _XL330_FULL_SCALE
        supply = columns["input_volts"].astype(float)
        channels = {
            "q": columns["position"][:, None].astype(float),
            "v": columns["speed"][:, None].astype(float),
            "tau": (duty * supply)[:, None],
            "q_ref": columns["goal_position"][:, None].astype(float),
            "duty": duty,
            "supply_volts": supply,
            "temperature": columns["temp"].astype(float),
            "torque_enable": columns["torque_enable"].astype(np.uint8),
            "kp": np.full(duty.size, raw["kp"]),
        }
        name = f"kp{raw['kp']}_{raw['trajectory']}"
        yield Log(name, columns["timestamp"].astype(float), channels)


@_loader
def fetch_kuka_lbr_med7(files):
    (local,) = files.find().values()
    q, tau, external = np.hsplit(np.loadtxt(local, delimiter=",", skiprows=1), 3)
    channels = {"q": q, "tau": -tau, "tau_ext": -external}
    yield Log("measurements", 0.01 * np.arange(len(q)), channels)


@_loader
def fetch_dfki_double_pendulum(files):
    for local in files.find(lambda path: "trajectory_" in path).values():
        with local.open(encoding="utf-8") as stream:
            names = stream.readline().strip().split(",")
            columns = dict(zip(names, np.loadtxt(stream, delimiter=",").T))
        wanted = {"q": "pos_meas", "v": "vel_meas", "tau": "tau_meas"}
        wanted["tau_command"] = "tau_con"
        channels = {
            key: np.column_stack([columns[f"{name}1"], columns[f"{name}2"]])
            for key, name in wanted.items()
        }
        yield Log(local.stem.removesuffix("-PM_measured"), columns["time"], channels)


_TIAGO_RATIOS = (1.0, 100.0, 100.0, 100.0, 100.0, 336.0, 336.0, 336.0)
# [N m/A] at the motor; negative if current and joint have opposite directions.
_TIAGO_GAINS = (1.0, 0.136, 0.136, -0.087, -0.087, -0.0613, -0.0613, -0.0613)
# First and last row of the exciting trajectory that the publishers use.
_TIAGO_ROWS = (921, 6790)


@_loader
def fetch_tiago(files):
    first, last = _TIAGO_ROWS
    raw = {
        Path(path).stem: np.loadtxt(local, delimiter=",", skiprows=1)[first : last + 1]
        for path, local in files.find().items()
    }
    # The three files have the same time stamps.
    t, effort = raw["tiago_position"][:, 0], raw["tiago_effort"][:, 1:]
    channels = {
        "q": raw["tiago_position"][:, 1:],
        "v": raw["tiago_velocity"][:, 1:],
        "tau": np.multiply(_TIAGO_RATIOS, _TIAGO_GAINS) * effort,
        "effort": effort,
    }
    yield Log("trajectory", t, channels)


@_loader
def fetch_unitree_go2(files):
    for path, local in files.find(lambda path: path.endswith(".npz")).items():
        with np.load(local) as arrays:
            raw = {key: arrays[key].astype(float) for key in arrays}
        q, v = raw["q"], raw["v"]
        spring = raw["kp"] * (raw["q_desired"] - q)
        damper = raw["kd"] * (raw["v_desired"] - v)
        channels = {"q": q, "v": v, "tau": spring + damper}
        for name in ("q_desired", "v_desired", "kp", "kd"):
            channels[name] = np.broadcast_to(raw[name], q.shape).copy()
        # Time stamps are accumulated in single precision and drift by 0.02 %.
        yield Log(Path(path).stem, 0.005 * np.arange(len(q)), channels)
