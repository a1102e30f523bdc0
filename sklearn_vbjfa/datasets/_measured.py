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
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path, PurePosixPath
from urllib.parse import quote

import numpy as np
from scipy.io import loadmat
from sklearn.datasets import get_data_home

from sklearn_vbjfa.recording import Log, Recording, join, median_period

_BASE_ADDRESS = "https://raw.githubusercontent.com"
_TIMEOUT = 30.0  # [s] without a byte
_PACKAGE = resources.files("sklearn_vbjfa.datasets")
SETS = tomllib.loads(_PACKAGE.joinpath("measured.toml").read_text("utf-8"))

# -- files -----------------------------------------------------------------------------


@functools.cache
def remote_files(name):
    """Return path -> (address, SHA-256) of the public files of a set."""
    files, section = {}, ()
    for line in _PACKAGE.joinpath("remote_files.txt").read_text("utf-8").splitlines():
        if line.startswith("["):
            section = line.replace("[", "").replace("]", "").split()
        elif line and not line.startswith("#") and section[0] == name:
            sha256, _, path = line.split(maxsplit=2)
            files[path] = quote("/".join((*section[1:], path))), sha256
    return files


@dataclass(frozen=True)
class _Files:
    """Files of a set, found on disk or downloaded when they are asked for."""

    name: str
    folder: Path
    download: bool
    source: str  # of a set that is not downloaded

    def find(self, wanted=lambda path: not path.endswith((".urdf", ".xml"))):
        """Return the local file of each wanted path, by default of all data."""
        if self.source:
            return self._on_disk(wanted)
        listed = remote_files(self.name)
        return {
            path: self._file(path, *listed[path]) for path in filter(wanted, listed)
        }

    def description(self):
        """Return the path of the published URDF or MJCF, None if it is absent."""
        try:
            (local,) = self.find(lambda x: x.endswith((".urdf", ".xml"))).values()
        except FileNotFoundError:
            return None
        return str(local.resolve())

    def _on_disk(self, wanted):
        files = (x for x in sorted(self.folder.rglob("*")) if x.is_file())
        below = {x.relative_to(self.folder).as_posix(): x for x in files}
        found = {path: local for path, local in below.items() if wanted(path)}
        if not found:
            raise FileNotFoundError(
                f"{self.name}: no data in {self.folder}; put the files of the set "
                f"there, which come from {self.source} and are not downloaded."
            )
        return found

    def _file(self, path, address, sha256):
        address = f"{_BASE_ADDRESS}/{address}"
        places = [path, PurePosixPath(path).name]
        for place in (*places, *(f"original/{place}" for place in places)):
            local = self.folder / place
            if local.is_file() and _sha256(local) == sha256:
                return local
        local = self.folder / path
        if not self.download:
            raise FileNotFoundError(
                f"{self.name}: no file {path} with SHA-256 {sha256} in {self.folder}; "
                f"set download_if_missing=True, or put {address} at {local}."
            )
        # Only a download pays for the import of an HTTP client.
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


def _sha256(path):
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _urdf(where, files):
    """Return the path of a description, None if there is none, see the table."""
    if where is None or where == "published":
        return where and files.description()
    if "/" not in where:
        return str(_PACKAGE.joinpath("robots", f"{where}.urdf"))
    # The collection is found without importing it, as that loads Pinocchio.
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


def _loader(name, read) -> Callable[..., Recording]:
    """Make the public loader of a set of the function that reads its files."""
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
        logs = read(files)
        dt = entry.get("dt") or median_period(logs)
        if resample and entry.get("drop_repeated"):
            logs = [_without_repeats(log) for log in logs]
        columns = join(logs, dt=dt, resample=resample)
        return Recording(
            name=name,
            **columns,
            joint_names=tuple(entry["joint_names"]),
            position_units=_units(entry, "position_units", "rad"),
            torque_units=_units(entry, "torque_units", "N m"),
            urdf=_urdf(entry.get("urdf"), files),
            source=source or _repository(name),
            licence=entry["licence"],
            citation=entry["citation"],
            description=entry["description"],
        )

    fetch.__name__ = fetch.__qualname__ = f"fetch_{name}"
    fetch.__doc__ = _documentation(name)
    return fetch


