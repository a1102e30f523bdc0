"""Forward dynamics of a robot under feedforward and a low-gain controller.

One evaluation of the dynamics a step: positions live at the sample times and
velocities half way between (leapfrog), friction is treated implicitly at the middle of
the step. The error is of second order, and friction is stable at any step. Without
actuator dynamics the torques jump at the sample times; a jump then counts as half a
step earlier, so that a torque belongs to the middle of the time for which it is held.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sklearn_vbjfa.datasets._plant import STRIBECK_PEAK, joint_range

if TYPE_CHECKING:
    from sklearn_vbjfa.datasets._plant import Plant

# Error at which feedback alone gives the joint's typical torque [rad or m]. Low gains:
# an industrial controller's is a hundredth of it.
_SOFTNESS = 0.1
_DAMPING_RATIO = 0.7
# Cut-off of the derivative of the position error [Hz].
_DERIVATIVE_CUTOFF = 20.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Gains:
    """Gains of the feedback.

    Parameters
    ----------
    stiffness : ndarray of shape (nv,)
        Torque over position error [N m/rad or N/m].
    damping : ndarray of shape (nv,)
        Torque over velocity error [N m s/rad or N s/m].
    """

    stiffness: np.ndarray
    damping: np.ndarray


def low_gains(plant: "Plant") -> Gains:
    """Gains that are low for a robot: an error of 0.1 rad gives its typical torque.

    Parameters
    ----------
    plant : Plant
        Robot.

    Returns
    -------
    Gains
        Stiffness, and the damping that goes with it.
    """
    import pinocchio as pin

    model = plant.model
    middle, _ = joint_range(model)
    inertia = np.diag(pin.crba(model, model.createData(), middle))
    stiffness = plant.torque_size / _SOFTNESS
    damping = 2 * _DAMPING_RATIO * np.sqrt(stiffness * inertia)
    return Gains(stiffness=stiffness, damping=damping)


class ClosedLoop:
    """Copies of a robot with actuators and controller, stepped through time together.

    The controller sees encoder readings: its command is the feedforward plus stiffness
    times position error plus damping times the low-passed derivative of that error.

    Parameters
    ----------
    plant : Plant
        Robot.
    gains : Gains
        Feedback.
    dt : float
        Period of controller and recording [s].
    states : ndarray of shape (n_copies, 3 * nv)
        First state [q | v | a] of each copy.
    torques : ndarray of shape (n_copies, nv)
        Torques behind the actuators at the start [N m or N].
    substeps : int, default=1
        Steps of the integration in a period.
    """

    def __init__(self, plant, gains, dt, states, torques, substeps=1):
        self.plant, self.gains, self.dt = plant, gains, dt
        self._n, self._h = substeps, dt / substeps
        q, v, a = (np.array(x, dtype=float) for x in np.split(states, 3, axis=1))
        self._q, self._a = q, a
        self._u = v - 0.5 * self._h * a  # velocity half a step earlier
        self._tau = np.array(torques, dtype=float)
        self._e = (q - plant.cable_rest) @ plant.routing.T
        self._z = np.zeros_like(self._e)  # hysteresis, an elongation
        self._past = np.zeros_like(q)  # low-pass of the controller
        self._first_speed = v

    def run(self, reference, feedforward, noise):
        """Go on for as many periods as there are rows.

        Parameters
        ----------
        reference : ndarray of shape (n, n_copies, nv)
            Desired positions [rad or m].
        feedforward : ndarray of shape (n, n_copies, nv)
            Feedforward [N m or N].
        noise : ndarray of shape (n, n_copies, nv)
            Error of the encoders [rad or m].

        Returns
        -------
        q, v : ndarray of shape (n, n_copies, nv)
            True positions and velocities.
        torque : ndarray of shape (n, n_copies, nv)
            Torques behind the actuators [N m or N].
        command : ndarray of shape (n, n_copies, nv)
            Commands to the actuators [N m or N].
        """
        out = np.empty((4, *reference.shape))
        # A robot that runs away ends in infinities and no-numbers, to be found there.
        with np.errstate(all="ignore"):
            if self._first_speed is not None:
                self._set_out(reference[:1] - noise[:1], feedforward[:1])
            self._advance(reference - noise, feedforward, self._n, *out)
        return tuple(out)

    def _set_out(self, seen, feedforward):
        """Find the velocity half a step before the start.

        The acceleration that it takes is not the one asked for but the one that the
        torques give, and friction makes that depend on the velocity in turn.
        """
        state = (self._q, self._u, self._a, self._tau, self._e, self._z, self._past)
        start = [part.copy() for part in state]
        for _ in range(3):
            self._advance(seen, feedforward, 1, *np.empty((4, *seen.shape)))
            a = self._a.copy()
            for part, value in zip(state, start):
                part[:] = value
            self._a[:] = a
            self._u[:] = self._first_speed - 0.5 * self._h * a
        self._first_speed = None

    def _advance(self, seen, feedforward, substeps, q_out, v_out, tau_out, u_out):
        # Python takes half a microsecond for every operation below, whatever its size:
        # they are in place, what is constant is multiplied beforehand, and copies of
        # the robot share them.
        import pinocchio as pin

        plant, h = self.plant, self._h
        model = plant.model.copy()  # its armature changes in every step
        data, aba = model.createData(), pin.aba
        multiply, subtract, maximum = np.multiply, np.subtract, np.maximum

        share = 1 - np.exp(-2 * np.pi * _DERIVATIVE_CUTOFF * self.dt)
        on_error = self.gains.stiffness + self.gains.damping * share / self.dt
        on_past = self.gains.damping * share**2 / self.dt
        high = np.where(model.effortLimit > 0, model.effortLimit, np.inf)
        low = -high
        lagged = plant.lag > 0
        gain = 1 - np.exp(-h / plant.lag) if lagged else 1.0

        inverse_speed = 1 / plant.creep_speed
        coulomb = plant.coulomb * inverse_speed
        extra = plant.stiction / STRIBECK_PEAK * inverse_speed
        viscous, rotor = plant.viscous, np.array(plant.model.armature)
        routing, onto = plant.routing, np.ascontiguousarray(plant.routing.T)
        at_rest = routing @ plant.cable_rest
        turn = 0.5 / plant.cable_turn
        spring, hardening = plant.cable_spring, plant.cable_hardening
        hysteresis = plant.cable_hysteresis / plant.cable_turn
        side, gap = plant.shell_side, plant.shell_gap
        shell = plant.shell_side * plant.shell_stiffness

        q, u, a, tau = self._q, self._u, self._a, self._tau
        e, z, past = self._e, self._z, self._past
        v, error, command, s, t, rhs = (np.empty_like(q) for _ in range(6))
        x, y, w = (np.empty_like(e) for _ in range(3))
        copies = list(zip(q, v, rhs, s, a))
        for k in range(len(seen)):
            # controller
            subtract(seen[k], q, error)
            multiply(error, on_error, command)
            command -= multiply(past, on_past, t)
            command += feedforward[k]
            np.minimum(command, high, out=command)
            maximum(command, low, out=command)
            past *= 1 - share
            past += error
            if not lagged:
                tau[:] = command
            q_out[k], tau_out[k], u_out[k] = q, tau, command
            for i in range(substeps):
                # velocity at the time of q, extrapolated
                multiply(a, 0.5 * h, v)
                v += u
                if i == 0:
                    v_out[k] = v
                # friction: s is its torque over the speed
                multiply(v, inverse_speed, t)
                t *= t
                t += 1.0
                np.reciprocal(t, t)
                np.sqrt(t, s)
                s *= coulomb
                t *= extra
                s += t
                s += viscous
                subtract(tau, multiply(s, u, t), rhs)
                # cables: elongation, hysteresis at the middle of its step, force
                np.dot(q, onto, x)
                x -= at_rest
                subtract(x, e, y)
                e[:] = x
                np.abs(y, x)
                x *= turn
                y -= multiply(x, z, w)
                z += y
                x += 1.0
                z /= x
                multiply(e, e, x)
                x *= hardening
                x += spring
                x *= e
                x += multiply(z, hysteresis, y)
                rhs -= np.dot(x, routing, t)
                # shell
                multiply(q, side, t)
                t -= gap
                maximum(t, 0.0, out=t)
                t *= t
                t *= shell
                rhs -= t
                # Implicit friction: its slope counts as inertia.
                s *= 0.5 * h
                s += rotor
                for q_row, v_row, rhs_row, s_row, a_row in copies:
                    model.armature = s_row
                    a_row[:] = aba(model, data, q_row, v_row, rhs_row)
                u += multiply(a, h, t)
                q += multiply(u, h, t)
                if lagged:
                    subtract(command, tau, t)
                    t *= gain
                    tau += t
