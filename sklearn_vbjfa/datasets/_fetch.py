"""Public loaders of the measured sets: what each of them holds, for users."""

import functools
import inspect
import textwrap
from collections.abc import Sequence
from os import PathLike

from sklearn_vbjfa.datasets._catalogue import CATALOGUE, load
from sklearn_vbjfa.datasets._download import Access
from sklearn_vbjfa.datasets._readers import UR5_GAINS
from sklearn_vbjfa.recording import Recording

# What the documentation of all loaders shares, by where it stands.
_SHARED = {
    "{access}": """\
data_home : path-like or None, default=None
    Folder that holds, or will hold, the folder ``{name}``; by default
    ``sklearn_vbjfa`` in scikit-learn's data folder.
download_if_missing : bool, default=True
    Whether to download what is absent instead of raising an error.
n_retries : int, default=3
    Further tries after a failure of the network.
delay : float, default=1.0
    Time between two tries [s].""",
    "{resample}": """\
resample : bool, default=True
    If False, samples and stamps are as recorded.""",
    "{raises}": """\
Raises
------
OSError
    If a file is absent and may not or cannot be downloaded, or does not
    hold what was published.""",
}


def _loader(told):
    """Make the public loader of a set from its own options and their documentation."""
    # It has the options of `Access` in front, and where the documentation names them
    # what `_SHARED` and the catalogue say.
    name = told.__name__.removeprefix("fetch_")
    common = inspect.signature(Access).parameters
    own = inspect.signature(told).parameters
    parameters = [
        one.replace(kind=one.KEYWORD_ONLY) for one in (*common.values(), *own.values())
    ]
    signature = inspect.Signature(parameters, return_annotation=Recording)

    @functools.wraps(told)
    def fetch(**options):
        bound = signature.bind(**options)
        bound.apply_defaults()
        given = bound.arguments
        access = Access(*(given.pop(key) for key in common))
        return load(name, access, **given)

    del fetch.__wrapped__
    fetch.__signature__ = signature
    fetch.__annotations__ = {one.name: one.annotation for one in parameters}
    fetch.__annotations__["return"] = Recording
    fetch.__doc__ = told.__doc__ and _documented(told.__doc__, name)
    return fetch


def _documented(text, name):
    """Fill in what the documentation of a loader leaves to `_SHARED` and catalogue."""
    cited = textwrap.wrap(
        f".. [1] {CATALOGUE[name].citation}", 76, subsequent_indent="   "
    )
    cited = "\n".join(["References", "----------", *cited])
    parts = _SHARED | {"{references}": cited}
    for key, part in parts.items():
        text = text.replace(f"    {key}", textwrap.indent(part, "    "))
    return text.replace("{name}", name)


@_loader
def fetch_emps():
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


@_loader
def fetch_tflex_1dof():
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


@_loader
def fetch_bam_xl330(
    *,
    include_free_swing: bool = False,
    resample: bool = True,
):
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


@_loader
def fetch_dfki_double_pendulum(
    *,
    which: str = "short",
    resample: bool = True,
):
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


@_loader
def fetch_ur5(
    *,
    gains: Sequence[float] = UR5_GAINS,
    resample: bool = True,
):
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


@_loader
def fetch_staubli_tx40():
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


@_loader
def fetch_kuka_kr300():
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


@_loader
def fetch_franka_panda(
    *,
    resample: bool = True,
):
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


@_loader
def fetch_kuka_lbr_med7(
    *,
    which: str = "fast",
):
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


@_loader
def fetch_tiago(
    *,
    rows: str = "exciting",
    resample: bool = True,
):
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


def fetch_unitree_go2(
    *,
    data_home: str | PathLike | None = None,
    download_if_missing: bool = True,
) -> Recording:
    """Load motor tests of a quadruped, Unitree Go2, that was held in the air.

    Ten runs of 23.5 to 23.9 s at 200 Hz, in which all twelve joints follow a
    chirp at once. The values are as recorded, the stamps uniform.

    Parameters
    ----------
    data_home : path-like or None, default=None
        Folder that holds the folder ``unitree_go2``; by default
        ``sklearn_vbjfa`` in scikit-learn's data folder. In it are ``go2.xml``
        and ``run_0.npz`` to ``run_9.npz``, see Notes.
    download_if_missing : bool, default=True
        Without effect: the files are converted, and not downloaded.

    Returns
    -------
    recording : Recording
        47065 samples of 12 joints, dt = 0.005 s, recordings "run_0" to
        "run_9". `q` [rad] and `v` [rad/s] of the motors, `tau` [N m] what
        the motors were told. Signals (n_samples, 12): "q_ref" [rad], "v_ref"
        [rad/s] (zero throughout), the motion that was asked for. The model is
        that of ``go2.xml``, whose base is free and is held level.

    Raises
    ------
    OSError
        If the files are absent.

    Notes
    -----
    `tau` is a command and no measurement: kp (q_ref - q) + kd (v_ref - v) with
    kp = 20, 20, 40 N m/rad and kd = 1, 1, 2 N m s/rad of hip, thigh and calf.
    It shares its noise with the positions and speeds, with these known gains: an
    error e of an encoder is -kp e of the torque, where regressions take the noise
    of inputs and of outputs for independent. What the motor makes of the command
    may come later, by an unknown delay, and may be less.

    The legs are the same four times, mirrored left and right. Armature, damping
    and friction in ``go2.xml`` were identified from such runs by somebody else and
    are no truth. Whether the base was level is not known (`BaseTilt`).

    Files: ``go2.xml`` is robot_model/go2/go2.xml of the repository; its meshes are
    not needed. ``run_k.npz`` has the columns of datasets/go2/traj_k.pt as arrays t,
    q, v, q_desired, v_desired, and kp and kd of each joint. Joints are in the order
    FL, FR, RL, RR, each hip, thigh, calf. Licence: BSD-3-Clause.

    References
    ----------
    .. [1] DLS Lab, Istituto Italiano di Tecnologia, repository
       sim2real-robot-identification.

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import fetch_unitree_go2
    >>> go2 = fetch_unitree_go2()  # doctest: +SKIP
    >>> go2.joint_names[:3]  # doctest: +SKIP
    ('FL_hip_joint', 'FL_thigh_joint', 'FL_calf_joint')
    """
    return CATALOGUE["unitree_go2"].load(
        "unitree_go2", Access(data_home, download_if_missing)
    )
