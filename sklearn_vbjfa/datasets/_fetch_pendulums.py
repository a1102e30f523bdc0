"""Loaders of pendulums on one or two joints."""

import json
from os import PathLike
from pathlib import Path

import numpy as np

from sklearn_vbjfa.datasets._download import fetch_files, source_address
from sklearn_vbjfa.recording._recording import Recording
from sklearn_vbjfa.recording._resample import Log, join, median_period

# Full scale of the duty cycle in the register "present load".
_XL330_FULL_SCALE = 885


def fetch_bam_xl330(
    *,
    data_home: str | PathLike | None = None,
    download_if_missing: bool = True,
    n_retries: int = 3,
    delay: float = 1.0,
    include_free_swing: bool = False,
    resample: bool = True,
) -> Recording:
    """Load logs of a Dynamixel XL330 servo that swings a pendulum.

    Four trajectories at three position gains, 6 s each, with a load of
    0.49 kg at 0.10 m. Stamps vary by about 1 ms: positions are interpolated
    by a cubic spline and all else linearly on the median period.

    Parameters
    ----------
    data_home : path-like or None, default=None
        Folder that holds, or will hold, the folder ``bam_xl330``; by default
        ``sklearn_vbjfa`` in scikit-learn's data folder.
    download_if_missing : bool, default=True
        Whether to download what is absent instead of raising an error.
    n_retries : int, default=3
        Further tries after a failure of the network.
    delay : float, default=1.0
        Time between two tries [s].
    include_free_swing : bool, default=False
        Whether to keep the last 4 s of the "lift_and_drop" runs, in which
        the motor is switched off. Only friction and gravity act then, without
        the braking by the motor's own current, so that the parameters of the
        powered motor do not hold. If kept, they are recordings of their own,
        "kp..._lift_and_drop_free".
    resample : bool, default=True
        If False, samples and stamps are as recorded.

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

    Raises
    ------
    OSError
        If a file is absent and may not or cannot be downloaded, or does not
        hold what was published.

    Notes
    -----
    Licence: Apache-2.0. The motor obeys torque = kt / R (V - kt v) with kt and
    R unknown. In volts, every parameter is therefore scaled by R / kt, and the
    back electromotive force adds kt to the viscous coefficient [V s/rad].

    References
    ----------
    .. [1] M. Duclusaud, G. Passault, V. Padois, O. Ly, "Extended Friction
       Models for the Physics Simulation of Servo Actuators", ICRA 2025.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_bam_xl330
    >>> servo = fetch_bam_xl330()  # doctest: +SKIP
    >>> len(servo.group_names), servo.torque_units  # doctest: +SKIP
    (12, ('V',))
    """
    files = fetch_files(
        "bam_xl330",
        data_home=data_home,
        download_if_missing=download_if_missing,
        n_retries=n_retries,
        delay=delay,
    )
    logs = []
    for local in files.values():
        raw = read_xl330(local)
        name = f"kp{raw['kp']}_{raw['trajectory']}"
        powered = raw["torque_enable"] == 1
        logs.append(_xl330_log(name, raw, powered))
        if include_free_swing and not powered.all():
            logs.append(_xl330_log(f"{name}_free", raw, ~powered))
    return Recording(
        name="bam_xl330",
        **join(logs, dt=median_period(logs), resample=resample),
        joint_names=("servo",),
        position_units=("rad",),
        torque_units=("V",),
        source=source_address("bam_xl330"),
        licence="Apache-2.0",
        citation=(
            'M. Duclusaud, G. Passault, V. Padois, O. Ly, "Extended Friction Models '
            'for the Physics Simulation of Servo Actuators", ICRA 2025.'
        ),
        description=(
            "Servo with a pendulum. The torque stands for the motor voltage; motor "
            "constant and resistance are unknown, back-EMF counts as friction."
        ),
    )


def _xl330_log(name: str, raw: dict, rows: np.ndarray) -> Log:
    """Select the rows (n_samples,) of a servo log."""
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


def read_xl330(path: Path) -> dict:
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


