"""Loaders of industrial arms whose torque comes from the motor current."""

import io
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from sklearn_vbjfa.datasets._download import (
    dataset_folder,
    fetch_description,
    fetch_files,
    source_address,
)
from sklearn_vbjfa.model._descriptions import find_description, kr300_description
from sklearn_vbjfa.recording._recording import Recording
from sklearn_vbjfa.recording._resample import Log, join

# Ratio 101 times 0.125 (large) or 0.0922 (small drives) N m/A; not verified.
_UR5_GAINS = (12.63, 12.63, 12.63, 9.31, 9.31, 9.31)
_UR5_PERIOD = 0.008  # [s] of the controller
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
_TX40_PERIOD = 0.0002  # [s]
_TX40_RATIOS = (32.0, 32.0, 45.0, -48.0, 45.0, 32.0)
_TX40_COUPLING = 32.0  # motor 6 also turns with joint 5
_TX40_ZEROS = (0.0, -np.pi / 2, np.pi / 2, 0.0, 0.0, 0.0)  # [rad] of the model


def fetch_ur5(
    *,
    data_home: str | PathLike | None = None,
    download_if_missing: bool = True,
    n_retries: int = 3,
    delay: float = 1.0,
    gains: Sequence[float] = _UR5_GAINS,
    resample: bool = True,
) -> Recording:
    """Load movements of a Universal Robots UR5 with its motor currents.

    Eight contact-free movements. Five are uniform at 125 Hz and left as they
    are. In No1 to No3 packets were lost, the steps alternate between 8 and
    24 ms: positions are interpolated by a cubic spline and all else linearly
    every 8 ms, so half of these samples are interpolated.

    Parameters
    ----------
    data_home : path-like or None, default=None
        Folder that holds, or will hold, the folder ``ur5``; by default
        ``sklearn_vbjfa`` in scikit-learn's data folder.
    download_if_missing : bool, default=True
        Whether to download what is absent instead of raising an error.
    n_retries : int, default=3
        Further tries after a failure of the network.
    delay : float, default=1.0
        Time between two tries [s].
    gains : sequence of 6 floats, default=(12.63, 12.63, 12.63, 9.31, 9.31, 9.31)
        Joint torque per motor current [N m/A]. The default values are not
        published with the data nor verified; they only scale each joint.
    resample : bool, default=True
        If False, samples and stamps are as recorded.

    Returns
    -------
    recording : Recording
        About 31000 samples of 6 joints, dt = 0.008 s, recordings "No1", "No2",
        "No3", "No4", "No6", "No7", "No8", "No9". `q` [rad] and `v` [rad/s] as
        the robot reports them, `tau` [N m] is `gains` times the measured
        current. Signals (n_samples, 6): "i_actual", "i_target" [A],
        "m_target" [N m] (rigid model of the controller), "q_target" [rad],
        "qd_target" [rad/s], "qdd_target" [rad/s^2].

    Raises
    ------
    OSError
        If a file is absent and may not or cannot be downloaded, or does not
        hold what was published.
    ValueError
        If `gains` does not hold six finite numbers.

    Notes
    -----
    Licence: Apache-2.0. At standstill the current lies anywhere inside the
    stiction band, which is wide: leave out samples with little speed. The
    model is ur5_robot.urdf of example-robot-data.

    References
    ----------
    .. [1] K. Kufieta, "Force Estimation in Robotic Manipulators: Modeling,
       Simulation and Experiments", MSc thesis, NTNU, 2014.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_ur5
    >>> ur5 = fetch_ur5()  # doctest: +SKIP
    >>> ur5.select("No6").tau.shape  # doctest: +SKIP
    (10264, 6)
    """
    gains = np.asarray(gains, dtype=float)
    if gains.shape != (6,) or not np.isfinite(gains).all():
        raise ValueError(f"gains must hold six finite numbers [N m/A], got {gains}.")
    files = fetch_files(
        "ur5",
        data_home=data_home,
        download_if_missing=download_if_missing,
        n_retries=n_retries,
        delay=delay,
    )
    movements = {}
    for path, local in files.items():
        movement = path.split("/")[-3]
        movements.setdefault(movement, {})[Path(path).stem] = local
    logs = []
    for movement, parts in movements.items():
        raw = read_ur5(parts)
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
    return Recording(
        name="ur5",
        **join(logs, dt=_UR5_PERIOD, resample=resample),
        joint_names=(
            "shoulder_pan_joint",
            "shoulder_lift_joint",
            "elbow_joint",
            "wrist_1_joint",
            "wrist_2_joint",
            "wrist_3_joint",
        ),
        position_units=("rad",) * 6,
        torque_units=("N m",) * 6,
        urdf=find_description("ur5", dataset_folder("ur5", data_home)),
        source=source_address("ur5"),
        licence="Apache-2.0",
        citation=(
            'K. Kufieta, "Force Estimation in Robotic Manipulators: Modeling, '
            'Simulation and Experiments", MSc thesis, NTNU, 2014.'
        ),
        description=(
            "UR5 (CB2) in free motion. Torque is a gain times the motor current; "
            "the gains are not verified. Strong stiction at standstill."
        ),
    )


