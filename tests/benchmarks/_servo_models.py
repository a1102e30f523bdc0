"""A servo on a pendulum with the friction models M1 to M6 of BAM, written anew.

M. Duclusaud, G. Passault, V. Padois, O. Ly, "Extended friction models for the physics
simulation of servo actuators", ICRA 2025; the equations are those of its sections on
friction and on the motor, and of the documentation of Rhoban/bam. `PUBLISHED` are the
parameters of the XL330-M288-T that its authors give (bam/params/xl330, Apache-2.0,
commits 11bb7ec and, for M2, 0186bd0), from logs that include those judged here.
"""

import numba
import numpy as np

# Firmware of the servo: duty cycle of one unit of P gain and one radian, 4096 counts a
# turn, gains in 256ths, 885 of full scale.
DUTY = 4096 / (2 * np.pi) / 256 / 885
MASS, LENGTH, GRAVITY = 0.49, 0.10, 9.81
NAMES = (
    "kt",
    "R",
    "armature",
    "q_offset",
    "friction_base",
    "friction_viscous",
    "friction_stribeck",
    "dtheta_stribeck",
    "alpha",
    "load_friction_motor",
    "load_friction_external",
    "load_friction_motor_stribeck",
    "load_friction_external_stribeck",
    "load_friction_motor_quad",
    "load_friction_external_quad",
)
_MOST_STEPS = 60  # of the fixed point of `voltage`


def parameters(**given):
    """Values in the order of `NAMES`; what is not given is absent from the model."""
    for name in ("load_friction_base", "load_friction_stribeck"):
        value = given.pop(name, None)
        if value is not None:
            # One coefficient of the motor's torque and the load's, M3 and M4.
            tail = "_stribeck" if name.endswith("stribeck") else ""
            given[f"load_friction_motor{tail}"] = value
            given[f"load_friction_external{tail}"] = value
    usual = {"dtheta_stribeck": 1.0, "alpha": 1.0}
    return np.array([given.get(name, usual.get(name, 0.0)) for name in NAMES])


PUBLISHED = {
    "M1": parameters(
        kt=0.37005152119117146,
        R=3.498349797205021,
        armature=0.0019898151031250474,
        q_offset=-0.0017672434168936602,
        friction_base=0.01821167858833861,
        friction_viscous=0.005902005392322235,
    ),
    "M2": parameters(
        kt=0.38082604009581533,
        R=3.6075906414207095,
        armature=0.0019147219169590663,
        q_offset=0.027299660077914623,
        friction_base=0.018601492795417476,
        friction_stribeck=0.0011012778060184916,
        dtheta_stribeck=0.2612676462986131,
        alpha=3.9999999983129455,
        friction_viscous=0.004047971379756858,
    ),
    "M3": parameters(
        kt=0.2914666127989648,
        R=2.0000000000177396,
        armature=0.002596131287992887,
        q_offset=0.015547202120246767,
        friction_base=0.002319691753871906,
        load_friction_base=0.26407734798146426,
        friction_viscous=0.016903883836368913,
    ),
    "M4": parameters(
        kt=0.291545002295148,
        R=2.0000000000185074,
        armature=0.0025782540685099515,
        q_offset=0.015495013221210871,
        friction_base=0.0021521768302085447,
        friction_stribeck=0.0004142783877571575,
        load_friction_base=0.25158745242367064,
        load_friction_stribeck=0.052028475872390546,
        dtheta_stribeck=0.11780576795939068,
        alpha=1.0000158406484074,
        friction_viscous=0.017819710915700462,
    ),
    "M5": parameters(
        kt=0.28575904242384065,
        R=2.000035077334106,
        armature=0.0025685034365580837,
        q_offset=0.016236782422969886,
        friction_base=0.0020391814934009656,
        friction_stribeck=5.468352862616111e-09,
        load_friction_motor=0.23007570268448654,
        load_friction_external=0.25825760438071466,
        load_friction_motor_stribeck=5.004477566346946e-07,
        load_friction_external_stribeck=0.11700810706121324,
        dtheta_stribeck=0.22258733082429977,
        alpha=2.3288381456131346,
        friction_viscous=0.018686549517152658,
    ),
    "M6": parameters(
        kt=0.28638649600668775,
        R=2.000017119760972,
        armature=0.002569774737524995,
        q_offset=0.01553585638800363,
        friction_base=0.0023258418670152347,
        friction_stribeck=0.0001856264715700908,
        load_friction_motor=0.23063000784446322,
        load_friction_external=0.26077932692372613,
        load_friction_motor_stribeck=1.9157733081388423e-06,
        load_friction_external_stribeck=0.15158776983752117,
        load_friction_motor_quad=0.005595958708218643,
        load_friction_external_quad=0.0037747149629857673,
        dtheta_stribeck=0.11532863880939243,
        alpha=1.000022697315946,
        friction_viscous=0.0185448141303962,
    ),
}
# What CMA-ES may change of M1 and M6: boxes, on logarithms but for the offset.
BOXES = {
    "M1": {
        "kt": (0.1, 1.5),
        "R": (1.0, 8.0),
        "armature": (2e-4, 2e-2),
        "q_offset": (-0.1, 0.1),
        "friction_base": (1e-4, 0.1),
        "friction_viscous": (1e-4, 0.1),
    }
}
BOXES["M6"] = {
    **BOXES["M1"],
    "friction_stribeck": (1e-5, 0.1),
    "dtheta_stribeck": (0.02, 3.0),
    "alpha": (0.5, 4.0),
    "load_friction_motor": (1e-3, 1.0),
    "load_friction_external": (1e-3, 1.0),
    "load_friction_motor_stribeck": (1e-5, 1.0),
    "load_friction_external_stribeck": (1e-5, 1.0),
    "load_friction_motor_quad": (1e-5, 0.5),
    "load_friction_external_quad": (1e-5, 0.5),
}