def fetch_dfki_double_pendulum(
    *,
    data_home: str | PathLike | None = None,
    download_if_missing: bool = True,
    n_retries: int = 3,
    delay: float = 1.0,
    which: str = "short",
    resample: bool = True,
) -> Recording:
    """Load runs of a double pendulum with two quasi-direct drives.

    Stamps vary: positions are interpolated by a cubic spline and all else
    linearly on the median period.

    Parameters
    ----------
    data_home : path-like or None, default=None
        Folder that holds, or will hold, the folder ``dfki_double_pendulum``; by default
        ``sklearn_vbjfa`` in scikit-learn's data folder.
    download_if_missing : bool, default=True
        Whether to download what is absent instead of raising an error.
    n_retries : int, default=3
        Further tries after a failure of the network.
    delay : float, default=1.0
        Time between two tries [s].
    which : {"short", "long"}, default="short"
        "short": nine runs of 10 s (one of 6 s) whose torque the drives
        measured from their current. "long": one run of 75 s whose torque is
        noise-free, so rather the command than a measurement. They are not
        mixed, as `tau` would change its meaning.
    resample : bool, default=True
        If False, samples and stamps are as recorded.

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

    Raises
    ------
    OSError
        If a file is absent and may not or cannot be downloaded, or does not
        hold what was published.
    ValueError
        If `which` is unknown.

    Notes
    -----
    Licence: BSD-3-Clause. In the short runs the torque stays within 0.6 N m,
    with 0.1 to 0.2 N m of friction and cogging: the first joint in particular
    has a poor signal-to-noise ratio. The published URDF counts the second
    angle from the folded position (add pi); the model here does not.

    References
    ----------
    .. [1] F. Wiebe, S. Kumar, L. Shala, S. Vyas, M. Javadi, F. Kirchner, "Open
       Source Dual-Purpose Acrobot and Pendubot Platform", IEEE Robotics &
       Automation Magazine 31(2), 2024.

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
    files = fetch_files(
        "dfki_double_pendulum",
        data_home=data_home,
        download_if_missing=download_if_missing,
        n_retries=n_retries,
        delay=delay,
        wanted=lambda path: ("trajectory_" in path) == (which == "short"),
    )
    logs = []
    for local in files.values():
        raw = read_dfki(local)
        measured = which == "short"
        suffix = "_meas" if measured else ""
        signals = {"tau_command": _pair(raw, "tau_con")} if measured else {}
        logs.append(
            Log(
                name=local.stem.removesuffix("-PM_measured"),
                t=raw["time"],
                q=_pair(raw, f"pos{suffix}"),
                v=_pair(raw, f"vel{suffix}"),
                tau=_pair(raw, f"tau{suffix}"),
                signals=signals,
            )
        )
    return Recording(
        name="dfki_double_pendulum",
        **join(logs, dt=median_period(logs), resample=resample),
        joint_names=("shoulder", "elbow"),
        position_units=("rad", "rad"),
        torque_units=("N m", "N m"),
        source=source_address("dfki_double_pendulum"),
        licence="BSD-3-Clause",
        citation=(
            "F. Wiebe, S. Kumar, L. Shala, S. Vyas, M. Javadi, F. Kirchner, "
            '"Open Source Dual-Purpose Acrobot and Pendubot Platform", IEEE '
            "Robotics & Automation Magazine 31(2), 2024."
        ),
        description=(
            "Double pendulum with two AK80-6 drives (ratio 6), design A.0. Torque "
            + ("measured by the drives." if which == "short" else "as commanded.")
        ),
    )


def _pair(raw: dict, key: str) -> np.ndarray:
    """Columns key1, key2 as (n_samples, 2)."""
    return np.column_stack([raw[f"{key}1"], raw[f"{key}2"]])


def read_dfki(path: Path) -> dict:
    """Columns (n_samples,) of a file, names and values unchanged."""
    with path.open(encoding="utf-8") as stream:
        names = stream.readline().strip().split(",")
        table = np.loadtxt(stream, delimiter=",")
    return dict(zip(names, table.T, strict=True))
