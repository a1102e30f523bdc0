"""Controllers whose gains are known."""

import numpy as np
from sklearn.base import BaseEstimator


class PositionController(BaseEstimator):
    r"""Position controller of each joint, with velocity feedback.

    .. math:: \tau = K\,(q_{ref} - q) + D\,(\dot q_{ref} - \dot q),

    or :math:`-D\,\dot q` without `feedforward`. A cascade of a position loop with gain
    kp [1/s] and a velocity loop with gain kv and drive gain g is ``stiffness = g kv
    kp``, ``damping = g kv``.

    Parameters
    ----------
    stiffness : float or array-like of shape (nv,)
        K, in torque per position [N m/rad or N/m]; for channels that read currents, in
        their unit.
    damping : float or array-like of shape (nv,)
        D, in torque per velocity.
    feedforward : bool, default=False
        Whether the damping acts on the difference to the velocity of the reference,
        which is differentiated, and not on the velocity alone.
    period : float, default=None
        Time [s] for which the controller holds a torque, at most the sample period of
        the recording; None is that. Between rows the reference goes straight. A loop
        that is stable at its own rate need not be so at that of a slow recording.

    See Also
    --------
    RobotIdentifier : Takes it as `controller`, with ``criterion="simulation"``.

    References
    ----------
    .. [1] M. Gautier, A. Janot, P.-O. Vandanjon, "A new closed-loop output error method
       for parameter identification of robot dynamics", IEEE Trans. Control Syst.
       Technol. 21(2), 2013. :doi:`10.1109/TCST.2012.2185697`

    Examples
    --------
    >>> import numpy as np
    >>> from sklearn_vbjfa.simulation import PositionController
    >>> controller = PositionController(stiffness=100.0, damping=5.0)
    >>> controller.torque(np.array([0.2]), np.array([0.0]), np.array([0.1]),
    ...                   np.array([1.0]))
    array([5.])
    """

    def __init__(self, stiffness, damping, feedforward=False, period=None):
        self.stiffness = stiffness
        self.damping = damping
        self.feedforward = feedforward
        self.period = period

    def updates(self, dt):
        """Return how often torques are set in a sample period.

        Parameters
        ----------
        dt : float
            Sample period of the recording [s].

        Returns
        -------
        int
            Number of updates, at least one.

        Raises
        ------
        ValueError
            If `period` is no positive time, or longer than the sample period.
        """
        if self.period is None:
            return 1
        try:
            period = float(self.period)
        except (TypeError, ValueError):
            period = np.nan
        # A hundredth of a period is the jitter of clocks.
        if not 0 < period <= 1.01 * dt:
            raise ValueError(
                "controller: period must be a positive time in s, at most the sample "
                f"period of {dt:g} s; got {self.period!r}."
            )
        return max(round(dt / period), 1)

    def gains(self, nv):
        """Stiffness and damping of each joint.

        Parameters
        ----------
        nv : int
            Number of joints.

        Returns
        -------
        stiffness, damping : ndarray of shape (nv,)
            Gains.

        Raises
        ------
        ValueError
            If they are not finite, negative, or of another number of joints.
        """
        found = []
        for name in ("stiffness", "damping"):
            values = np.asarray(getattr(self, name), dtype=float)
            if values.shape not in {(), (nv,)} or not np.isfinite(values).all():
                raise ValueError(
                    f"controller: {name} must be one finite number or {nv}, one for "
                    f"each joint; got {getattr(self, name)!r}."
                )
            if (values < 0).any():
                raise ValueError(
                    f"controller: {name} is negative, which drives a joint away from "
                    f"its reference; got {getattr(self, name)!r}."
                )
            found.append(np.broadcast_to(values, (nv,)))
        return tuple(found)

    def torque(self, q_ref, v_ref, q, v):
        """Torques of the controller.

        Parameters
        ----------
        q_ref, v_ref : ndarray of shape (..., nv)
            Reference [rad or m, and per s].
        q, v : ndarray of shape (..., nv)
            State.

        Returns
        -------
        ndarray of shape (..., nv)
            Torques, in the unit of the gains.
        """
        stiffness, damping = self.gains(np.shape(q)[-1])
        aim = v_ref if self.feedforward else 0.0
        return stiffness * (q_ref - q) + damping * (aim - v)