def _without_repeats(log):
    """Leave out rows that equal the one before in every channel."""
    rows = np.column_stack([log.q, log.v, log.tau])
    keep = np.r_[True, (np.diff(rows, axis=0) != 0).any(axis=1)]
    channels = {key: getattr(log, key)[keep] for key in ("t", "q", "v", "tau")}
    return replace(log, **channels)


def _units(entry, key, usual):
    """Return a unit for each joint."""
    units = tuple(entry.get(key, [usual]))
    return units if len(units) > 1 else units * len(entry["joint_names"])


def _repository(name):
    """Return the address of the repository of a set at its commit."""
    address, _ = next(iter(remote_files(name).values()))
    owner, repository, commit, _ = address.split("/", 3)
    return f"https://github.com/{owner}/{repository}/tree/{commit}"


def _documentation(name):
    """Return the documentation of a loader, numpydoc."""
    entry = SETS[name]
    units = zip(
        entry["joint_names"],
        _units(entry, "position_units", "rad"),
        _units(entry, "torque_units", "N m"),
    )
    joints = ", ".join(f"{joint} [{q}, {tau}]" for joint, q, tau in units)
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


def _emps(files):
    logs = []
    for name, local in zip(("DATA_EMPS", "PULSES"), files.find().values(), strict=True):
        raw = loadmat(local)
        volts = raw["vir"].ravel()
        signals = {
            "q_ref": raw["qg"].reshape(-1, 1),
            "volts": volts,
            "pulses": raw.get("pulses_N", np.zeros(volts.size)).ravel(),
        }
        force = raw["gtau"].item() * volts[:, None]
        q = raw["qm"].reshape(-1, 1)
        logs.append(Log(name=name, t=raw["t"].ravel(), q=q, tau=force, signals=signals))
    return logs


# Ratio 101 times 0.125 (large) or 0.0922 (small drives) N m/A; not verified.
_UR5_GAINS = (12.63, 12.63, 12.63, 9.31, 9.31, 9.31)
_UR5_LOGS: tuple[str, ...] = (
    "q_actual",
    "qd_actual",
    "i_actual",
    "m_target",
    "i_target",
)
_UR5_LOGS += ("q_target", "qd_target", "qdd_target")


def _ur5(files):
    movements = {}
    for path, local in files.find().items():
        *_, movement, _, _ = path.split("/")
        parts = movements.setdefault(movement.split("_")[1], {})
        parts[Path(path).stem] = local
    logs = []
    for name, parts in movements.items():
        t, raw = _ur5_channels(parts)
        q, v = raw.pop("q_actual"), raw.pop("qd_actual")
        tau = np.array(_UR5_GAINS) * raw["i_actual"]
        logs.append(Log(name=name, t=t, q=q, v=v, tau=tau, signals=raw))
    return logs


def _ur5_channels(parts):
    """Return the stamps (n_samples,) [s] and channels (n_samples, 6) of a movement."""
    # The logs end at different rows, some in the middle of a line: that line and what
    # the shortest log lacks are left out.
    tables = {}
    for key in _UR5_LOGS:
        whole_lines = parts[f"log_{key}"].read_text("ascii").rpartition("\n")[0]
        tables[key] = np.loadtxt(io.StringIO(whole_lines), delimiter=",")
    n = min(map(len, tables.values()))
    return tables["q_actual"][:n, 0], {key: x[:n, 1:] for key, x in tables.items()}


_TX40_RATIOS = (32.0, 32.0, 45.0, -48.0, 45.0, 32.0)
_TX40_COUPLING = 32.0  # motor 6 also turns with joint 5
_TX40_ZEROS = (0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0)  # [rad] of the model


