"""Declared terms of joints, and friction as a function of velocity and load."""

from sklearn.base import clone

from sklearn_vbjfa.effects._base import (
    INERTIA,
    RATIO,
    SPEED,
    TORQUE,
    VISCOSITY,
    Effect,
    InFiles,
    Shaped,
)

# Stribeck speeds to try, as shares of the joint's largest speed.
_STRIBECK = (0.02, 0.04, 0.07, 0.12, 0.2, 0.35, 0.6)


class Viscous(Effect):
    """Viscous friction, tau = Fv v.

    Source: Ting, D'Souza and Schaal (2011), :doi:`10.1016/j.neunet.2010.08.011`, the
    eleventh parameter of each joint there.
    """

    name = "viscous"
    alike = True
    label = "viscous friction"
    formula = r"F_v\,v"
    coefficients = nonnegative = ("Fv",)
    units = (VISCOSITY,)
    depends = ("speed",)
    record = "motion at several speeds"
    files = InFiles(parameter="viscous", urdf="", mjcf="")
    terms = (("viscous", "Fv"),)

    def law(self, maths):
        j = self.joint
        return lambda state: (state.v[j],)


class Coulomb(Effect):
    """Coulomb friction, tau = Fc sign(v).

    An element of `MaxwellSlip` without displacement. Source: Armstrong-Helouvry,
    Dupont and Canudas de Wit (1994), a survey of friction models,
    :doi:`10.1016/0005-1098(94)90209-7`.
    """

    name = "coulomb"
    alike = True
    label = "Coulomb friction"
    formula = r"F_c\,\mathrm{sign}(v)"
    coefficients = nonnegative = ("Fc",)
    units = (TORQUE,)
    depends = ("direction",)
    record = "many reversals"
    files = InFiles(parameter="coulomb", urdf="", mjcf="")
    terms = (("dry", "Fc"),)

    def law(self, maths):
        j, sign = self.joint, maths.sign(self.joint)
        return lambda state: (sign(state.v[j], state.a[j]),)


class Offset(Effect):
    """Constant torque, tau = c: zero offset of a sensor, bias of a drive.

    Source: Khalil and Dombre (2004), chapter 12.
    """

    name = "offset"
    label = "constant offset"
    formula = r"c"
    coefficients = ("c",)
    units = (TORQUE,)
    record = "motion with and against gravity"
    files = InFiles(parameter="offset", urdf="", mjcf="")
    terms = (("constant", "c"),)
    constant = ""  # it is the plain term itself

    def law(self, maths):
        return lambda state: (1.0,)


class RotorInertia(Effect):
    """Inertia of the motor's rotor seen from the joint, tau = Ir a.

    On the first joints of an arm it is a linear combination of link inertias. Source:
    Khalil and Dombre (2004), chapter 9.
    """

    name = "rotor_inertia"
    alike = True
    label = "rotor inertia"
    formula = r"I_r\,a"
    coefficients = nonnegative = ("Ir",)
    units = (INERTIA,)
    record = "fast acceleration in several poses"
    files = InFiles(parameter="rotor_inertia", urdf="", mjcf="")
    terms = (("armature", "Ir"),)

    def law(self, maths):
        j = self.joint
        return lambda state: (state.a[j],)


class AsymmetricFriction(Effect):
    """Friction that differs between the directions of motion.

    tau = dFc abs(sign(v)) + dFv abs(v): half the difference between the Coulomb and
    viscous coefficients for v > 0 and for v < 0, in addition to the symmetric `Coulomb`
    and `Viscous` halves. Without dFv it equals an `Offset`. Usual in screw drives and
    where gravity loads the gear flanks. Source: Janot, Gautier and Brunot (2019), data
    set and models of EMPS.
    """

    name = "asymmetric_friction"
    label = "friction that differs with direction"
    formula = r"\Delta F_c\,|\mathrm{sign}(v)| + \Delta F_v\,|v|"
    coefficients = ("dFc", "dFv")
    units = (TORQUE, VISCOSITY)
    contains = ("coulomb", "viscous")
    depends = ("speed", "direction")
    # Linear in each direction, as viscous friction is.
    bounded = True
    record = "both directions at several speeds"
    # Half the difference of Coulomb friction is a constant, also at rest.
    terms = (("constant", "dFc"), ("absolute", "dFv"))
    files = InFiles(places=(("constant", "dFc"),))

    def law(self, maths):
        j = self.joint
        # At rest friction lies between its values of the two directions, whose mean is
        # the same constant as in motion.
        if maths.rest is not None:
            return lambda state: (1.0, abs(state.v[j]))
        return lambda state: (1.0 * (state.v[j] != 0), abs(state.v[j]))


