"""Effects that change with time."""

import numpy as np

from sklearn_vbjfa.effects._base import TIME, TORQUE, VISCOSITY, Effect
from sklearn_vbjfa.effects._friction import Coulomb, Viscous

# Time constants to try, as shares of the recording's length.
_CONSTANTS = (0.1, 0.2, 0.4, 0.8, 3.0)
# Number of instants to try.
_INSTANTS = 24
# Distance of a payload's centre of mass from the last body's frame [m].
_FARTHEST = 1.0


class Drift(Effect):
    """Friction or offset that changes while the robot warms up.

    tau = D exp(-t / T) times 1, sign(v) or v: the grease gets thinner, the strain
    gauge warmer [1]_. What remains when warm is left to `Offset`, `Coulomb` and
    `Viscous`.

    Parameters
    ----------
    joint : int, default=0
        Joint, from zero.
    of : {"coulomb", "offset", "viscous"}, default="coulomb"
        What drifts.
    time_constant : float, default=100.0
        T [s] of the decay, which starts at t = 0.

    Notes
    -----
    After the last time of the fit it goes on fading, towards what remains when warm;
    before the first one it is as it was then, and does not grow.

    References
    ----------
    .. [1] A. Carvalho Bittencourt, S. Gunnarsson, "Static friction in a robot joint:
       modeling and identification of load and temperature effects", J. Dyn. Sys.,
       Meas., Control 134(5), 2012. :doi:`10.1115/1.4006589`

    Examples
    --------
    >>> from sklearn_vbjfa.effects import Drift
    >>> drift = Drift(of="offset", time_constant=1.0).fit([[0, 0, 0]])
    >>> drift.transform([[0, 0, 0], [0, 0, 0]], t=[0.0, 1.0]).ravel().round(3)
    array([1.   , 0.368])
    """

    name = "drift"
    label = "drift with time"
    formula = (
        r"D\,e^{-t / \mathrm{time\_constant}} f, \quad"
        r" f = \mathrm{sign}(v),\ 1\ \text{or}\ v"
    )
    coefficients = ("D",)
    units = (TORQUE,)
    shape_units = (("time_constant", TIME),)
    contains = ("offset", "coulomb", "viscous")
    needs = ("time",)
    continuous = ("time_constant",)
    positive = ("time_constant",)
    slow = True
    afterwards = "fades on"
    seen_over = "time"
    visible = "the same motion early and late"
    record = "the same motion cold and warm"

    def __init__(self, joint=0, of="coulomb", time_constant=100.0):
        super().__init__(joint)
        self.of = of
        self.time_constant = time_constant

    @property
    def with_motion(self):
        """Whether what drifts is a friction; see `Effect.with_motion`."""
        return self.of != "offset"

    @classmethod
    def describe(cls, shape, joint_label):
        """Say what drifts; see `Effect.describe`."""
        what = {"coulomb": Coulomb.label, "viscous": Viscous.label}
        of = shape.get("of")
        return f"drift of the {what.get(of, of)} with time" if of else cls.label

    def columns(self, motion):
        """Decaying torque; see `Effect.columns`."""
        signals = {
            "coulomb": motion.sign(self.joint)[:, 0],
            "offset": np.ones(motion.v.shape[0]),
            "viscous": motion.v[:, self.joint],
        }
        if self.of not in signals:
            raise ValueError(f"of must be one of {list(signals)}; got {self.of!r}.")
        decay = np.exp(-motion.known_time() / self.time_constant)
        return (signals[self.of] * decay)[:, None]

    def later(self, coef, t):
        """D exp(-t / T); see `Effect.later`."""
        return {"D": float(coef[0] * np.exp(-t / self.time_constant))}

    def shapes(self, motion):
        """Time constants from a tenth to three times the recording."""
        length = motion.duration()
        return [
            {"of": of, "time_constant": s * length}
            for of in ("coulomb", "offset", "viscous")
            for s in _CONSTANTS
        ]

    def parameter_units(self, prismatic=False):
        """Units; see `Effect.parameter_units`."""
        units = VISCOSITY if self.of == "viscous" else TORQUE
        return super().parameter_units(prismatic) | {"D": units[bool(prismatic)]}


