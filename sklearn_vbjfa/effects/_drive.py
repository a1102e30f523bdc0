"""Effects of drives, and of drives that act on several joints."""

import numpy as np
from sklearn.base import clone

from sklearn_vbjfa.effects._base import (
    INERTIA,
    POSITION,
    RATIO,
    STIFFNESS,
    TORQUE,
    VISCOSITY,
    Converted,
    InFiles,
    OnAllJoints,
    Shaped,
    Stateful,
)
from sklearn_vbjfa.effects._position import Spring

# Ratios of the joint's velocity in w to try: none, sum, difference; ratios of springs.
_PLAIN, _RATIOS = (0.0, 1.0, -1.0), (0.5, 0.7, 1.4, 2.0)
_RATIOS_OF_SPRINGS = (0.25, 0.5, 1.0, 2.0, 4.0)
# Smallest speed at which simulations smooth the sign of w [rad/s or m/s].
_SLOW = 1e-3
# Step of the finite difference: largest deflection as a share of the joint's range,
# small enough to be linear and large enough compared with rounding errors.
_DEFLECTION = 1e-4


class ToAnother(Shaped):
    """An effect that depends on the motion of a second joint."""

    def __init__(self, joint=0, other=1):
        super().__init__(joint)
        self.other = other

    joints = property(lambda self: (self.joint, self.other))

    @classmethod
    def describe(cls, shape, joint_label):
        labels = {name: joint_label(shape[name]) for name in {"other"} & shape.keys()}
        return super().describe({**shape, **labels}, joint_label)

    def applies(self, motion):
        if motion.n_joints < 2:
            return "there is only one joint"
        return super().applies(motion)

    def check(self):
        super().check()
        if self.other == self.joint:
            raise ValueError(
                f"other of {self.name} must be another joint than {self.joint}."
            )

    def shapes(self, motion):
        """All other joints."""
        others = range(motion.n_joints)
        return [{"other": other} for other in others if other != self.joint]


class Coupling(ToAnother):
    """Friction and inertia due to the motion of a second joint.

    tau = Fvm v_k + Fcm sign(w) + Iam a_k of the other joint k, w = v_k + ratio v: a
    differential or coupled wrist (ratio 1 or -1), or a tendon over both joints. Parts
    due to the joint's own speed are in its friction and rotor inertia. Source: Gautier,
    Janot and Vandanjon (2013), Staubli TX40, :doi:`10.1109/TCST.2012.2185697`.

    Parameters
    ----------
    other : int, default=1
        Joint that moves.
    ratio : float, default=0.0
        Share of the joint's own speed in w.
    """

    name = "coupling"
    label = "coupling to another joint"
    formula = r"F_{vm}\,v_k + F_{cm}\,\mathrm{sign}(w) + I_{am}\,a_k"
    shape_units = (("ratio", RATIO),)
    coarse = ("ratio",)
    coefficients = ("Fvm", "Fcm", "Iam")
    units = (VISCOSITY, TORQUE, INERTIA)
    contains = ("coulomb", "viscous")
    record = "each joint moving alone, with reversals"

    def __init__(self, joint=0, other=1, ratio=0.0):
        super().__init__(joint, other)
        self.ratio = ratio

    continuous = property(lambda self: () if self.ratio in _PLAIN else ("ratio",))

    # Without dry friction, the ratio has no effect.
    simple = property(lambda self: self.ratio == 0)

    def excludes(self):
        ratios = (1.0, -1.0, _RATIOS[0]) if self.ratio else (0.0,)
        return {clone(self).set_params(ratio=ratio).key() for ratio in ratios}

    def law(self, maths):
        j, k, ratio = self.joint, self.other, self.ratio
        sign = maths.sign(k, j) if ratio else maths.sign(k)

        def torque(state):
            w, dw = state.v[k] + ratio * state.v[j], state.a[k] + ratio * state.a[j]
            return state.v[k], sign(w, dw), state.a[k]

        return torque

    def simulated(self, table, Fvm, Fcm, Iam):
        j, k, ratio = self.joint, self.other, self.ratio
        table.coupling[j, k] += Fvm
        table.inertia[j, k] += Iam
        # The sign is smoothed over the speeds at which both joints may be sticking:
        # friction of a sum of velocities does not hold a single joint.
        slow = table.slow(k) + abs(ratio) * table.slow(j)
        return table.add("coupled_dry", j, Fcm, k, ratio, max(slow, _SLOW))

    def shapes(self, motion):
        """All other joints, alone and combined with this one."""
        kinds = motion.prismatic
        ratios = (*_PLAIN, *_RATIOS, *(-ratio for ratio in _RATIOS))
        return [
            shape | {"ratio": ratio}
            for shape in super().shapes(motion)
            for ratio in ratios
            if not ratio or kinds[shape["other"]] == kinds[self.joint]
        ]