def _staubli_tx40(files):
    tables = {
        Path(path).stem: np.loadtxt(local, delimiter=",", skiprows=1)
        for path, local in files.find().items()
    }
    q_motor, tau_motor = tables["pos_read_data"], tables["curr_data"]
    to_motor = np.diag(_TX40_RATIOS)
    to_motor[5, 4] = _TX40_COUPLING
    return [
        Log(
            name="trajectory",
            t=0.0002 * np.arange(len(q_motor)),
            # q_motor = R q and, by virtual work, tau = R' tau_motor.
            q=np.linalg.solve(to_motor, q_motor.T).T + np.array(_TX40_ZEROS),
            tau=tau_motor @ to_motor,
            signals={"q_motor": q_motor, "tau_motor": tau_motor},
        )
    ]


def _kuka_kr300(files):
    logs = []
    for path, local in files.find().items():
        raw = loadmat(local, simplify_cells=True)
        rec, ratio = raw["rec"], raw["para"]["u"]

        def of(values):
            return np.ascontiguousarray(values.T)

        motor = of(rec["act_torque_abs_nm"])
        logs.append(
            Log(
                # The folder is called "2020-10-21 10s FF A 08ms".
                name=path.split("/")[-2].split()[3],
                t=rec["time_cont"],
                q=np.deg2rad(of(rec["act_pos_mot_deg"])),
                v=np.deg2rad(of(rec["act_vel_mot_deg_per_s"])),
                tau=ratio * motor,
                signals={
                    "torque_motor": motor,
                    "torque_motor_rel": of(rec["act_torque_rel_nm"]),
                    "tau_ff": ratio * of(raw["tau_ff_all"]),
                    "tau_grav_model": of(raw["tau_g_all"]),
                    "q_ref": np.deg2rad(of(rec["ref_pos_deg"])),
                    "v_ref": np.deg2rad(of(rec["ref_vel_simple_deg_per_s"])),
                    "q_link": np.deg2rad(of(rec["act_pos_se_deg"])[:, :3]),
                    "v_link": np.deg2rad(of(rec["act_vel_se_deg_per_s"])[:, :3]),
                },
            )
        )
    return logs


def _franka_panda(files):
    names = {"time": "t", "positions": "q", "velocity": "v", "torques": "tau"}
    raw = {}
    for path, local in files.find().items():
        key = names[Path(path).stem.removeprefix("exciting_traj_")]
        raw[key] = np.loadtxt(local).reshape((-1,) if key == "t" else (-1, 7))
    return [Log(name="exciting_traj_1", **raw)]


def _tflex_1dof(files):
    (local,) = files.find().values()
    raw = loadmat(local)
    motion, count = np.deg2rad(raw["X"]), raw["Y"].reshape(-1, 1).astype(float)
    q, v, a = np.hsplit(motion, 3)
    t = 0.001 * np.arange(len(q))
    return [Log(name="TFlexADRC_RN20", t=t, q=q, v=v, tau=count, signals={"a": a})]


_XL330_FULL_SCALE = 885  # of the duty cycle in the register "present load"


def _bam_xl330(files):
    return [_xl330_log(json.loads(x.read_text("utf-8"))) for x in files.find().values()]


def _xl330_log(raw):
    """Return the powered rows (n_samples,) of a servo log."""

    def of(key, dtype=float):
        rows = [one for one in raw["entries"] if one["torque_enable"] == 1]
        return np.array([one[key] for one in rows], dtype=dtype)

    # The register holds a signed number, logged as an unsigned one.
    duty = of("load", np.uint16).view(np.int16) / _XL330_FULL_SCALE
    supply = of("input_volts")
    return Log(
        name=f"kp{raw['kp']}_{raw['trajectory']}",
        t=of("timestamp"),
        q=of("position")[:, None],
        v=of("speed")[:, None],
        tau=(duty * supply)[:, None],
        signals={
            "q_ref": of("goal_position")[:, None],
            "duty": duty,
            "supply_volts": supply,
            "temperature": of("temp"),
            "torque_enable": of("torque_enable", np.uint8),
            "kp": np.full(duty.size, raw["kp"]),
        },
    )