class Payload(Effect):
    """The last body's mass and first moments change at an instant.

    tau = Phi_n(q, v, a) (dm, dmcx, dmcy, dmcz, dI) for t >= instant, with the columns
    of the last body's regressor: something was picked up, put down or lost [1]_. It
    counts as a ball at its centre of mass c = dmc / dm, of inertia dm (c'c 1 - c c') +
    d 1 in the body's frame: the first part follows from the mass and the moments, to
    first order around `centre`; d, that of the ball itself, is a coefficient.

    Parameters
    ----------
    joint : int, default=0
        Last joint, from zero; all joints feel it.
    instant : float, default=0.0
        Time of the change [s].
    centre : tuple of three floats, default=(0.0, 0.0, 0.0)
        Centre of mass [m] in the last body's frame around which the inertia is
        linearised.

    Notes
    -----
    It is not there before the instant, and stays after the last time of the fit.

    References
    ----------
    .. [1] W. Khalil, M. Gautier, P. Lemoine, "Identification of the payload inertial
       parameters of industrial manipulators", ICRA, 2007.
       :doi:`10.1109/ROBOT.2007.364241`

    Examples
    --------
    >>> from sklearn_vbjfa.effects import Payload
    >>> Payload(instant=12.0).parameters([0.5, 0.0, 0.1, 0.0, 0.0])["dm"]
    0.5
    """

    name = "payload"
    label = "change of payload"
    formula = (
        r"\Phi_n(q, v, a)\,\Delta\pi(dm, dmc_x, dmc_y, dmc_z, d) \quad"
        r" \text{for}\ t \ge \mathrm{instant}"
    )
    coefficients = ("dm", "dmcx", "dmcy", "dmcz", "d")
    units = (("kg", "kg"),) + (("kg m", "kg m"),) * 3 + (("kg m^2", "kg m^2"),)
    shape_units = (("instant", TIME),)
    needs = ("time",)
    continuous = ("instant",)
    jumping = ("instant",)
    tangent = ("centre",)
    slow = True
    afterwards = "stays"
    seen_over = "time"
    visible = "motion against gravity before and after the change"
    record = "motion against gravity with and without payload"
    whole_robot = True

    def __init__(self, joint=0, instant=0.0, centre=(0.0, 0.0, 0.0)):
        super().__init__(joint)
        self.instant = instant
        self.centre = centre

    def applies(self, motion):
        """Only the last joint carries a payload; see `Effect.applies`."""
        if self.joint != motion.n_joints - 1:
            return "only the last body carries a payload"
        if motion.last_body is None:
            return "needs the rigid-body dynamics"
        return super().applies(motion)

    def columns(self, motion):
        """Regressor of the last body after the instant; see `Effect.columns`."""
        after = motion.t >= self.instant
        columns = motion.last_body() @ _ball(np.asarray(self.centre, dtype=float))
        return columns * after[:, None, None]

    def inertial(self, coef):
        """Return what the last body's inertial parameters change by, ndarray (10,).

        Parameters
        ----------
        coef : array-like of shape (5,)
            Coefficients.

        Returns
        -------
        ndarray of shape (10,)
            Changes of m, mc_x, ..., I_zz [kg, kg m, kg m^2].
        """
        return _ball(np.asarray(self.centre, dtype=float)) @ np.asarray(coef)

    def at(self, coef):
        """Linearise the inertia at the centre of mass that was found."""
        mass, *moments = coef[:4]
        centre = np.array(moments) / mass if mass else np.zeros(3)
        # Farther out it is no payload: mass and moments are hardly known.
        if not np.linalg.norm(centre) <= _FARTHEST:
            return self
        return Payload(self.joint, self.instant, tuple(map(float, centre)))

    def shapes(self, motion):
        """Instants all over the recording."""
        t = motion.t
        starts = motion.later
        shares = np.linspace(t[0], t[-1], _INSTANTS + 2)[1:-1]
        # Between two recordings all instants are one: the start of the second.
        border = np.searchsorted(t, starts)
        taken = np.isin(np.searchsorted(t, shares), border)
        instants = np.unique(np.concatenate([shares[~taken], starts]))
        return [{"instant": float(s)} for s in instants]


def _ball(c):
    """Inertial parameters (10, 5) by mass, first moments and own inertia of a ball."""
    # The inertia (s's 1 - s s') / m of a point is homogeneous in mass m and moments
    # s, so that its tangent at s = m c passes through zero.
    one = np.eye(3)
    out = np.zeros((10, 5))
    out[:4, :4] = np.eye(4)
    slopes = [np.outer(c, c) - (c @ c) * one]
    slopes += [
        2 * c[k] * one - np.outer(one[k], c) - np.outer(c, one[k]) for k in range(3)
    ]
    for column, slope in enumerate([*slopes, one]):
        # Ixx, Ixy, Iyy, Ixz, Iyz, Izz
        out[4:, column] = slope[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return out