def read_ur5(parts: dict[str, Path]) -> dict:
    """Stamps t [s] (n_samples,) and the eight logs (n_samples, 6) of a movement.

    The logs end at different rows, some in the middle of a line: that line
    and what the shortest log lacks are left out.
    """
    tables = {}
    for key in _UR5_LOGS:
        whole_lines = parts[f"log_{key}"].read_text("ascii").rpartition("\n")[0]
        tables[key] = np.loadtxt(io.StringIO(whole_lines), delimiter=",")
    n_samples = min(len(table) for table in tables.values())
    arrays = {key: table[:n_samples, 1:] for key, table in tables.items()}
    # Each log has stamps of its own, at most 0.1 ms apart in a row.
    return {"t": tables["q_actual"][:n_samples, 0], **arrays}


def fetch_staubli_tx40(
    *,
    data_home: str | PathLike | None = None,
    download_if_missing: bool = True,
    n_retries: int = 3,
    delay: float = 1.0,
) -> Recording:
    """Load a trajectory of a Staubli TX40 with motor torques from the current.

    Motor angles and torques are brought to the joints with the gear ratios
    and the coupling of the wrist; the zeros of joints 2 and 3 are those of
    the model. Nothing is resampled, the period is 0.2 ms.

    Parameters
    ----------
    data_home : path-like or None, default=None
        Folder that holds, or will hold, the folder ``staubli_tx40``; by default
        ``sklearn_vbjfa`` in scikit-learn's data folder.
    download_if_missing : bool, default=True
        Whether to download what is absent instead of raising an error.
    n_retries : int, default=3
        Further tries after a failure of the network.
    delay : float, default=1.0
        Time between two tries [s].

    Returns
    -------
    recording : Recording
        45000 samples of 6 joints, dt = 0.0002 s, one recording. `q` [rad],
        `tau` [N m]. Signals (n_samples, 6): "q_motor" [rad], "tau_motor"
        [N m] as published. `urdf` is None if the description is absent and
        `download_if_missing` is False.

    Raises
    ------
    OSError
        If a file is absent and may not or cannot be downloaded, or does not
        hold what was published.

    Notes
    -----
    Licence: Apache-2.0. Joint 6 is coupled: motor 6 turns by 32 (q6 + q5), so
    tau5 includes 32 times the torque of motor 6. Motor 6 also adds inertia and
    friction that act on the sum of both speeds.

    References
    ----------
    .. [1] M. Gautier, A. Janot, P.-O. Vandanjon, "A new closed-loop output
       error method for parameter identification of robot dynamics", IEEE
       TCST, 2013 (same robot and laboratory).
    .. [2] D. V. Nguyen, V. Bonnet, S. Maxime, M. Gautier, P. Fernbach, F.
       Lamiraux, "FIGAROH: a Python toolbox for dynamic identification and
       geometric calibration of robots and humans", Humanoids 2023.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_staubli_tx40
    >>> tx40 = fetch_staubli_tx40()  # doctest: +SKIP
    >>> tx40.q.shape  # doctest: +SKIP
    (45000, 6)
    """
    access = {
        "data_home": data_home,
        "download_if_missing": download_if_missing,
        "n_retries": n_retries,
        "delay": delay,
    }
    files = fetch_files(
        "staubli_tx40", **access, wanted=lambda path: path.endswith(".csv")
    )
    raw = read_tx40(files)
    to_motor = np.diag(_TX40_RATIOS)
    to_motor[5, 4] = _TX40_COUPLING
    q_motor, tau_motor = raw["q_motor_rad"], raw["tau_motor_Nm"]
    log = Log(
        name="trajectory",
        t=_TX40_PERIOD * np.arange(len(q_motor)),
        # q_motor = R q and, by virtual work, tau = R' tau_motor.
        q=np.linalg.solve(to_motor, q_motor.T).T + np.array(_TX40_ZEROS),
        tau=tau_motor @ to_motor,
        signals={"q_motor": q_motor, "tau_motor": tau_motor},
    )
    return Recording(
        name="staubli_tx40",
        **join([log], dt=_TX40_PERIOD),
        joint_names=tuple(f"joint_{i}" for i in range(1, 7)),
        position_units=("rad",) * 6,
        torque_units=("N m",) * 6,
        urdf=fetch_description("staubli_tx40", **access),
        source=source_address("staubli_tx40"),
        licence="Apache-2.0",
        citation=(
            "D. V. Nguyen, V. Bonnet, S. Maxime, M. Gautier, P. Fernbach, F. "
            'Lamiraux, "FIGAROH: a Python toolbox for dynamic identification and '
            'geometric calibration of robots and humans", Humanoids 2023.'
        ),
        description=(
            "Staubli TX40, one exciting trajectory. Torque from the motor current, "
            "position from the motor encoders, wrist joints 5 and 6 coupled."
        ),
    )


