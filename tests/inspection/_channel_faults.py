"""Faults of whole channels, put into recordings whose channels are sound.

Nothing here uses the checks that are judged. A fault is a function of positions,
torques, sample period, the joint and a generator of random numbers.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

# What the nominal torque cannot mimic of the true one once a fault is in: at least this
# share of its variance, beside friction, spring, rotor and offset, on some joint.
VISIBLE_SHARE = 0.25
COUNTS = (4096, 20000, 2**17)


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One kind of fault.

    Attributes
    ----------
    put : callable
        ``put(q, tau, dt, j, rng)`` gives positions, torques and dt with the fault.
    kinds : frozenset of str
        Kinds of findings that name it.
    seen_by : {"samples", "geometry", "size"}
        What shows it: the samples alone; the torques that joints of the nominal model
        make on one another; the size of the nominal torque beside the joint's others.
    revolute : bool
        Whether it needs a revolute joint.
    """

    put: Callable
    kinds: frozenset
    seen_by: str = "samples"
    revolute: bool = False


# -- torques ---------------------------------------------------------------------------


def motor_side(q, tau, dt, j, rng):
    """One torque at the motor's side of a gear of 50 to 160."""
    tau = tau.copy()
    tau[:, j] /= rng.uniform(50, 160)
    return q, tau, dt


def millinewton(q, tau, dt, j, rng):
    """All torques in N mm."""
    return q, 1e3 * tau, dt


def torque_sign(q, tau, dt, j, rng):
    """One torque with the other sign."""
    tau = tau.copy()
    tau[:, j] *= -1
    return q, tau, dt


def held_torques(q, tau, dt, j, rng):
    """Torques at a rate that is lower by 3 to 8."""
    return q, held(tau, int(rng.integers(3, 9))), dt


# -- positions -------------------------------------------------------------------------


def wrapped(q, tau, dt, j, rng):
    """One position wrapped, at an angle that the motion passes."""
    q = q.copy()
    at = np.median(q[:, j])
    q[q[:, j] > at, j] -= 2 * np.pi
    return q, tau, dt


def counts_of_one(q, tau, dt, j, rng):
    """One position in encoder counts."""
    q = q.copy()
    q[:, j] = np.round(q[:, j] * rng.choice(COUNTS) / (2 * np.pi))
    return q, tau, dt


def counts_of_all(q, tau, dt, j, rng):
    """All positions in encoder counts."""
    return np.round(q * rng.choice(COUNTS) / (2 * np.pi)), tau, dt


def degrees(q, tau, dt, j, rng):
    """All positions in degrees."""
    return np.rad2deg(q), tau, dt


def held_positions(q, tau, dt, j, rng):
    """Positions at a rate that is lower by 3 to 8."""
    return held(q, int(rng.integers(3, 9))), tau, dt


def quarter_turn(q, tau, dt, j, rng):
    """Zero of one joint off by a quarter turn."""
    q = q.copy()
    q[:, j] += rng.choice([-1, 1]) * np.pi / 2
    return q, tau, dt


# -- several channels ------------------------------------------------------------------


def both_signs(q, tau, dt, j, rng):
    """Position and torque of one joint with the other sign."""
    q, tau = q.copy(), tau.copy()
    q[:, j] *= -1
    tau[:, j] *= -1
    return q, tau, dt


def reverse_order(q, tau, dt, j, rng):
    """Joints from the hand to the base."""
    return q[:, ::-1].copy(), tau[:, ::-1].copy(), dt


def cyclic_order(q, tau, dt, j, rng):
    """Joints counted from another one."""
    shift = int(rng.integers(1, q.shape[1]))
    return np.roll(q, shift, axis=1), np.roll(tau, shift, axis=1), dt


def cyclic_torques(q, tau, dt, j, rng):
    """Torques counted from another joint."""
    return q, np.roll(tau, int(rng.integers(1, q.shape[1])), axis=1), dt


def random_order(q, tau, dt, j, rng):
    """Joints in any other order."""
    order = np.arange(q.shape[1])
    while (order == np.arange(order.size)).all():
        order = rng.permutation(order)
    return q[:, order], tau[:, order], dt


# -- time ------------------------------------------------------------------------------