def _kuka_lbr_med7(files):
    (local,) = files.find().values()
    q, tau, external = np.hsplit(np.loadtxt(local, delimiter=",", skiprows=1), 3)
    t, signals = 0.01 * np.arange(len(q)), {"tau_ext": -external}
    return [Log(name="measurements", t=t, q=q, tau=-tau, signals=signals)]


def _dfki_double_pendulum(files):
    logs = []
    for local in files.find(lambda path: "trajectory_" in path).values():
        with local.open(encoding="utf-8") as stream:
            names = stream.readline().strip().split(",")
            columns = dict(zip(names, np.loadtxt(stream, delimiter=",").T))

        def both(key, columns=columns):
            return np.column_stack([columns[f"{key}1"], columns[f"{key}2"]])

        logs.append(
            Log(
                name=local.stem.removesuffix("-PM_measured"),
                t=columns["time"],
                q=both("pos_meas"),
                v=both("vel_meas"),
                tau=both("tau_meas"),
                signals={"tau_command": both("tau_con")},
            )
        )
    return logs


_TIAGO_RATIOS = (1.0, 100.0, 100.0, 100.0, 100.0, 336.0, 336.0, 336.0)
# [N m/A] at the motor; the sign is that of the current against the joint.
_TIAGO_GAINS = (1.0, 0.136, 0.136, -0.087, -0.087, -0.0613, -0.0613, -0.0613)
# The exciting motion that the publishers use, first and last row.
_TIAGO_ROWS = (921, 6790)


def _tiago(files):
    raw = {}
    for path, local in files.find().items():
        table = np.loadtxt(local, delimiter=",", skiprows=1)
        table = table[_TIAGO_ROWS[0] : _TIAGO_ROWS[1] + 1]
        raw[Path(path).stem.removeprefix("tiago_")] = table[:, 1:]
        t = table[:, 0]  # the same in the three files
    return [
        Log(
            name="trajectory",
            t=t,
            q=raw["position"],
            v=raw["velocity"],
            tau=np.multiply(_TIAGO_RATIOS, _TIAGO_GAINS) * raw["effort"],
            signals={"effort": raw["effort"]},
        )
    ]


def _unitree_go2(files):
    logs = []
    for path, local in files.find(lambda path: path.endswith(".npz")).items():
        with np.load(local) as arrays:
            raw = {key: arrays[key].astype(float) for key in arrays}
        q, v = raw["q"], raw["v"]
        spring = raw["kp"] * (raw["q_desired"] - q)
        damper = raw["kd"] * (raw["v_desired"] - v)
        # The stamps are sums in single precision and drift by 0.02 %.
        t, signals = 0.005 * np.arange(len(q)), {}
        for name in ("q_desired", "v_desired", "kp", "kd"):
            signals[name] = np.broadcast_to(raw[name], q.shape).copy()
        name, tau = Path(path).stem, spring + damper
        logs.append(Log(name=name, t=t, q=q, v=v, tau=tau, signals=signals))
    return logs


fetch_bam_xl330 = _loader("bam_xl330", _bam_xl330)
fetch_dfki_double_pendulum = _loader("dfki_double_pendulum", _dfki_double_pendulum)
fetch_emps = _loader("emps", _emps)
fetch_franka_panda = _loader("franka_panda", _franka_panda)
fetch_kuka_kr300 = _loader("kuka_kr300", _kuka_kr300)
fetch_kuka_lbr_med7 = _loader("kuka_lbr_med7", _kuka_lbr_med7)
fetch_staubli_tx40 = _loader("staubli_tx40", _staubli_tx40)
fetch_tflex_1dof = _loader("tflex_1dof", _tflex_1dof)
fetch_tiago = _loader("tiago", _tiago)
fetch_unitree_go2 = _loader("unitree_go2", _unitree_go2)
fetch_ur5 = _loader("ur5", _ur5)
