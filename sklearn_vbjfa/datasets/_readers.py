"""What each measured set's files hold: one reader a set, from its files to its logs.

A reader takes the `DataFiles` of its set and the options of its public loader. Where
the published arrays need more than a call to be read, a function beside it returns
them as published; the reader then brings them to joints, radians and newton metres.
"""

import io
import json
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from sklearn_vbjfa.datasets._download import DataFiles
from sklearn_vbjfa.recording import Log

# -- EMPS ------------------------------------------------------------------------------


def read_emps(files: DataFiles) -> list[Log]:
    """Return the slide: two repeats of one reference, one with force pulses."""
    logs = []
    for name, local in zip(("DATA_EMPS", "PULSES"), files.find().values(), strict=True):
        raw = {key: x for key, x in loadmat(local).items() if not key.startswith("__")}
        gain = raw["gtau"].item()
        volts, reference = raw["vir"].ravel(), raw["qg"].ravel()
        pulses = raw["pulses_N"].ravel() if "pulses_N" in raw else np.zeros(volts.size)
        logs.append(
            Log(
                name=name,
                t=raw["t"].ravel(),
                q=raw["qm"].reshape(-1, 1),
                tau=gain * volts[:, None],
                signals={
                    "q_ref": reference[:, None],
                    "volts": volts,
                    "pulses": pulses,
                },
            )
        )
    return logs


# -- T-Flex ----------------------------------------------------------------------------

TFLEX_PERIOD = 0.001  # [s]


def read_tflex_1dof(files: DataFiles) -> list[Log]:
    """Return the log of the hinge, in radians."""
    (local,) = files.find().values()
    raw = tflex_arrays(local)
    motion = np.deg2rad(raw["X"])
    return [
        Log(
            name="TFlexADRC_RN20",
            t=TFLEX_PERIOD * np.arange(len(motion)),
            q=motion[:, [0]],
            v=motion[:, [1]],
            tau=raw["Y"][:, None].astype(float),
            signals={"a": motion[:, [2]]},
        )
    ]


def tflex_arrays(path: Path) -> dict:
    """X (n_samples, 3) [deg, deg/s, deg/s^2] and Y (n_samples,) [count]."""
    raw = loadmat(path)
    return {"X": raw["X"], "Y": raw["Y"].ravel()}


# -- Dynamixel XL330 -------------------------------------------------------------------

# Full scale of the duty cycle in the register "present load".
_XL330_FULL_SCALE = 885


def read_bam_xl330(files: DataFiles, include_free_swing: bool = False) -> list[Log]:
    """Return the logs of the servo; those without power are logs of their own."""
    logs = []
    for local in files.find().values():
        raw = xl330_arrays(local)
        name = f"kp{raw['kp']}_{raw['trajectory']}"
        powered = raw["torque_enable"] == 1
        logs.append(_xl330_log(name, raw, powered))
        if include_free_swing and not powered.all():
            logs.append(_xl330_log(f"{name}_free", raw, ~powered))
    return logs


def _xl330_log(name: str, raw: dict, rows: np.ndarray) -> Log:
    """Keep the rows (n_samples,) of a servo log."""
    raw = {key: x[rows] if np.ndim(x) else x for key, x in raw.items()}
    return Log(
        name=name,
        t=raw["timestamp"],
        q=raw["position"][:, None],
        v=raw["speed"][:, None],
        tau=(raw["pwm_duty"] * raw["input_volts"])[:, None],
        signals={
            "q_ref": raw["goal_position"][:, None],
            "duty": raw["pwm_duty"],
            "supply_volts": raw["input_volts"],
            "temperature": raw["temp"],
            "torque_enable": raw["torque_enable"],
            "kp": np.full(len(raw["timestamp"]), raw["kp"]),
        },
    )


def xl330_arrays(path: Path) -> dict:
    """Arrays (n_samples,) of a log and its header; the duty cycle is signed."""
    raw = json.loads(path.read_text("utf-8"))
    entries = raw.pop("entries")
    channels = ["position", "speed", "input_volts", "temp", "timestamp"]
    arrays = {
        key: np.array([entry[key] for entry in entries], dtype=float)
        for key in [*channels, "goal_position"]
    }
    load = np.array([entry["load"] for entry in entries], dtype=np.uint16)
    enabled = np.array([entry["torque_enable"] for entry in entries], dtype=np.uint8)
    return {
        **raw,
        **arrays,
        "torque_enable": enabled,
        "load_raw_u16": load,
        # The register holds a signed number, logged as an unsigned one.
        "pwm_duty": load.view(np.int16) / _XL330_FULL_SCALE,
    }


