"""Models of the two kinds of robot that the paper identified: a head and an arm."""

from importlib import resources
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pinocchio as pin

# Rate of the controller of either robot in the paper [Hz].
RATES = {"head": 420.0, "arm": 480.0}


def paper_robot_urdf(name: str) -> str:
    """Path of the URDF of "head" or "arm"."""
    return str(
        resources.files("sklearn_vbjfa.datasets").joinpath("robots", f"{name}.urdf")
    )


def _load(name: str) -> "pin.Model":
    # The same reading as everywhere else in the package.
    from sklearn_vbjfa.model._loading import load_model

    return load_model(paper_robot_urdf(name))


def load_head_model() -> "pin.Model":
    """Load the nominal model of a vision head with seven joints.

    Three joints in the neck (pitch, roll, yaw) and two in each eye (pan, tilt), so
    that the tree forks at the skull. Made up after the description of the head in
    section 5.2 of [1]_: sizes and masses are plausible, not those of that robot.

    Returns
    -------
    pinocchio.Model
        Model with ``nq == nv == 7`` and limits of position [rad], speed [rad/s] and
        effort [N m].

    Raises
    ------
    ImportError
        If Pinocchio is not installed.

    See Also
    --------
    load_arm_model : The arm of the same article.
    make_closed_loop_recording : Recordings of a robot that differs from its model.

    References
    ----------
    .. [1] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification
       with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import load_head_model
    >>> model = load_head_model()
    >>> model.nv, model.names[1], model.names[7]
    (7, 'neck_pitch', 'right_eye_tilt')
    """
    return _load("head")


def load_arm_model() -> "pin.Model":
    """Load the nominal model of an anthropomorphic arm with ten joints.

    Three joints in the shoulder, one in the elbow, three in the wrist and three
    fingers, which all begin at the hand. Made up after the description of the arm in
    section 5.3 of [1]_: sizes and masses are plausible, not those of that robot.

    Returns
    -------
    pinocchio.Model
        Model with ``nq == nv == 10`` and limits of position [rad], speed [rad/s] and
        effort [N m].

    Raises
    ------
    ImportError
        If Pinocchio is not installed.

    See Also
    --------
    load_head_model : The head of the same article.
    make_closed_loop_recording : Recordings of a robot that differs from its model.

    References
    ----------
    .. [1] J.-A. Ting, A. D'Souza, S. Schaal, "Bayesian robot system identification
       with input and output noise", Neural Networks 24(1), 2011.
       :doi:`10.1016/j.neunet.2010.08.011`

    Examples
    --------
    >>> from sklearn_vbjfa.datasets import load_arm_model
    >>> model = load_arm_model()
    >>> model.nv, model.names[1], model.names[10]
    (10, 'shoulder_flexion', 'thumb_opposition')
    """
    return _load("arm")