class CouplingSpring(ToAnother, Converted, OnAllJoints):
    """Spring over two joints, such as a tendon, tau = k (q - ratio q_other - q0).

    The other joint's torque is -ratio times as large, because the energy depends on the
    common deflection. Source: Khalil and Dombre (2004), chapter 9.

    Parameters
    ----------
    other : int, default=1
        Second joint.
    ratio : float, default=1.0
        Deflection per position of the second joint, over that of the first, negated.
    """

    name = "coupling_spring"
    label = "spring to another joint"
    formula = r"k\,(q - \mathrm{ratio}\,q_\mathrm{other} - q_0)"
    coefficients = ("k", "c")
    units = (STIFFNESS, TORQUE)
    named_units = (("k", STIFFNESS), ("q0", POSITION))
    shape_units = (("ratio", RATIO),)
    contains = ("offset",)
    continuous = ("ratio",)
    constant = "c"
    record = "each joint moving alone through a wide range"
    files = InFiles(urdf="URDF has no spring", mjcf="")

    def __init__(self, joint=0, other=1, ratio=1.0):
        super().__init__(joint, other)
        self.ratio = ratio

    def columns(self, motion):
        weights = np.zeros((motion.n_joints, 1))
        weights[[self.joint, self.other], 0] = 1.0, -self.ratio
        deflection = motion.q @ weights
        return np.hstack([deflection, np.ones_like(deflection)])[:, None] * weights

    def simulated(self, table, k, c):
        joints = ((self.joint, 1.0), (self.other, -self.ratio))
        for (j, weight), (other, other_weight) in (joints, joints[::-1]):
            table.add("spring", j, k * weight * weight)
            table.add("coupled_spring", j, k * weight * other_weight, other)
            table.add("constant", j, c * weight)
        return True

    def shapes(self, motion):
        """All joints with higher index, with ratios of either sign."""
        return [
            shape | {"ratio": sign * ratio}
            for shape in super().shapes(motion)
            if shape["other"] > self.joint
            for ratio in _RATIOS_OF_SPRINGS
            for sign in (1.0, -1.0)
        ]

    parameters = Spring.parameters


class Elastic(Converted, Stateful, OnAllJoints):
    """Elastic joint seen from the motor, with the compliance 1/k as coefficient.

    Positions are measured at the motor and the link lags by tau / k, so that to first
    order the torque changes by 1/k times the derivative of the rigid-body torques along
    -(tau, dtau/dt, d2tau/dt2): mostly the second derivative of the joint torque times
    the link's inertia. Source: Spong (1987), :doi:`10.1115/1.3143860`.
    """

    name = "elastic"
    label = "joint elasticity"
    formula = (
        r"-\frac{1}{k} \left(\frac{\partial \tau}{\partial q_j} \tau_j"
        r" + \frac{\partial \tau}{\partial v_j} \dot\tau_j"
        r" + \frac{\partial \tau}{\partial a_j} \ddot\tau_j\right)"
    )
    coefficients = nonnegative = ("compliance",)
    units = (("rad/(N m)", "m/N"),)
    named_units = (("k", STIFFNESS),)
    needs = ("bodies", "load", "time")
    record = "fast motion, from a tenth of the elastic frequency"
    files = InFiles(
        simulation="a first-order correction of the torque, without forward dynamics"
    )

    def columns(self, motion):
        j = self.joint
        torque = motion.load[:, j]
        rate = motion.derivative(torque)
        second = motion.derivative(rate)
        largest = max(np.abs(torque).max(), np.finfo(float).tiny)
        compliance = _DEFLECTION * max(motion.range(j), 1e-9) / largest
        torques = []
        for side in (-0.5, 0.5):
            states = [motion.q.copy(), motion.v.copy(), motion.a.copy()]
            for state, derivative in zip(states, (torque, rate, second)):
                state[:, j] -= side * compliance * derivative
            torques.append(motion.rigid(*states))
        return ((torques[1] - torques[0]) / compliance)[:, :, None]

    def parameters(self, coef):
        compliance = float(coef[0])
        return {"k": 1 / compliance if compliance else np.inf}