@numba.njit(cache=True)
def _budget(p, v, motor, external):
    """Largest friction at a speed and under two torques."""
    most = p[4] + p[5] * abs(v) + abs(p[9] * motor - p[10] * external)
    slow = np.exp(-(abs(v / p[7]) ** p[8]))
    square = p[13] * motor**2
    if abs(motor) > abs(external):
        square = p[14] * external**2
    return most + slow * (p[6] + abs(p[11] * motor - p[12] * external) + square)


@numba.njit(cache=True)
def swing(p, goal, gain, supply, q0, v0, dt, steps):
    """Positions at rows of `dt` [s] from commanded ones, both (n,).

    The firmware's P gain makes a duty cycle, which is within one, of the error;
    friction stops the joint within a step where its budget allows.
    """
    q, v, h = q0, v0, dt / steps
    inertia = MASS * LENGTH**2 + p[2]
    found = np.empty(goal.size)
    for k in range(goal.size):
        found[k] = q
        ahead = goal[min(k + 1, goal.size - 1)] - goal[k]
        for step in range(steps):
            error = goal[k] + step / steps * ahead - q
            duty = min(max(DUTY * gain * error, -1.0), 1.0)
            motor = p[0] / p[1] * (duty * supply - p[0] * v)
            external = -MASS * GRAVITY * LENGTH * np.sin(q + p[3])
            stop = -(inertia * v / h + motor + external)
            most = _budget(p, v, motor, external)
            friction = min(max(stop, -most), most)
            v += h * (motor + external + friction) / inertia
            q += h * v
    return found


def voltage(p, q, v, a):
    """Voltages (n,) that a motion needs, by a fixed point of the load's friction."""
    external = -MASS * GRAVITY * LENGTH * np.sin(q + p[3])
    needed = (MASS * LENGTH**2 + p[2]) * a - external
    motor = needed.copy()
    for _ in range(_MOST_STEPS):
        friction = np.array([_budget(p, *row) for row in zip(v, motor, external)])
        # Halfway: the budget may grow faster than the torque.
        motor = 0.5 * motor + 0.5 * (needed + np.sign(v) * friction)
    return p[1] / p[0] * motor + p[0] * v


def fitted(name, recordings, dt, *, evaluations, seed=0):
    """Parameters of M1 or M6 by CMA-ES on simulated positions, as BAM fits them.

    recordings : list of tuples (goal, gain, supply, q, v0), q (n,) measured.
    """
    import cma

    box = BOXES[name]
    low, high = np.array(list(box.values())).T
    free = np.array([key == "q_offset" for key in box])

    def point(x):
        values = np.where(
            free, low + x * (high - low), np.abs(low) * np.abs(high / low) ** x
        )
        return parameters(**dict(zip(box, values)))

    def missed(x):
        p = point(x)
        total = 0.0
        for goal, gain, supply, q, v0 in recordings:
            found = swing(p, goal, gain, supply, q[0], v0, dt, 6)
            total += np.abs(found - q).mean()
        return total if np.isfinite(total) else 1e6

    options = {"bounds": [0, 1], "verbose": -9, "seed": seed + 1}
    options |= {"maxfevals": evaluations, "popsize": 20}
    search = cma.CMAEvolutionStrategy(np.full(len(box), 0.5), 0.25, options)
    search.optimize(missed)
    return point(search.result.xbest)
