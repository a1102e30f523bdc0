"""Loaders of research arms: joint torque sensors, and a mobile manipulator."""

from os import PathLike
from pathlib import Path

import numpy as np

from sklearn_vbjfa.datasets._download import (
    dataset_folder,
    fetch_description,
    fetch_files,
    source_address,
)
from sklearn_vbjfa.model._descriptions import find_description
from sklearn_vbjfa.recording._recording import Recording
from sklearn_vbjfa.recording._resample import Log, join, median_period

_LBR_PERIOD = 0.01  # [s]
_TIAGO_JOINTS = ("torso_lift_joint", *(f"arm_{i}_joint" for i in range(1, 8)))
_TIAGO_RATIOS = (1.0, 100.0, 100.0, 100.0, 100.0, 336.0, 336.0, 336.0)
# [N m/A] at the motor; the sign is that of the current against the joint.
_TIAGO_GAINS = (1.0, 0.136, 0.136, -0.087, -0.087, -0.0613, -0.0613, -0.0613)
# The rows that the publishers use: the exciting motion, first and last one.
_TIAGO_ROWS = (921, 6790)


def fetch_franka_panda(
    *,
    data_home: str | PathLike | None = None,
    download_if_missing: bool = True,
    n_retries: int = 3,
    delay: float = 1.0,
    resample: bool = True,
) -> Recording:
    """Load an exciting trajectory of a Franka Emika Panda.

    The stamps are irregular (0.7 to 8.8 ms) and 6 % of the rows repeat the
    one before. Repeated rows are dropped, then positions are interpolated by
    a cubic spline and all else linearly every 1 ms.

    Parameters
    ----------
    data_home : path-like or None, default=None
        Folder that holds, or will hold, the folder ``franka_panda``; by default
        ``sklearn_vbjfa`` in scikit-learn's data folder.
    download_if_missing : bool, default=True
        Whether to download what is absent instead of raising an error.
    n_retries : int, default=3
        Further tries after a failure of the network.
    delay : float, default=1.0
        Time between two tries [s].
    resample : bool, default=True
        If False, samples and stamps are as recorded.

    Returns
    -------
    recording : Recording
        About 21000 samples of 7 joints, dt = 0.001 s, one recording. `q` [rad]
        and `v` [rad/s] (the robot's own estimate), `tau` [N m] of the joint
        torque sensors, gravity included. The model has its fingers fixed.

    Raises
    ------
    OSError
        If a file is absent and may not or cannot be downloaded, or does not
        hold what was published.

    Notes
    -----
    Licence: GPL-3.0 (the data files only are used). The sensors sit behind the
    gears, so most of the motor friction and the rotor inertia do not show. The
    model is panda.urdf of example-robot-data.

    References
    ----------
    .. [1] C. Gaz, M. Cognetti, A. Oliva, P. Robuffo Giordano, A. De Luca,
       "Dynamic Identification of the Franka Emika Panda Robot With Retrieval
       of Feasible Parameters Using Penalty-Based Optimization", IEEE RA-L,
       2019.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_franka_panda
    >>> panda = fetch_franka_panda()  # doctest: +SKIP
    >>> panda.nv  # doctest: +SKIP
    7
    """
    files = fetch_files(
        "franka_panda",
        data_home=data_home,
        download_if_missing=download_if_missing,
        n_retries=n_retries,
        delay=delay,
    )
    log = Log(name="exciting_traj_1", **read_franka(files))
    dt = median_period([log])
    return Recording(
        name="franka_panda",
        **join([log], dt=dt, resample=resample, drop_repeated=True),
        joint_names=tuple(f"panda_joint{i}" for i in range(1, 8)),
        position_units=("rad",) * 7,
        torque_units=("N m",) * 7,
        urdf=find_description(
            "franka_panda", dataset_folder("franka_panda", data_home)
        ),
        source=source_address("franka_panda"),
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
    )


def read_franka(files: dict[str, Path]) -> dict:
    """Stamps t [s] (n_samples,) and q, v, tau (n_samples, 7)."""
    names = {"time": "t", "positions": "q", "velocity": "v", "torques": "tau"}
    raw = {}
    for path, local in files.items():
        values = np.loadtxt(local)
        key = names[Path(path).stem.removeprefix("exciting_traj_")]
        raw[key] = values if key == "t" else values.reshape(-1, 7)
    return raw


