"""Known faults that are put into real recordings: pure functions, nothing in place.

Joints count from zero, angles are in degrees where a name says so.
"""

import numpy as np


def rotate_gravity(model, degrees, axis=0):
    """Return a copy of a model whose gravity is rotated about an axis of the base."""
    turned = model.copy()
    angle = np.deg2rad(degrees)
    u = np.eye(3)[axis]
    g = np.asarray(model.gravity.linear, dtype=float)
    # Rodrigues' formula.
    turned.gravity.linear = (
        np.cos(angle) * g
        + np.sin(angle) * np.cross(u, g)
        + (1 - np.cos(angle)) * (u @ g) * u
    )
    return turned


def shift_zero(q, joint, degrees):
    """Add an angle to one column of positions (n, nv) [rad]."""
    shifted = np.array(q, dtype=float)
    shifted[:, joint] += np.deg2rad(degrees)
    return shifted


def scale_channel(tau, joint, gain):
    """Multiply one column of torques (n, nv)."""
    scaled = np.array(tau, dtype=float)
    scaled[:, joint] *= gain
    return scaled


def made_up_temperature(n_samples, low=20.0, high=45.0, cycles=1.25):
    """Temperature (n,) [deg C] that rises and falls over the rows."""
    phase = 2 * np.pi * cycles * np.arange(n_samples) / max(n_samples - 1, 1)
    return low + 0.5 * (high - low) * (1 - np.cos(phase))


def friction_of_speed(v, viscous, coulomb, standstill):
    """Friction (n,) of a joint's speed (n,): no sign is taken of the noise at rest."""
    return viscous * v + coulomb * np.clip(v / standstill, -1.0, 1.0)


def heat_friction(tau, joint, friction, temperature, slope, reference=20.0):
    """Multiply the friction of one joint by 1 + slope (T - reference)."""
    heated = np.array(tau, dtype=float)
    heated[:, joint] += slope * (temperature - reference) * friction
    return heated


def jitter_stamps(t, dt, share, rng):
    """Time stamps (n,) written late or early, by `share` of `dt` (standard deviation).

    At most 0.45 of a period, so that no two exchange their order.
    """
    late = np.clip(share * rng.standard_normal(len(t)), -0.45, 0.45)
    return np.asarray(t, dtype=float) + dt * late


def keep_rows(groups, share, rng):
    """Rows that are left after a share of them was lost at random, (m,)."""
    groups = np.asarray(groups)
    lost = rng.random(groups.size) < share
    edge = np.r_[True, np.diff(groups) != 0]
    lost[edge | np.r_[edge[1:], True]] = False
    # A row after one that was drawn to be lost comes back.
    lost[1:] &= ~lost[:-1]
    return np.flatnonzero(~lost)