def read_tx40(files: dict[str, Path]) -> dict:
    """Motor angles [rad] and motor torques [N m], (n_samples, 6) each."""
    local = {Path(path).stem: file for path, file in files.items()}
    return {
        "q_motor_rad": np.loadtxt(local["pos_read_data"], delimiter=",", skiprows=1),
        "tau_motor_Nm": np.loadtxt(local["curr_data"], delimiter=",", skiprows=1),
    }


def fetch_kuka_kr300(
    *,
    data_home: str | PathLike | None = None,
    download_if_missing: bool = True,
    n_retries: int = 3,
    delay: float = 1.0,
) -> Recording:
    """Load two trajectories of a KUKA KR300 R2500 ultra SE.

    Degrees are converted to radians and motor torques to joint torques with
    the gear ratios; nothing is resampled.

    Parameters
    ----------
    data_home : path-like or None, default=None
        Folder that holds, or will hold, the folder ``kuka_kr300``; by default
        ``sklearn_vbjfa`` in scikit-learn's data folder.
    download_if_missing : bool, default=True
        Whether to download what is absent instead of raising an error.
    n_retries : int, default=3
        Further tries after a failure of the network.
    delay : float, default=1.0
        Time between two tries [s].

    Returns
    -------
    recording : Recording
        5002 samples of 6 joints, dt = 0.004 s, recordings "A" and "B". `q`
        [rad] and `v` [rad/s] are those of the motors divided by the gear
        ratio, `tau` [N m] is the gear ratio times the motor torque from the
        current. Signals (n_samples, 6): "torque_motor", "torque_motor_rel"
        [N m] at the motor, the second without an offset; "tau_ff" [N m], the
        feed-forward at the joint; "tau_grav_model" [N m], gravity in the
        authors' model; "q_ref" [rad], "v_ref" [rad/s]. Signals (n_samples, 3):
        "q_link" [rad], "v_link" [rad/s] of the second encoders on axes 1 to 3.

    Raises
    ------
    OSError
        If a file is absent and may not or cannot be downloaded, or does not
        hold what was published.

    Notes
    -----
    Licence: MIT. A hydraulic counterbalance acts on axis 2 and a payload of
    uncertain mass was mounted; neither is in the nominal model, which comes
    with this package. In the first 1.5 s and the last second the robot stands
    still and the torque lies anywhere inside the stiction band: leave these
    samples out.

    References
    ----------
    .. [1] J. Weigand, J. Ulmen, A. Janot, M. Ruskowski, robot identification
       code and measurements, repository Robot_Identification, 2021.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_kuka_kr300
    >>> kr300 = fetch_kuka_kr300()  # doctest: +SKIP
    >>> kr300.group_names  # doctest: +SKIP
    ('A', 'B')
    """
    files = fetch_files(
        "kuka_kr300",
        data_home=data_home,
        download_if_missing=download_if_missing,
        n_retries=n_retries,
        delay=delay,
    )
    logs = []
    for path, local in files.items():
        raw = read_kr300(local)
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
    return Recording(
        name="kuka_kr300",
        **join(logs, dt=0.004),
        joint_names=tuple(f"joint_{i}" for i in range(1, 7)),
        position_units=("rad",) * 6,
        torque_units=("N m",) * 6,
        urdf=kr300_description(),
        source=source_address("kuka_kr300"),
        licence="MIT, (c) 2021 Jonas Weigand",
        citation=(
            "J. Weigand, J. Ulmen, A. Janot, M. Ruskowski, robot identification "
            "code and measurements, repository Robot_Identification, 2021."
        ),
        description=(
            "KUKA KR300 R2500 ultra SE with payload. Torque from the motor current, "
            "position from the motors; counterbalance on axis 2, elastic gears."
        ),
    )


def read_kr300(path: Path) -> dict:
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