def fetch_kuka_lbr_med7(
    *,
    data_home: str | PathLike | None = None,
    download_if_missing: bool = True,
    n_retries: int = 3,
    delay: float = 1.0,
    which: str = "fast",
) -> Recording:
    """Load recordings of a KUKA LBR Med 7 with joint torque sensors.

    The published torque is the opposite of the usual joint torque; its sign is
    changed here. There are no stamps: the period is that of the publishers'
    code, and nothing is resampled.

    Parameters
    ----------
    data_home : path-like or None, default=None
        Folder that holds, or will hold, the folder ``kuka_lbr_med7``; by default
        ``sklearn_vbjfa`` in scikit-learn's data folder.
    download_if_missing : bool, default=True
        Whether to download what is absent instead of raising an error.
    n_retries : int, default=3
        Further tries after a failure of the network.
    delay : float, default=1.0
        Time between two tries [s].
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

    Raises
    ------
    OSError
        If a file is absent and may not or cannot be downloaded, or does not
        hold what was published.
    ValueError
        If `which` is unknown.

    Notes
    -----
    Licence: MIT. From row 285 to 645 of "measurements" the robot holds still:
    the positions are exactly constant while the torques show sensor noise.

    References
    ----------
    .. [1] lbr-stack, repository dynamic_parameter_identification.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_kuka_lbr_med7
    >>> lbr = fetch_kuka_lbr_med7()  # doctest: +SKIP
    >>> lbr.q.shape  # doctest: +SKIP
    (1647, 7)
    """
    if which not in ("fast", "slow", "all"):
        raise ValueError(f"which must be 'fast', 'slow' or 'all', got {which!r}.")
    access = {
        "data_home": data_home,
        "download_if_missing": download_if_missing,
        "n_retries": n_retries,
        "delay": delay,
    }
    tables = {}
    if which != "slow":
        files = fetch_files(
            "kuka_lbr_med7", **access, wanted=lambda path: path.endswith(".csv")
        )
        (local,) = files.values()
        tables["measurements"] = read_lbr(local)
    if which != "fast":
        name = "measurements_with_ext_tau_1"
        tables[name] = _read_lbr_slow(
            dataset_folder("kuka_lbr_med7", data_home) / f"{name}.npz"
        )
    logs = [
        Log(
            name=name,
            t=_LBR_PERIOD * np.arange(len(raw["q"])),
            q=raw["q"],
            tau=-raw["tau"],
            signals={"tau_ext": -raw["tau_ext"]},
        )
        for name, raw in tables.items()
    ]
    return Recording(
        name="kuka_lbr_med7",
        **join(logs, dt=_LBR_PERIOD),
        joint_names=tuple(f"A{i}" for i in range(1, 8)),
        position_units=("rad",) * 7,
        torque_units=("N m",) * 7,
        urdf=fetch_description("kuka_lbr_med7", **access),
        source=source_address("kuka_lbr_med7"),
        licence="MIT",
        citation="lbr-stack, repository dynamic_parameter_identification.",
        description=(
            "KUKA LBR Med 7 with an unmodelled tool. Torque of the joint sensors, "
            "sign changed to that of the usual joint torque."
        ),
    )


def read_lbr(path: Path) -> dict:
    """Arrays q, tau, tau_ext (n_samples, 7) with the published sign."""
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    return dict(zip(("q", "tau", "tau_ext"), np.hsplit(table, 3), strict=True))


def _read_lbr_slow(path: Path) -> dict:
    """Read the converted slow recording, which has no public address."""
    if not path.is_file():
        raise FileNotFoundError(
            f"kuka_lbr_med7: the slow recording is not downloaded, as it was taken "
            f"out of the repository; put it at {path}, or use which='fast'."
        )
    with np.load(path) as raw:
        return {key: raw[key] for key in ("q", "tau", "tau_ext")}


