"""The measured sets: what each is, how it is evaluated, and what its files hold.

A set is one function, from its files and the options of its loader to its logs, with
the documentation of that loader, which `_measured` makes of it. Where published arrays
need more than a call to be read, a function beside it returns them as published; the
set then brings them to joints, radians and newton metres.
"""

import functools
import io
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from sklearn_vbjfa.datasets._catalogue import DataSet, Protocol, measured
from sklearn_vbjfa.datasets._download import DataFiles, collected_urdf
from sklearn_vbjfa.datasets._robot_recording import load_demo_recording
from sklearn_vbjfa.datasets._robots import packaged_urdf
from sklearn_vbjfa.recording import Log

CATALOGUE: dict[str, DataSet] = {}  # filled below, set by set
_measured = functools.partial(measured, CATALOGUE)

_FIGAROH = (
    "D. V. Nguyen, V. Bonnet, S. Maxime, M. Gautier, P. Fernbach, F. "
    'Lamiraux, "FIGAROH: a Python toolbox for dynamic identification and '
    'geometric calibration of robots and humans", Humanoids 2023.'
)

# -- EMPS ------------------------------------------------------------------------------


@_measured(
    joint_names=("slide",),
    position_units=("m",),
    torque_units=("N",),
    dt=0.001,
    licence="Apache-2.0 (repository)",
    citation=(
        'A. Janot, M. Gautier, M. Brunot, "Data Set and Reference Models of '
        'EMPS", Workshop on Nonlinear System Identification Benchmarks, 2019.'
    ),
    description=(
        "Horizontal ball-screw slide with a DC motor. Force from the voltage "
        "command of the drive, position from the motor encoder."
    ),
    protocol=Protocol(
        train=("DATA_EMPS",),
        cutoff=60.0,
        friction=("viscous", "coulomb", "offset"),
    ),
)
def fetch_emps(files: DataFiles) -> list[Log]:
    """Load the electro-mechanical positioning system: one horizontal slide.

    A ball screw driven by a direct-current motor, in closed loop at 1 kHz.
    The values are as recorded; the stamps are uniform.

    Parameters
    ----------
    {access}

    Returns
    -------
    recording : Recording
        49682 samples of 1 joint, dt = 0.001 s. Recordings "DATA_EMPS" (two
        repeats of one reference) and "PULSES" (with force pulses). `q` [m] is
        the motor encoder expressed at the load, `tau` [N] the drive gain
        35.15 N/V times the voltage command, which is not a force sensor.
        Signals: "q_ref" (n_samples, 1) [m], "volts" (n_samples,) [V],
        "pulses" (n_samples,) [N] (zero in the first recording). The model is
        a prismatic joint without gravity.

    {raises}

    Notes
    -----
    Licence of the repository: Apache-2.0; the data were first published without
    a licence text. The publishers identified a mass of 95.1 kg, 203.5 N s/m
    viscous and 20.4 N dry friction, and an offset of -3.16 N.

    {references}

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_emps
    >>> emps = fetch_emps()  # doctest: +SKIP
    >>> emps.select("DATA_EMPS").q.shape  # doctest: +SKIP
    (24841, 1)
    """
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


