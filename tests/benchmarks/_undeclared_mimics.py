"""How much of one undeclared effect the columns of another can take over.

The columns are textbook forms, searched over coarse grids of their shapes, with the
true states: what two effects share here no method can tell apart.
"""

import numpy as np
from _undeclared_hysteresis import lugre, pieces, play


def _by_recording(function, groups, *signals):
    parts = [function(*(x[rows] for x in signals)) for rows in pieces(groups)]
    return np.concatenate(parts)


def columns_of(recording, joint):
    """Columns of each effect on a joint, one list for every shape on its grid.

    Parameters
    ----------
    recording : UndeclaredRecording
        Recording with its true states.
    joint : int
        Joint.

    Returns
    -------
    dict of str to list of list of ndarray of shape (n,)
        Columns; positions and speeds in radians.
    """
    unit, groups, t = recording.unit, recording.groups, recording.t
    q, v, a = (x / unit for x in np.split(recording.states, 3, axis=1))
    x, w = q[:, joint], v[:, joint]
    steep = np.tanh(v / 0.01)
    s, one = steep[:, joint], np.ones(t.size)
    rigid = recording.tau_clean - sum(recording.contributions, np.zeros(q.shape))
    shapes = {"viscous": unit * v, "coulomb": steep}
    for name, level in recording.friction.items():
        rigid = rigid - level * shapes[name]
    load, whole = rigid[:, joint], recording.tau_clean[:, joint]

    def slope(signal):
        return _by_recording(lambda y: np.gradient(y, recording.dt), groups, signal)

    def bristles(z):
        settings = {"displacement": z, "lag": 0.0, "rise": 0.0, "speed": 0.1}
        return _by_recording(lambda y: lugre(y, recording.dt, **settings), groups, w)

    def follower(width):
        return _by_recording(lambda y: play(y, width), groups, x)

    def rippled(degrees):
        angle = 360.0 / degrees * x
        return [np.cos(angle), np.sin(angle)]

    partners = [k for k in range(unit.size) if abs(k - joint) == 1]
    return {
        "coulomb": [[s]],
        "asymmetric_friction": [[np.abs(w), np.abs(s)]],
        "stribeck": [
            [np.exp(-(np.abs(w / vs) ** k)) * s]
            for vs in (0.1, 0.15, 0.2, 0.3, 0.4)
            for k in (1, 2)
        ],
        "viscous_quadratic": [[w * np.abs(w)]],
        "load_friction": [[np.abs(load) * s]],
        "presliding": [[bristles(z)] for z in (0.005, 0.01, 0.02, 0.03, 0.05)],
        "backlash": [[follower(width), one] for width in (0.1, 0.2, 0.3, 0.4, 0.5)],
        "offset": [[one]],
        "spring": [[x, one]],
        "counterbalance": [[f(k * x) for f in (np.cos, np.sin) for k in (1, 2)]],
        "ripple": [rippled(degrees) for degrees in np.geomspace(5.0, 40.0, 60)],
        "rotor_inertia": [[a[:, joint]]],
        "coupling": [
            [friction, v[:, k], a[:, k]]
            for k in partners
            for friction in (steep[:, k], np.tanh((w + v[:, k]) / 0.01))
        ],
        "drift": [[np.exp(-t / (f * t[-1])) * s] for f in (0.2, 0.35, 0.6, 1.0)],
        "elastic": [[slope(slope(load))]],
        "delay": [[slope(whole)]],
    }


def mimics(recording, index):
    """Share of what shows of an effect that each other effect explains.

    Parameters
    ----------
    recording : UndeclaredRecording
        Recording.
    index : int
        Entry of its truth.

    Returns
    -------
    dict of str to float
        For each effect the R squared of its columns, refitted with the declared ones,
        on the part of the torque outside the declared span.
    """
    span, torque = recording.span(), recording.contributions[index]
    joint = recording.truth[index].joint
    whole = span.share(torque)

    def explained(columns):
        others = []
        for column in columns:
            other = np.zeros(torque.shape)
            other[:, joint] = column
            others.append(other)
        return 1.0 - (span.share(torque, others) / whole) ** 2

    return {
        name: max(map(explained, shapes), default=0.0)
        for name, shapes in columns_of(recording, joint).items()
    }