def fetch_tiago(
    *,
    data_home: str | PathLike | None = None,
    download_if_missing: bool = True,
    n_retries: int = 3,
    delay: float = 1.0,
    rows: str = "exciting",
    resample: bool = True,
) -> Recording:
    """Load a recording of the torso and arm of a PAL Robotics TIAGo.

    Currents are brought to joint torques with the publishers' gear ratios and
    motor constants. The stamps vary from 7.7 to 12.3 ms: positions are
    interpolated by a cubic spline and all else linearly on the median period.

    Parameters
    ----------
    data_home : path-like or None, default=None
        Folder that holds, or will hold, the folder ``tiago``; by default
        ``sklearn_vbjfa`` in scikit-learn's data folder.
    download_if_missing : bool, default=True
        Whether to download what is absent instead of raising an error.
    n_retries : int, default=3
        Further tries after a failure of the network.
    delay : float, default=1.0
        Time between two tries [s].
    rows : {"exciting", "all"}, default="exciting"
        "exciting": rows 921 to 6790 (counted from 0), which the publishers
        use. "all": also what comes before and after.
    resample : bool, default=True
        If False, samples and stamps are as recorded.

    Returns
    -------
    recording : Recording
        About 5900 samples (8000 with all rows) of 8 joints, dt = 0.01 s, one
        recording. `q` [m for the torso, else rad] and `v` [m/s, rad/s], `tau`
        [N for the torso, else N m]. Signals (n_samples, 8): "effort", as
        published [A for the arm]. The model has all other joints fixed.

    Raises
    ------
    OSError
        If a file is absent and may not or cannot be downloaded, or does not
        hold what was published.
    ValueError
        If `rows` is unknown.

    Notes
    -----
    Licence: Apache-2.0. The efforts of arm_5 to arm_7 have about 40 distinct
    values: they say next to nothing, and that of the torso little, on a scale
    of its own from which the weight of the robot is missing (the publishers
    add 9.81 m/s^2 times the mass carried). The model is tiago.urdf of
    example-robot-data.

    References
    ----------
    .. [1] D. V. Nguyen, V. Bonnet, S. Maxime, M. Gautier, P. Fernbach, F.
       Lamiraux, "FIGAROH: a Python toolbox for dynamic identification and
       geometric calibration of robots and humans", Humanoids 2023.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_tiago
    >>> tiago = fetch_tiago()  # doctest: +SKIP
    >>> tiago.position_units[:2]  # doctest: +SKIP
    ('m', 'rad')
    """
    if rows not in ("exciting", "all"):
        raise ValueError(f"rows must be 'exciting' or 'all', got {rows!r}.")
    files = fetch_files(
        "tiago",
        data_home=data_home,
        download_if_missing=download_if_missing,
        n_retries=n_retries,
        delay=delay,
    )
    raw = read_tiago(files)
    if rows == "exciting":
        first, last = _TIAGO_ROWS
        raw = {key: x[first : last + 1] for key, x in raw.items()}
    log = Log(
        name="trajectory",
        t=raw["t"],
        q=raw["q"],
        v=raw["v"],
        tau=np.multiply(_TIAGO_RATIOS, _TIAGO_GAINS) * raw["effort"],
        signals={"effort": raw["effort"]},
    )
    return Recording(
        name="tiago",
        **join([log], dt=median_period([log]), resample=resample),
        joint_names=_TIAGO_JOINTS,
        position_units=("m", *("rad",) * 7),
        torque_units=("N", *("N m",) * 7),
        urdf=find_description("tiago", dataset_folder("tiago", data_home)),
        source=source_address("tiago"),
        licence="Apache-2.0",
        citation=(
            "D. V. Nguyen, V. Bonnet, S. Maxime, M. Gautier, P. Fernbach, F. "
            'Lamiraux, "FIGAROH: a Python toolbox for dynamic identification and '
            'geometric calibration of robots and humans", Humanoids 2023.'
        ),
        description=(
            "TIAGo, torso lift and seven arm joints. Torque from motor currents, "
            "useful for arm_1 to arm_4 only."
        ),
    )


def read_tiago(files: dict[str, Path]) -> dict:
    """Stamps t [s] (n_samples,) and q, v, effort (n_samples, 8)."""
    names = {"position": "q", "velocity": "v", "effort": "effort"}
    raw = {}
    for path, local in files.items():
        table = np.loadtxt(local, delimiter=",", skiprows=1)
        raw[names[Path(path).stem.removeprefix("tiago_")]] = table[:, 1:]
        # The three files have the same stamps.
        raw["t"] = table[:, 0]
    return raw