@_measured(
    irregular=True,
    joint_names=(
        "shoulder_pan_joint",
        "shoulder_lift_joint",
        "elbow_joint",
        "wrist_1_joint",
        "wrist_2_joint",
        "wrist_3_joint",
    ),
    dt=UR5_PERIOD,
    urdf=collected_urdf("ur_description/urdf/ur5_robot.urdf"),
    licence="Apache-2.0",
    citation=(
        'K. Kufieta, "Force Estimation in Robotic Manipulators: Modeling, '
        'Simulation and Experiments", MSc thesis, NTNU, 2014.'
    ),
    description=(
        "UR5 (CB2) in free motion. Torque is a gain times the motor current; "
        "the gains are not verified. Strong stiction at standstill."
    ),
    protocol=Protocol(
        train=("No6", "No4"), test=("No9", "No8"), cutoff=8.0, standstill=0.03
    ),
)
def fetch_ur5(files: DataFiles, gains: Sequence[float] = UR5_GAINS) -> list[Log]:
    """Load movements of a Universal Robots UR5 with its motor currents.

    Eight contact-free movements. Five are uniform at 125 Hz and left as they
    are. In No1 to No3 packets were lost, the steps alternate between 8 and
    24 ms: positions are interpolated by a cubic spline and all else linearly
    every 8 ms, so half of these samples are interpolated.

    Parameters
    ----------
    {access}
    gains : sequence of 6 floats, default=(12.63, 12.63, 12.63, 9.31, 9.31, 9.31)
        Joint torque per motor current [N m/A]. The default values are not
        published with the data nor verified; they only scale each joint.
    {resample}

    Returns
    -------
    recording : Recording
        About 31000 samples of 6 joints, dt = 0.008 s, recordings "No1", "No2",
        "No3", "No4", "No6", "No7", "No8", "No9". `q` [rad] and `v` [rad/s] as
        the robot reports them, `tau` [N m] is `gains` times the measured
        current. Signals (n_samples, 6): "i_actual", "i_target" [A],
        "m_target" [N m] (rigid model of the controller), "q_target" [rad],
        "qd_target" [rad/s], "qdd_target" [rad/s^2].

    {raises}
    ValueError
        If `gains` does not hold six finite numbers.

    Notes
    -----
    Licence: Apache-2.0. At standstill the current lies anywhere inside the
    stiction band, which is wide: leave out samples with little speed. The
    model is ur5_robot.urdf of example-robot-data.

    {references}

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_ur5
    >>> ur5 = fetch_ur5()  # doctest: +SKIP
    >>> ur5.select("No6").tau.shape  # doctest: +SKIP
    (10264, 6)
    """
    factors = np.asarray(gains, dtype=float)
    if factors.shape != (6,) or not np.isfinite(factors).all():
        raise ValueError(f"gains must hold six finite numbers [N m/A], got {factors}.")
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
                tau=factors * raw["i_actual"],
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