# -- DFKI double pendulum --------------------------------------------------------------


def read_dfki_double_pendulum(files: DataFiles, which: str = "short") -> list[Log]:
    """Return the short runs (measured torque) or the long one (commanded)."""
    if which not in ("short", "long"):
        raise ValueError(
            f"which must be 'short' (measured torque) or 'long' (commanded torque), "
            f"got {which!r}."
        )
    measured = which == "short"
    suffix = "_meas" if measured else ""
    logs = []
    for local in files.find(lambda x: ("trajectory_" in x) == measured).values():
        raw = dfki_arrays(local)
        logs.append(
            Log(
                name=local.stem.removesuffix("-PM_measured"),
                t=raw["time"],
                q=_both_joints(raw, f"pos{suffix}"),
                v=_both_joints(raw, f"vel{suffix}"),
                tau=_both_joints(raw, f"tau{suffix}"),
                signals={"tau_command": _both_joints(raw, "tau_con")}
                if measured
                else {},
            )
        )
    return logs


def _both_joints(raw: dict, key: str) -> np.ndarray:
    """Columns key1, key2 as (n_samples, 2)."""
    return np.column_stack([raw[f"{key}1"], raw[f"{key}2"]])


def dfki_arrays(path: Path) -> dict:
    """Columns (n_samples,) of a file, names and values unchanged."""
    with path.open(encoding="utf-8") as stream:
        names = stream.readline().strip().split(",")
        table = np.loadtxt(stream, delimiter=",")
    return dict(zip(names, table.T, strict=True))


# -- Universal Robots UR5 --------------------------------------------------------------

UR5_PERIOD = 0.008  # [s] of the controller
# Ratio 101 times 0.125 (large) or 0.0922 (small drives) N m/A; not verified.
UR5_GAINS = (12.63, 12.63, 12.63, 9.31, 9.31, 9.31)
_UR5_LOGS = (
    "q_actual",
    "qd_actual",
    "i_actual",
    "m_target",
    "i_target",
    "q_target",
    "qd_target",
    "qdd_target",
)


def read_ur5(files: DataFiles, gains=UR5_GAINS) -> list[Log]:
    """Return the movements; `gains` (6,) [N m/A] make torques of currents."""
    gains = np.asarray(gains, dtype=float)
    if gains.shape != (6,) or not np.isfinite(gains).all():
        raise ValueError(f"gains must hold six finite numbers [N m/A], got {gains}.")
    movements = {}
    for path, local in files.find().items():
        movement = path.split("/")[-3]
        movements.setdefault(movement, {})[Path(path).stem] = local
    logs = []
    for movement, parts in movements.items():
        raw = ur5_arrays(parts)
        logs.append(
            Log(
                name=movement.split("_")[1],
                t=raw.pop("t"),
                q=raw.pop("q_actual"),
                v=raw.pop("qd_actual"),
                tau=gains * raw["i_actual"],
                signals=raw,
            )
        )
    return logs


def ur5_arrays(parts: dict[str, Path]) -> dict:
    """Stamps t [s] (n_samples,) and the eight logs (n_samples, 6) of a movement."""
    # The logs end at different rows, some in the middle of a line: that line and what
    # the shortest log lacks are left out.
    tables = {}
    for key in _UR5_LOGS:
        whole_lines = parts[f"log_{key}"].read_text("ascii").rpartition("\n")[0]
        tables[key] = np.loadtxt(io.StringIO(whole_lines), delimiter=",")
    n_samples = min(len(table) for table in tables.values())
    arrays = {key: table[:n_samples, 1:] for key, table in tables.items()}
    # Each log has stamps of its own, at most 0.1 ms apart in a row.
    return {"t": tables["q_actual"][:n_samples, 0], **arrays}


# -- Staubli TX40 ----------------------------------------------------------------------

TX40_PERIOD = 0.0002  # [s]
_TX40_RATIOS = (32.0, 32.0, 45.0, -48.0, 45.0, 32.0)
_TX40_COUPLING = 32.0  # motor 6 also turns with joint 5
_TX40_ZEROS = (0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0)  # [rad] of the model


