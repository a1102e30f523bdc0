"""Loaders of test benches with one joint and no gravity."""

from os import PathLike
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from sklearn_vbjfa.datasets._download import fetch_files, source_address
from sklearn_vbjfa.recording._recording import Recording
from sklearn_vbjfa.recording._resample import Log, join


def fetch_emps(
    *,
    data_home: str | PathLike | None = None,
    download_if_missing: bool = True,
    n_retries: int = 3,
    delay: float = 1.0,
) -> Recording:
    """Load the electro-mechanical positioning system: one horizontal slide.

    A ball screw driven by a direct-current motor, in closed loop at 1 kHz.
    The values are as recorded; the stamps are uniform.

    Parameters
    ----------
    data_home : path-like or None, default=None
        Folder that holds, or will hold, the folder ``emps``; by default
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
        49682 samples of 1 joint, dt = 0.001 s. Recordings "DATA_EMPS" (two
        repeats of one reference) and "PULSES" (with force pulses). `q` [m] is
        the motor encoder expressed at the load, `tau` [N] the drive gain
        35.15 N/V times the voltage command, which is not a force sensor.
        Signals: "q_ref" (n_samples, 1) [m], "volts" (n_samples,) [V],
        "pulses" (n_samples,) [N] (zero in the first recording). The model is
        a prismatic joint without gravity.

    Raises
    ------
    OSError
        If a file is absent and may not or cannot be downloaded, or does not
        hold what was published.

    Notes
    -----
    Licence of the repository: Apache-2.0; the data were first published without
    a licence text. The publishers identified a mass of 95.1 kg, 203.5 N s/m
    viscous and 20.4 N dry friction, and an offset of -3.16 N.

    References
    ----------
    .. [1] A. Janot, M. Gautier, M. Brunot, "Data Set and Reference Models of
       EMPS", Workshop on Nonlinear System Identification Benchmarks, 2019.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_emps
    >>> emps = fetch_emps()  # doctest: +SKIP
    >>> emps.select("DATA_EMPS").q.shape  # doctest: +SKIP
    (24841, 1)
    """
    files = fetch_files(
        "emps",
        data_home=data_home,
        download_if_missing=download_if_missing,
        n_retries=n_retries,
        delay=delay,
    )
    logs = []
    for name, local in zip(("DATA_EMPS", "PULSES"), files.values(), strict=True):
        raw = read_emps(local)
        logs.append(
            Log(
                name=name,
                t=raw["t"],
                q=raw["qm"][:, None],
                tau=raw["gtau"] * raw["vir"][:, None],
                signals={
                    "q_ref": raw["qg"][:, None],
                    "volts": raw["vir"],
                    "pulses": raw["pulses_N"],
                },
            )
        )
    return Recording(
        name="emps",
        **join(logs, dt=0.001),
        joint_names=("slide",),
        position_units=("m",),
        torque_units=("N",),
        source=source_address("emps"),
        licence="Apache-2.0 (repository)",
        citation=(
            'A. Janot, M. Gautier, M. Brunot, "Data Set and Reference Models of '
            'EMPS", Workshop on Nonlinear System Identification Benchmarks, 2019.'
        ),
        description=(
            "Horizontal ball-screw slide with a DC motor. Force from the voltage "
            "command of the drive, position from the motor encoder."
        ),
    )


def read_emps(path: Path) -> dict:
    """Arrays (n_samples,) and gains of one file, names and values unchanged."""
    raw = {key: x for key, x in loadmat(path).items() if not key.startswith("__")}
    gains = {key: float(raw.pop(key)[0, 0]) for key in ("gtau", "kp", "kv")}
    arrays = {key: x.ravel() for key, x in raw.items()}
    arrays.setdefault("pulses_N", np.zeros(len(arrays["t"])))
    return {**arrays, **gains}


def fetch_tflex_1dof(
    *,
    data_home: str | PathLike | None = None,
    download_if_missing: bool = True,
    n_retries: int = 3,
    delay: float = 1.0,
) -> Recording:
    """Load the T-Flex axis: a flexure hinge with a direct-drive motor.

    Random motion at 1 kHz. Angle and speed are converted from degrees;
    otherwise the values are as recorded, the stamps are uniform.

    Parameters
    ----------
    data_home : path-like or None, default=None
        Folder that holds, or will hold, the folder ``tflex_1dof``; by default
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
        130716 samples of 1 joint, dt = 0.001 s, one recording. `q` [rad],
        `v` [rad/s] of the controller, `tau` [count] the motor current in
        counts of the driver, whose scale is unknown. Signals: "a"
        (n_samples, 1) [rad/s^2], a numerical derivative and very noisy. The
        model is a hinge about the vertical, so without gravity; its inertia
        of 1 is a placeholder.

    Raises
    ------
    OSError
        If a file is absent and may not or cannot be downloaded, or does not
        hold what was published.

    Notes
    -----
    Licence: MIT. There is practically no dry friction; a spring (the flexure)
    and a ripple of the motor with a period of about 19 degrees remain.

    References
    ----------
    .. [1] W. van Dijk, repository Inverse_dynamics_learning, 2019.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_tflex_1dof
    >>> tflex = fetch_tflex_1dof()  # doctest: +SKIP
    >>> tflex.torque_units  # doctest: +SKIP
    ('count',)
    """
    files = fetch_files(
        "tflex_1dof",
        data_home=data_home,
        download_if_missing=download_if_missing,
        n_retries=n_retries,
        delay=delay,
    )
    (local,) = files.values()
    raw = read_tflex(local)
    motion = np.deg2rad(raw["X"])
    dt = 0.001
    log = Log(
        name="TFlexADRC_RN20",
        t=dt * np.arange(len(motion)),
        q=motion[:, [0]],
        v=motion[:, [1]],
        tau=raw["Y"][:, None].astype(float),
        signals={"a": motion[:, [2]]},
    )
    return Recording(
        name="tflex_1dof",
        **join([log], dt=dt),
        joint_names=("hinge",),
        position_units=("rad",),
        torque_units=("count",),
        source=source_address("tflex_1dof"),
        licence="MIT, (c) 2019 Wouter van Dijk",
        citation="W. van Dijk, repository Inverse_dynamics_learning, 2019.",
        description=(
            "Flexure hinge with a direct-drive motor under random motion. Current "
            "in driver counts, spring and cogging instead of dry friction."
        ),
    )


def read_tflex(path: Path) -> dict:
    """X (n_samples, 3) [deg, deg/s, deg/s^2] and Y (n_samples,) [count]."""
    raw = loadmat(path)
    return {"X": raw["X"], "Y": raw["Y"].ravel()}