@_measured(
    joint_names=tuple(f"joint_{i}" for i in range(1, 7)),
    dt=TX40_PERIOD,
    urdf=DataFiles.published_urdf,
    licence="Apache-2.0",
    citation=_FIGAROH,
    description=(
        "Staubli TX40, one exciting trajectory. Torque from the motor current, "
        "position from the motor encoders, wrist joints 5 and 6 coupled."
    ),
    protocol=Protocol(share=0.72, cutoff=25.0),
)
def fetch_staubli_tx40(files: DataFiles) -> list[Log]:
    """Load a trajectory of a Staubli TX40 with motor torques from the current.

    Motor angles and torques are brought to the joints with the gear ratios
    and the coupling of the wrist; the zeros of joints 2 and 3 are those of
    the model. Nothing is resampled, the period is 0.2 ms.

    Parameters
    ----------
    {access}

    Returns
    -------
    recording : Recording
        45000 samples of 6 joints, dt = 0.0002 s, one recording. `q` [rad],
        `tau` [N m]. Signals (n_samples, 6): "q_motor" [rad], "tau_motor"
        [N m] as published. `urdf` is None if the description is absent and
        `download_if_missing` is False.

    {raises}

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


@_measured(
    joint_names=tuple(f"joint_{i}" for i in range(1, 7)),
    dt=0.004,
    urdf=lambda files: packaged_urdf("kr300_nominal"),
    licence="MIT, (c) 2021 Jonas Weigand",
    citation=(
        "J. Weigand, J. Ulmen, A. Janot, M. Ruskowski, robot identification "
        "code and measurements, repository Robot_Identification, 2021."
    ),
    description=(
        "KUKA KR300 R2500 ultra SE with payload. Torque from the motor current, "
        "position from the motors; counterbalance on axis 2, elastic gears."
    ),
    protocol=Protocol(train=("A",), test=("B",), cutoff=12.0, standstill=0.02),
)
def fetch_kuka_kr300(files: DataFiles) -> list[Log]:
    """Load two trajectories of a KUKA KR300 R2500 ultra SE.

    Degrees are converted to radians and motor torques to joint torques with
    the gear ratios; nothing is resampled.

    Parameters
    ----------
    {access}

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

    {raises}

    Notes
    -----
    Licence: MIT. A hydraulic counterbalance acts on axis 2 and a payload of
    uncertain mass was mounted; neither is in the nominal model, which comes
    with this package. In the first 1.5 s and the last second the robot stands
    still and the torque lies anywhere inside the stiction band: leave these
    samples out.

    {references}

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_kuka_kr300
    >>> kr300 = fetch_kuka_kr300()  # doctest: +SKIP
    >>> kr300.group_names  # doctest: +SKIP
    ('A', 'B')
    """
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


@_measured(
    irregular=True,
    joint_names=tuple(f"panda_joint{i}" for i in range(1, 8)),
    drop_repeated=True,
    urdf=collected_urdf("panda_description/urdf/panda.urdf"),
    licence="GPL-3.0",
    citation=(
        "C. Gaz, M. Cognetti, A. Oliva, P. Robuffo Giordano, A. De Luca, "
        '"Dynamic Identification of the Franka Emika Panda Robot With Retrieval '
        'of Feasible Parameters Using Penalty-Based Optimization", IEEE RA-L, '
        "2019."
    ),
    description=(
        "Franka Emika Panda, exciting trajectory of 21 s. Torque of the "
        "link-side sensors, gravity included."
    ),
    protocol=Protocol(cutoff=10.0),
)
def fetch_franka_panda(files: DataFiles) -> list[Log]:
    """Load an exciting trajectory of a Franka Emika Panda.

    The stamps are irregular (0.7 to 8.8 ms) and 6 % of the rows repeat the
    one before. Repeated rows are dropped, then positions are interpolated by
    a cubic spline and all else linearly every 1 ms.

    Parameters
    ----------
    {access}
    {resample}

    Returns
    -------
    recording : Recording
        About 21000 samples of 7 joints, dt = 0.001 s, one recording. `q` [rad]
        and `v` [rad/s] (the robot's own estimate), `tau` [N m] of the joint
        torque sensors, gravity included. The model has its fingers fixed.

    {raises}

    Notes
    -----
    Licence: GPL-3.0 (the data files only are used). The sensors sit behind the
    gears, so most of the motor friction and the rotor inertia do not show. The
    model is panda.urdf of example-robot-data.

    {references}

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_franka_panda
    >>> panda = fetch_franka_panda()  # doctest: +SKIP
    >>> panda.nv  # doctest: +SKIP
    7
    """
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


# -- T-Flex ----------------------------------------------------------------------------

TFLEX_PERIOD = 0.001  # [s]


@_measured(
    joint_names=("hinge",),
    torque_units=("count",),
    dt=TFLEX_PERIOD,
    licence="MIT, (c) 2019 Wouter van Dijk",
    citation="W. van Dijk, repository Inverse_dynamics_learning, 2019.",
    description=(
        "Flexure hinge with a direct-drive motor under random motion. Current "
        "in driver counts, spring and cogging instead of dry friction."
    ),
    # A flexure hinge: practically no dry friction.
    protocol=Protocol(cutoff=40.0, friction=("viscous", "offset")),
)
def fetch_tflex_1dof(files: DataFiles) -> list[Log]:
    """Load the T-Flex axis: a flexure hinge with a direct-drive motor.

    Random motion at 1 kHz. Angle and speed are converted from degrees;
    otherwise the values are as recorded, the stamps are uniform.

    Parameters
    ----------
    {access}

    Returns
    -------
    recording : Recording
        130716 samples of 1 joint, dt = 0.001 s, one recording. `q` [rad],
        `v` [rad/s] of the controller, `tau` [count] the motor current in
        counts of the driver, whose scale is unknown. Signals: "a"
        (n_samples, 1) [rad/s^2], a numerical derivative and very noisy. The
        model is a hinge about the vertical, so without gravity; its inertia
        of 1 is a placeholder.

    {raises}

    Notes
    -----
    Licence: MIT. There is practically no dry friction; a spring (the flexure)
    and a ripple of the motor with a period of about 19 degrees remain.

    {references}

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_tflex_1dof
    >>> tflex = fetch_tflex_1dof()  # doctest: +SKIP
    >>> tflex.torque_units  # doctest: +SKIP
    ('count',)
    """
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


@_measured(
    irregular=True,
    joint_names=("servo",),
    torque_units=("V",),
    licence="Apache-2.0",
    citation=(
        'M. Duclusaud, G. Passault, V. Padois, O. Ly, "Extended Friction Models '
        'for the Physics Simulation of Servo Actuators", ICRA 2025.'
    ),
    description=(
        "Servo with a pendulum. The torque stands for the motor voltage; motor "
        "constant and resistance are unknown, back-EMF counts as friction."
    ),
    protocol=Protocol(cutoff=12.0, standstill=0.05),
)
def fetch_bam_xl330(files: DataFiles, include_free_swing: bool = False) -> list[Log]:
    """Load logs of a Dynamixel XL330 servo that swings a pendulum.

    Four trajectories at three position gains, 6 s each, with a load of
    0.49 kg at 0.10 m. Stamps vary by about 1 ms: positions are interpolated
    by a cubic spline and all else linearly on the median period.

    Parameters
    ----------
    {access}
    include_free_swing : bool, default=False
        Whether to keep the last 4 s of the "lift_and_drop" runs, in which
        the motor is switched off. Only friction and gravity act then, without
        the braking by the motor's own current, so that the parameters of the
        powered motor do not hold. If kept, they are recordings of their own,
        "kp..._lift_and_drop_free".
    {resample}

    Returns
    -------
    recording : Recording
        About 12000 samples of 1 joint, dt = 0.0053 s, recordings "kp100_sin_sin",
        "kp100_lift_and_drop", "kp100_up_and_down", "kp100_sin_time_square" and
        likewise for kp400 and kp800; three more with the free swings. `q` [rad]
        (0 hanging down, steps of 1.5 mrad), `v` [rad/s] of the servo (steps of
        0.024 rad/s, of which one may show at standstill), `tau` [V]
        the motor voltage, duty cycle times supply. Signals (n_samples,):
        "duty" [1], "supply_volts" [V], "temperature" [deg C], "torque_enable"
        [0 or 1], "kp" (firmware gain); (n_samples, 1): "q_ref" [rad]. The model
        is the load on a horizontal axis; the arm is not in it.

    {raises}

    Notes
    -----
    Licence: Apache-2.0. The motor obeys torque = kt / R (V - kt v) with kt and
    R unknown. In volts, every parameter is therefore scaled by R / kt, and the
    back electromotive force adds kt to the viscous coefficient [V s/rad].

    {references}

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_bam_xl330
    >>> servo = fetch_bam_xl330()  # doctest: +SKIP
    >>> len(servo.group_names), servo.torque_units  # doctest: +SKIP
    (12, ('V',))
    """
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


# -- KUKA LBR Med 7 --------------------------------------------------------------------

LBR_PERIOD = 0.01  # [s]


@_measured(
    joint_names=tuple(f"A{i}" for i in range(1, 8)),
    dt=LBR_PERIOD,
    urdf=DataFiles.published_urdf,
    licence="MIT",
    citation="lbr-stack, repository dynamic_parameter_identification.",
    description=(
        "KUKA LBR Med 7 with an unmodelled tool. Torque of the joint sensors, "
        "sign changed to that of the usual joint torque."
    ),
    protocol=Protocol(cutoff=4.0),
)
def fetch_kuka_lbr_med7(files: DataFiles, which: str = "fast") -> list[Log]:
    """Load recordings of a KUKA LBR Med 7 with joint torque sensors.

    The published torque is the opposite of the usual joint torque; its sign is
    changed here. There are no stamps: the period is that of the publishers'
    code, and nothing is resampled.

    Parameters
    ----------
    {access}
    which : {"fast", "slow", "all"}, default="fast"
        "fast": measurements.csv, up to 1.1 rad/s. "slow": up to 0.3 rad/s,
        so nearly gravity alone, a case of weak excitation. The slow one was
        taken out of the repository; it is not downloaded but read from
        ``kuka_lbr_med7/measurements_with_ext_tau_1.npz`` in `data_home`
        (arrays q, tau, tau_ext with the published sign), whose content is
        not checked.

    Returns
    -------
    recording : Recording
        7 joints, dt = 0.01 s, recordings "measurements" (1647 samples) and
        "measurements_with_ext_tau_1" (10007 samples). `q` [rad], `tau` [N m]
        with gravity. Signals (n_samples, 7): "tau_ext" [N m], the robot's
        estimate of external torques, same sign as `tau`; it is not zero, a
        tool was mounted. `urdf` is None if the description is absent and
        `download_if_missing` is False.

    {raises}
    ValueError
        If `which` is unknown.

    Notes
    -----
    Licence: MIT. From row 285 to 645 of "measurements" the robot holds still:
    the positions are exactly constant while the torques show sensor noise.

    {references}

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_kuka_lbr_med7
    >>> lbr = fetch_kuka_lbr_med7()  # doctest: +SKIP
    >>> lbr.q.shape  # doctest: +SKIP
    (1647, 7)
    """
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


# -- DFKI double pendulum --------------------------------------------------------------


_PENDULUM = "Double pendulum with two AK80-6 drives (ratio 6), design A.0."


@_measured(
    irregular=True,
    joint_names=("shoulder", "elbow"),
    licence="BSD-3-Clause",
    citation=(
        "F. Wiebe, S. Kumar, L. Shala, S. Vyas, M. Javadi, F. Kirchner, "
        '"Open Source Dual-Purpose Acrobot and Pendubot Platform", IEEE '
        "Robotics & Automation Magazine 31(2), 2024."
    ),
    description={
        "short": f"{_PENDULUM} Torque measured by the drives.",
        "long": f"{_PENDULUM} Torque as commanded.",
    },
    protocol=Protocol(cutoff=12.0),
)
def fetch_dfki_double_pendulum(files: DataFiles, which: str = "short") -> list[Log]:
    """Load runs of a double pendulum with two quasi-direct drives.

    Stamps vary: positions are interpolated by a cubic spline and all else
    linearly on the median period.

    Parameters
    ----------
    {access}
    which : {"short", "long"}, default="short"
        "short": nine runs of 10 s (one of 6 s) whose torque the drives
        measured from their current. "long": one run of 75 s whose torque is
        noise-free, so rather the command than a measurement. They are not
        mixed, as `tau` would change its meaning.
    {resample}

    Returns
    -------
    recording : Recording
        2 joints. "short": about 43000 samples, dt = 0.002 s, recordings
        "trajectory_00" to "trajectory_05", "trajectory_11" to
        "trajectory_13". "long": about 22500 samples, dt = 0.00333 s,
        recording "20220812-061157". `q` [rad] is 0 hanging down, the second
        angle relative to the first; `v` [rad/s] of the drives; `tau` [N m].
        Signals of "short" (n_samples, 2): "tau_command" [N m]. The model is
        a chain of two links on parallel horizontal axes.

    {raises}
    ValueError
        If `which` is unknown.

    Notes
    -----
    Licence: BSD-3-Clause. In the short runs the torque stays within 0.6 N m,
    with 0.1 to 0.2 N m of friction and cogging: the first joint in particular
    has a poor signal-to-noise ratio. The published URDF counts the second
    angle from the folded position (add pi); the model here does not.

    {references}

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_dfki_double_pendulum
    >>> pendulum = fetch_dfki_double_pendulum(which="long")  # doctest: +SKIP
    >>> pendulum.joint_names  # doctest: +SKIP
    ('shoulder', 'elbow')
    """
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


# -- PAL Robotics TIAGo ----------------------------------------------------------------

_TIAGO_RATIOS = (1.0, 100.0, 100.0, 100.0, 100.0, 336.0, 336.0, 336.0)
# [N m/A] at the motor; the sign is that of the current against the joint.
_TIAGO_GAINS = (1.0, 0.136, 0.136, -0.087, -0.087, -0.0613, -0.0613, -0.0613)
# The rows that the publishers use: the exciting motion, first and last one.
_TIAGO_ROWS = (921, 6790)


@_measured(
    irregular=True,
    joint_names=("torso_lift_joint", *(f"arm_{i}_joint" for i in range(1, 8))),
    position_units=("m", *("rad",) * 7),
    torque_units=("N", *("N m",) * 7),
    urdf=collected_urdf("tiago_description/robots/tiago.urdf"),
    licence="Apache-2.0",
    citation=_FIGAROH,
    description=(
        "TIAGo, torso lift and seven arm joints. Torque from motor currents, "
        "useful for arm_1 to arm_4 only."
    ),
    protocol=Protocol(cutoff=5.0),
)
def fetch_tiago(files: DataFiles, rows: str = "exciting") -> list[Log]:
    """Load a recording of the torso and arm of a PAL Robotics TIAGo.

    Currents are brought to joint torques with the publishers' gear ratios and
    motor constants. The stamps vary from 7.7 to 12.3 ms: positions are
    interpolated by a cubic spline and all else linearly on the median period.

    Parameters
    ----------
    {access}
    rows : {"exciting", "all"}, default="exciting"
        "exciting": rows 921 to 6790 (counted from 0), which the publishers
        use. "all": also what comes before and after.
    {resample}

    Returns
    -------
    recording : Recording
        About 5900 samples (8000 with all rows) of 8 joints, dt = 0.01 s, one
        recording. `q` [m for the torso, else rad] and `v` [m/s, rad/s], `tau`
        [N for the torso, else N m]. Signals (n_samples, 8): "effort", as
        published [A for the arm]. The model has all other joints fixed.

    {raises}
    ValueError
        If `rows` is unknown.

    Notes
    -----
    Licence: Apache-2.0. The efforts of arm_5 to arm_7 have about 40 distinct
    values: they say next to nothing, and that of the torso little, on a scale
    of its own from which the weight of the robot is missing (the publishers
    add 9.81 m/s^2 times the mass carried). The model is tiago.urdf of
    example-robot-data.

    {references}

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_tiago
    >>> tiago = fetch_tiago()  # doctest: +SKIP
    >>> tiago.position_units[:2]  # doctest: +SKIP
    ('m', 'rad')
    """
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


@_measured(
    joint_names=tuple(
        f"{leg}_{joint}_joint"
        for leg in ("FL", "FR", "RL", "RR")
        for joint in ("hip", "thigh", "calf")
    ),
    dt=GO2_PERIOD,
    urdf=DataFiles.published_urdf,
    source=(
        "https://github.com/RX-00/sim2real-robot-identification/tree/1a22bd0 "
        "(robot_model/go2/go2.xml; datasets/go2/traj_*.pt, which fetch_unitree_go2 "
        "reads as run_*.npz, see there)"
    ),
    licence="BSD-3-Clause, (c) DLS Lab, Istituto Italiano di Tecnologia",
    citation=(
        "DLS Lab, Istituto Italiano di Tecnologia, repository "
        "sim2real-robot-identification."
    ),
    description=(
        "Unitree Go2 held in the air, all legs moving. The torque is the command "
        "of a PD law, made of the measured positions and speeds themselves."
    ),
    # The automatic low-pass takes noise of the command, which is that of the
    # encoders and so in both channels, for motion.
    protocol=Protocol(train=("run_0", "run_1"), test=("run_2", "run_3"), cutoff=10.0),
)
def fetch_unitree_go2(files: DataFiles) -> list[Log]:
    """Load motor tests of a quadruped, Unitree Go2, that was held in the air.

    Ten runs of 23.5 to 23.9 s at 200 Hz, in which all twelve joints follow a
    chirp at once. The values are as recorded, the stamps uniform.

    Parameters
    ----------
    {access}

    Returns
    -------
    recording : Recording
        47065 samples of 12 joints, dt = 0.005 s, recordings "run_0" to
        "run_9". `q` [rad] and `v` [rad/s] of the motors, `tau` [N m] what
        the motors were told. Signals (n_samples, 12): "q_desired" [rad] and
        "v_desired" [rad/s] (zero throughout), the motion that was asked for, and
        the gains "kp" [N m/rad] and "kd" [N m s/rad]: what a `PDDrive` takes. The
        model is that of ``go2.xml``, whose base is free and is held level.

    {raises}

    Notes
    -----
    `tau` is a command and no measurement: kp (q_desired - q) + kd (v_desired - v) with
    kp = 20, 20, 40 N m/rad and kd = 1, 1, 2 N m s/rad of hip, thigh and calf.
    It shares its noise with the positions and speeds, with these known gains: an
    error e of an encoder is -kp e of the torque, where regressions take the noise
    of inputs and of outputs for independent. What the motor makes of the command
    may come later, by an unknown delay, and may be less. ``PDDrive()`` makes the
    same torque and finds the delay.

    The legs are the same four times, mirrored left and right. Armature, damping
    and friction in ``go2.xml`` were identified from such runs by somebody else and
    are not the truth. Whether the base was level is not known (`BaseTilt`).

    Files: ``go2.xml`` is robot_model/go2/go2.xml of the repository; its meshes are
    not needed. ``run_0.npz`` to ``run_9.npz`` have the columns of
    datasets/go2/traj_0.pt to traj_9.pt as arrays t, q, v, q_desired, v_desired, and kp
    and kd of each joint. Joints are in the order
    FL, FR, RL, RR, each hip, thigh, calf. Licence: BSD-3-Clause.

    {references}

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_unitree_go2
    >>> go2 = fetch_unitree_go2()  # doctest: +SKIP
    >>> go2.joint_names[:3]  # doctest: +SKIP
    ('FL_hip_joint', 'FL_thigh_joint', 'FL_calf_joint')
    """
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
                signals={
                    name: np.broadcast_to(raw[name], raw["q"].shape).copy()
                    for name in ("q_desired", "v_desired", "kp", "kd")
                },
            )
        )
    return logs


def protocols():
    """Return name -> `Protocol`, with its loader, of the demo and every set."""
    demo = Protocol(load=load_demo_recording)
    return {"demo": demo, **{name: one.protocol for name, one in CATALOGUE.items()}}