def read_staubli_tx40(files: DataFiles) -> list[Log]:
    """Return the trajectory, from the motors to the joints."""
    raw = tx40_arrays(files.find())
    to_motor = np.diag(_TX40_RATIOS)
    to_motor[5, 4] = _TX40_COUPLING
    q_motor, tau_motor = raw["q_motor_rad"], raw["tau_motor_Nm"]
    return [
        Log(
            name="trajectory",
            t=TX40_PERIOD * np.arange(len(q_motor)),
            # q_motor = R q and, by virtual work, tau = R' tau_motor.
            q=np.linalg.solve(to_motor, q_motor.T).T + np.array(_TX40_ZEROS),
            tau=tau_motor @ to_motor,
            signals={"q_motor": q_motor, "tau_motor": tau_motor},
        )
    ]


def tx40_arrays(files: dict[str, Path]) -> dict:
    """Motor angles [rad] and motor torques [N m], (n_samples, 6) each."""
    local = {Path(path).stem: file for path, file in files.items()}
    return {
        "q_motor_rad": np.loadtxt(local["pos_read_data"], delimiter=",", skiprows=1),
        "tau_motor_Nm": np.loadtxt(local["curr_data"], delimiter=",", skiprows=1),
    }


# -- KUKA KR300 ------------------------------------------------------------------------


def read_kuka_kr300(files: DataFiles) -> list[Log]:
    """Return both trajectories, from the motors to the joints."""
    logs = []
    for path, local in files.find().items():
        raw = kr300_arrays(local)
        ratio = raw["gear_ratio"]
        logs.append(
            Log(
                # The folder is called "2020-10-21 10s FF A 08ms".
                name=path.split("/")[-2].split()[3],
                t=raw["t"],
                q=np.deg2rad(raw["q_mot_deg"]),
                v=np.deg2rad(raw["v_mot_deg_s"]),
                tau=ratio * raw["torque_abs_Nm"],
                signals={
                    "torque_motor": raw["torque_abs_Nm"],
                    "torque_motor_rel": raw["torque_rel_Nm"],
                    "tau_ff": ratio * raw["tau_ff"],
                    "tau_grav_model": raw["tau_grav_model"],
                    "q_ref": np.deg2rad(raw["q_ref_deg"]),
                    "v_ref": np.deg2rad(raw["v_ref_deg_s"]),
                    "q_link": np.deg2rad(raw["q_link_deg"][:, :3]),
                    "v_link": np.deg2rad(raw["v_link_deg_s"][:, :3]),
                },
            )
        )
    return logs


def kr300_arrays(path: Path) -> dict:
    """Stamps [s] (n_samples,), channels (n_samples, 6) and gear ratios (6,)."""
    raw = loadmat(path, simplify_cells=True)
    rec = raw["rec"]
    channels = {
        "q_link_deg": rec["act_pos_se_deg"],
        "q_mot_deg": rec["act_pos_mot_deg"],
        "v_link_deg_s": rec["act_vel_se_deg_per_s"],
        "v_mot_deg_s": rec["act_vel_mot_deg_per_s"],
        "torque_abs_Nm": rec["act_torque_abs_nm"],
        "torque_rel_Nm": rec["act_torque_rel_nm"],
        "q_ref_deg": rec["ref_pos_deg"],
        "v_ref_deg_s": rec["ref_vel_simple_deg_per_s"],
        "error_pos_deg": rec["error_pos_deg"],
        "tau_ff": raw["tau_ff_all"],
        "tau_grav_model": raw["tau_g_all"],
    }
    return {
        "t": rec["time_cont"],
        **{key: np.ascontiguousarray(x.T) for key, x in channels.items()},
        "gear_ratio": raw["para"]["u"],
    }


# -- Franka Emika Panda ----------------------------------------------------------------


def read_franka_panda(files: DataFiles) -> list[Log]:
    """Return the exciting trajectory."""
    return [Log(name="exciting_traj_1", **franka_arrays(files.find()))]


def franka_arrays(files: dict[str, Path]) -> dict:
    """Stamps t [s] (n_samples,) and q, v, tau (n_samples, 7)."""
    names = {"time": "t", "positions": "q", "velocity": "v", "torques": "tau"}
    raw = {}
    for path, local in files.items():
        values = np.loadtxt(local)
        key = names[Path(path).stem.removeprefix("exciting_traj_")]
        raw[key] = values if key == "t" else values.reshape(-1, 7)
    return raw


# -- KUKA LBR Med 7 --------------------------------------------------------------------