def frozen_logger(q, tau, dt, j, rng):
    """One row written for 0.3 s, or a twentieth of the recording, three times."""
    q, tau = q.copy(), tau.copy()
    n = max(8, min(round(0.3 / dt), len(q) // 20))
    for share in (0.25, 0.5, 0.7):
        start = int(share * len(q))
        q[start : start + n], tau[start : start + n] = q[start], tau[start]
    return q, tau, dt


def milliseconds(q, tau, dt, j, rng):
    """Sample period in ms."""
    return q, tau, 1e3 * dt


def hertz(q, tau, dt, j, rng):
    """Sample rate instead of period."""
    return q, tau, 1.0 / dt


def microseconds(q, tau, dt, j, rng):
    """Sample period a thousand times too short."""
    return q, tau, 1e-3 * dt


def tenfold(q, tau, dt, j, rng):
    """Sample period ten times too long, or too short."""
    return q, tau, dt * float(rng.choice([0.1, 10.0]))


def shuffled(q, tau, dt, j, rng):
    """Rows in random order."""
    order = rng.permutation(len(q))
    return q[order], tau[order], dt


# -- helpers ---------------------------------------------------------------------------


def held(x, k):
    """Every k-th row, k times."""
    return x[k * (np.arange(len(x)) // k)]


def smooth(q):
    """Take a moving mean, as a drive makes its velocities from its positions."""
    window = np.ones(5) / 5
    wide = np.pad(q, ((2, 2), (0, 0)), mode="edge")
    return np.column_stack([np.convolve(x, window, mode="valid") for x in wide.T])


_ORDER = frozenset(
    {"swapped_joints", "swapped_positions", "swapped_torques", "joint_order"}
)
_DT = frozenset({"wrong_dt"})
FAULTS = {
    "torque of one joint, motor side": Fault(
        put=motor_side, kinds=frozenset({"gear_factor"}), seen_by="size"
    ),
    "torques in N mm": Fault(
        put=millinewton, kinds=frozenset({"gear_factor"}), seen_by="size"
    ),
    "sign of one torque": Fault(
        put=torque_sign, kinds=frozenset({"torque_sign"}), seen_by="size"
    ),
    "wrapped angle": Fault(
        put=wrapped, kinds=frozenset({"wrapped_position"}), revolute=True
    ),
    "frozen logger": Fault(put=frozen_logger, kinds=frozenset({"repeated_rows"})),
    "positions held": Fault(put=held_positions, kinds=frozenset({"held_position"})),
    "torques held": Fault(put=held_torques, kinds=frozenset({"held_torque"})),
    "degrees": Fault(put=degrees, kinds=frozenset({"position_degrees"}), revolute=True),
    "encoder counts, one joint": Fault(
        put=counts_of_one, kinds=frozenset({"position_counts"}), revolute=True
    ),
    "encoder counts, all joints": Fault(
        put=counts_of_all, kinds=frozenset({"position_counts"}), revolute=True
    ),
    "both signs of one joint": Fault(
        put=both_signs, kinds=frozenset({"flipped_joint"}), seen_by="geometry"
    ),
    "joints in reverse order": Fault(
        put=reverse_order, kinds=_ORDER, seen_by="geometry"
    ),
    "joints in cyclic order": Fault(put=cyclic_order, kinds=_ORDER, seen_by="geometry"),
    "joints in random order": Fault(put=random_order, kinds=_ORDER, seen_by="geometry"),
    "torques in cyclic order": Fault(
        put=cyclic_torques, kinds=_ORDER, seen_by="geometry"
    ),
    "zero off by 90 degrees": Fault(
        put=quarter_turn,
        kinds=frozenset({"position_zero"}),
        seen_by="geometry",
        revolute=True,
    ),
    "dt in ms": Fault(put=milliseconds, kinds=_DT),
    "rate as dt": Fault(put=hertz, kinds=_DT),
    "dt a thousandth": Fault(put=microseconds, kinds=_DT),
    "dt off by ten": Fault(put=tenfold, kinds=_DT, seen_by="geometry"),
    "shuffled rows": Fault(put=shuffled, kinds=frozenset({"shuffled_rows"})),
}


def visible(model, fault, q, tau, dt, j, rng):
    """Whether the nominal model can show a fault at all.

    Parameters
    ----------
    model : pinocchio.Model
        Nominal robot.
    fault : Fault
        Fault.
    q, tau : ndarray of shape (n, nv)
        Sound recording.
    dt : float
        Sample period [s].
    j : int
        Joint.
    rng : numpy.random.Generator
        In the state in which the fault is put in.

    Returns
    -------
    bool
        For faults of the samples always True.
    """
    if fault.seen_by == "samples":
        return True
    v, a, rigid = nominal(model, q, dt)
    if fault.seen_by == "size":
        joints = range(q.shape[1]) if fault.put is millinewton else [j]
        share = [_share_left(tau[:, k], v, a, q, k, None) for k in joints]
        with_it = [_share_left(tau[:, k], v, a, q, k, rigid[:, k]) for k in joints]
        return max(b - a for a, b in zip(with_it, share)) > 0.5
    wrong_q, wrong_torque, wrong_dt = fault.put(q, rigid, dt, j, rng)
    wrong_v, wrong_a, wrong = nominal(model, wrong_q, wrong_dt)
    left = [
        _share_left(wrong_torque[:, k], wrong_v, wrong_a, wrong_q, k, wrong[:, k])
        * np.var(wrong_torque[:, k])
        # a joint whose torque is friction shows little
        / max(np.var(tau[:, k]), 1e-12)
        for k in range(q.shape[1])
        if np.var(wrong_torque[:, k]) > 0.1 * np.var(tau[:, k])
    ]
    return max(left, default=0.0) > VISIBLE_SHARE


def nominal(model, q, dt):
    """Velocities, accelerations and torques (n, nv) that the nominal model asks for."""
    import pinocchio as pin

    x = smooth(smooth(smooth(q)))
    v = smooth(np.gradient(x, dt, axis=0))
    a = smooth(np.gradient(v, dt, axis=0))
    data = model.createData()
    return v, a, np.array([pin.rnea(model, data, *row) for row in zip(x, v, a)])


def _share_left(y, v, a, q, k, rigid):
    """Share of a torque's variance that friction, spring and rotor leave."""
    columns = [np.ones(len(y)), q[:, k], v[:, k], np.sign(v[:, k]), a[:, k]]
    if rigid is not None:
        columns.append(rigid)
    design = np.column_stack(columns)
    design = design / np.maximum(np.abs(design).max(axis=0), 1e-12)
    left = y - design @ np.linalg.lstsq(design, y, rcond=None)[0]
    return np.var(left) / max(np.var(y), 1e-300)