class Stribeck(Shaped):
    """Stribeck friction, tau = Fs exp(-abs(v / vs)^k) sign(v).

    Friction at low speed in excess of the Coulomb level. Source: Armstrong-Helouvry,
    Dupont and Canudas de Wit (1994), section 2, :doi:`10.1016/0005-1098(94)90209-7`.

    Parameters
    ----------
    vs : float, default=0.1
        Stribeck speed [rad/s or m/s].
    k : {1, 2}, default=1
        Exponent.
    """

    name = "stribeck"
    alike = True
    label = "Stribeck friction"
    formula = r"F_s\,e^{-|v/v_s|^k}\,\mathrm{sign}(v)"
    coefficients = nonnegative = ("Fs",)
    units = (TORQUE,)
    contains = ("coulomb", "viscous")
    continuous = positive = ("vs",)
    tuned = ("vs", "k")
    shape_units = (("vs", SPEED), ("k", RATIO))
    depends = ("direction",)
    record = "slow motion without standing still, and fast motion"
    terms = (("stribeck", "Fs", "vs", "k"),)

    def __init__(self, joint=0, vs=0.1, k=1):
        super().__init__(joint)
        self.vs = vs
        self.k = k

    def law(self, maths):
        j, vs, k = self.joint, self.vs, self.k
        exp, sign = maths.exp, maths.sign(j)

        def torque(state):
            v = state.v[j]
            return (exp(-(abs(v / vs) ** k)) * sign(v, state.a[j]),)

        return torque

    def forms(self):
        return [clone(self).set_params(k=k) for k in (1, 2)]

    def shapes(self, motion):
        """Stribeck speeds up to 0.6 of the joint's largest speed, both exponents."""
        fast = motion.speed(self.joint)
        return [{"vs": s * fast, "k": k} for k in (1, 2) for s in _STRIBECK]


class ViscousQuadratic(Effect):
    """Quadratic viscous friction, tau = F2 v abs(v).

    Drag of fans and fluids; if negative, friction that grows less than proportionally
    to speed, as in lubricated gears. Source: Carvalho Bittencourt and Gunnarsson
    (2012), :doi:`10.1115/1.4006589`.
    """

    name = "viscous_quadratic"
    alike = True
    label = "friction with the square of speed"
    formula = r"F_2\,v\,|v|"
    coefficients = ("F2",)
    units = (("N m s^2/rad^2", "N s^2/m^2"),)
    contains = ("viscous", "coulomb")
    depends = ("speed",)
    record = "slow and fast motion"
    terms = (("quadratic", "F2"),)

    def law(self, maths):
        j = self.joint
        return lambda state: (state.v[j] * abs(state.v[j]),)


class LoadFriction(Effect):
    """Friction proportional to the load, tau = mu abs(tau_load) sign(v).

    Gears and bearings press harder under load. The load is the torque of the rigid
    bodies of the model. Source: Hamon, Gautier and Garrec (2010), section 3,
    :doi:`10.1109/IROS.2010.5649189`.
    """

    name = "load_friction"
    alike = True
    label = "load-dependent friction"
    formula = r"\mu\,|\tau_\mathrm{load}|\,\mathrm{sign}(v)"
    coefficients: tuple[str, ...] = ("mu",)
    nonnegative: tuple[str, ...] = coefficients
    units: tuple[tuple[str, str], ...] = (RATIO,)
    contains: tuple[str, ...] = ("coulomb", "viscous")
    needs = ("load",)
    depends = ("load", "direction")
    record = "reversals at two loads"
    terms = (("load_dry", "mu"),)

    def law(self, maths):
        j, sign = self.joint, maths.sign(self.joint)
        return lambda state: (abs(state.load[j]) * sign(state.v[j], state.a[j]),)


class GearLoss(LoadFriction):
    """Load-dependent friction that differs between the directions of power.

    tau = mud abs(tau_load) sign(v) while the drive moves the load, and mub
    abs(tau_load) sign(v) while the load moves the drive: the efficiencies of a gear
    forward and backward. It equals `LoadFriction` with their mean plus half of their
    difference times the load, as a `TorqueGain` adds. Source: Hamon, Gautier and Garrec
    (2010), :doi:`10.1109/IROS.2010.5649189`.
    """

    name = "gear_loss"
    alike = True
    label = "gear loss by direction of power"
    formula = (
        r"\mu_d\,|\tau_\mathrm{load}|\,\mathrm{sign}(v)"
        r" \quad\text{driving}, \quad"
        r" \mu_b\,|\tau_\mathrm{load}|\,\mathrm{sign}(v) \quad\text{back-driven}"
    )
    coefficients = nonnegative = ("mud", "mub")
    units = (RATIO, RATIO)
    contains = ("load_friction", "coulomb", "viscous")
    files = InFiles(simulation="its direction of power depends on the accelerations")
    record = "reversals at loads of both signs"

    def law(self, maths):
        j, sign = self.joint, maths.sign(self.joint)

        def torque(state):
            load = state.load[j]
            loss = abs(load) * sign(state.v[j], state.a[j])
            # The loss has the sign of the load while the drive moves the load.
            driving = 0.5 + 0.5 * maths.sign_of(load * loss)
            return driving * loss, (1.0 - driving) * loss

        return torque