LBR_PERIOD = 0.01  # [s]


def read_kuka_lbr_med7(files: DataFiles, which: str = "fast") -> list[Log]:
    """Return logs with the usual sign of torque; the slow one has no public address."""
    if which not in ("fast", "slow", "all"):
        raise ValueError(f"which must be 'fast', 'slow' or 'all', got {which!r}.")
    tables = {}
    if which != "slow":
        (local,) = files.find().values()
        tables["measurements"] = lbr_arrays(local)
    if which != "fast":
        name = "measurements_with_ext_tau_1"
        tables[name] = _slow_lbr_arrays(files.folder / f"{name}.npz")
    return [
        Log(
            name=name,
            t=LBR_PERIOD * np.arange(len(raw["q"])),
            q=raw["q"],
            tau=-raw["tau"],
            signals={"tau_ext": -raw["tau_ext"]},
        )
        for name, raw in tables.items()
    ]


def lbr_arrays(path: Path) -> dict:
    """Arrays q, tau, tau_ext (n_samples, 7) with the published sign."""
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    return dict(zip(("q", "tau", "tau_ext"), np.hsplit(table, 3), strict=True))


def _slow_lbr_arrays(path: Path) -> dict:
    """Arrays of the slow recording, converted by whoever still has it."""
    if not path.is_file():
        raise FileNotFoundError(
            f"kuka_lbr_med7: the slow recording is not downloaded, as it was taken "
            f"out of the repository; put it at {path}, or use which='fast'."
        )
    with np.load(path) as raw:
        return {key: raw[key] for key in ("q", "tau", "tau_ext")}


# -- PAL Robotics TIAGo ----------------------------------------------------------------

_TIAGO_RATIOS = (1.0, 100.0, 100.0, 100.0, 100.0, 336.0, 336.0, 336.0)
# [N m/A] at the motor; the sign is that of the current against the joint.
_TIAGO_GAINS = (1.0, 0.136, 0.136, -0.087, -0.087, -0.0613, -0.0613, -0.0613)
# The rows that the publishers use: the exciting motion, first and last one.
_TIAGO_ROWS = (921, 6790)


def read_tiago(files: DataFiles, rows: str = "exciting") -> list[Log]:
    """Return the log of torso and arm, its currents brought to joint torques."""
    if rows not in ("exciting", "all"):
        raise ValueError(f"rows must be 'exciting' or 'all', got {rows!r}.")
    raw = tiago_arrays(files.find())
    if rows == "exciting":
        first, last = _TIAGO_ROWS
        raw = {key: x[first : last + 1] for key, x in raw.items()}
    return [
        Log(
            name="trajectory",
            t=raw["t"],
            q=raw["q"],
            v=raw["v"],
            tau=np.multiply(_TIAGO_RATIOS, _TIAGO_GAINS) * raw["effort"],
            signals={"effort": raw["effort"]},
        )
    ]


def tiago_arrays(files: dict[str, Path]) -> dict:
    """Stamps t [s] (n_samples,) and q, v, effort (n_samples, 8)."""
    names = {"position": "q", "velocity": "v", "effort": "effort"}
    raw = {}
    for path, local in files.items():
        table = np.loadtxt(local, delimiter=",", skiprows=1)
        raw[names[Path(path).stem.removeprefix("tiago_")]] = table[:, 1:]
        # The three files have the same stamps.
        raw["t"] = table[:, 0]
    return raw


# -- Unitree Go2 -----------------------------------------------------------------------

GO2_PERIOD = 0.005  # [s]


def read_unitree_go2(files: DataFiles) -> list[Log]:
    """Return the runs of the quadruped, with the torques that its motors were told."""
    logs = []
    for path, local in files.find(lambda path: path.endswith(".npz")).items():
        with np.load(local) as arrays:
            raw = {key: arrays[key].astype(float) for key in arrays}
        towards = raw["q_desired"] - raw["q"], raw["v_desired"] - raw["v"]
        logs.append(
            Log(
                name=Path(path).stem,
                # The stamps are sums in single precision and drift by 0.02 %.
                t=GO2_PERIOD * np.arange(len(raw["t"])),
                q=raw["q"],
                v=raw["v"],
                tau=raw["kp"] * towards[0] + raw["kd"] * towards[1],
                signals={"q_ref": raw["q_desired"], "v_ref": raw["v_desired"]},
            )
        )
    return logs
