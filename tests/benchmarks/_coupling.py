"""Why joint 5 of the TX40 cannot be predicted without a coupling column.

Motor 6 turns with q5 + q6 (a gear in the wrist), so its inertia and friction act on
the sum of both speeds and are felt by joint 5 too. No declared column has that form.
"""

from dataclasses import dataclass

import numpy as np

from sklearn_vbjfa._core import _lowpass
from sklearn_vbjfa.recording import contiguous_groups
from sklearn_vbjfa.robot import TorqueResiduals, joint_moments
from sklearn_vbjfa.robot._estimate import least_squares, noise_weights

FIFTH, SIXTH = 4, 5


@dataclass(frozen=True, kw_only=True)
class Equations:
    """Filtered equations of one part of the recording.

    Phi (m, nv, p), tau and weight (m, nv); coupling (m, nv, 6): the columns
    [a6, v6, sign(v5 + v6)] of joint 5 and [a5, v5, sign(v5 + v6)] of joint 6;
    states (n, 3 nv) as they were before the filter.
    """

    Phi: np.ndarray
    tau: np.ndarray
    weight: np.ndarray
    coupling: np.ndarray
    states: np.ndarray


def equations(identifier, part):
    """Build the equations of a part, filtered and masked as in the fit."""
    X, y, groups = part
    robot = identifier.robot_
    states = robot.query(X, groups)[0]
    nv = y.shape[1]
    v, a = states[:, nv : 2 * nv], states[:, 2 * nv :]
    columns = np.zeros((X.shape[0], nv, 6))
    both = np.sign(v[:, FIFTH] + v[:, SIXTH])
    columns[:, FIFTH, :3] = np.column_stack([a[:, SIXTH], v[:, SIXTH], both])
    columns[:, SIXTH, 3:] = np.column_stack([a[:, FIFTH], v[:, FIFTH], both])
    lowpass = _lowpass.design(identifier.dt, identifier.cutoff_)
    parts = contiguous_groups(groups, X.shape[0])
    made = robot.equations(robot.recording(X, y, groups, np.ones(y.shape)), states)
    coupling = np.concatenate([lowpass(columns[rows]) for rows in parts])
    return Equations(
        Phi=made.Phi,
        tau=made.tau,
        weight=made.weight,
        coupling=coupling,
        states=states,
    )


def weighted_least_squares(Phi, tau, weight):
    """Parameters by weighted least squares, joints weighted by their residuals."""
    stats = joint_moments(Phi, tau, weight)
    joint_weight = noise_weights(stats)
    gram = np.einsum("j,jik->ik", joint_weight, stats.G)
    return least_squares(gram, joint_weight @ stats.g)


def errors(Phi, theta, part):
    """Held-out error of every joint."""
    found = TorqueResiduals(
        index=np.arange(part.tau.shape[0]),
        torque=part.tau,
        predicted=Phi @ theta,
        weight=part.weight,
    )
    return found.normalised_error()


def _moving(part, joint, values):
    return values[part.weight[:, joint] > 0]


def friction_torque(part, theta, names, joint, per_joint):
    """Viscous and Coulomb torque of a joint that a parameter vector predicts."""
    columns = [joint * per_joint + 10 + names.index(k) for k in ("viscous", "coulomb")]
    return part.Phi[:, joint, columns] @ theta[columns]


def study(identifier, train_part, test_part):
    """Compute the numbers behind the text of the guide.

    Returns
    -------
    joints : dict of str to ndarray of shape (nv,)
        Error of every joint on the held-out part.
    values : dict of str to float
        Numbers of joint 5, each with its unit in the name.
    """
    train, test = equations(identifier, train_part), equations(identifier, test_part)
    nv = train.tau.shape[1]
    per_joint = train.Phi.shape[2] // nv
    names = list(identifier.friction)

    declared = weighted_least_squares(train.Phi, train.tau, train.weight)
    hindsight = weighted_least_squares(test.Phi, test.tau, test.weight)
    wide = np.concatenate([train.Phi, train.coupling], axis=2)
    coupled = weighted_least_squares(wide, train.tau, train.weight)
    wide_test = np.concatenate([test.Phi, test.coupling], axis=2)

    root = np.sqrt(test.weight[:, FIFTH])
    alone, *_ = np.linalg.lstsq(
        test.Phi[:, FIFTH] * root[:, None], test.tau[:, FIFTH] * root
    )
    p = train.Phi.shape[2]
    own = friction_torque(test, coupled[:p], names, FIFTH, per_joint)
    # the columns v6 and sign(v5 + v6) of joint 5
    shared = test.coupling[:, FIFTH, 1:3] @ coupled[p + 1 : p + 3]

    def size(part, torque):
        return float(np.mean(np.abs(_moving(part, FIFTH, torque))))

    def friction(part):
        return size(part, friction_torque(part, declared, names, FIFTH, per_joint))

    def spread(part):
        return float(np.std(_moving(part, FIFTH, part.tau[:, FIFTH])))

    def speeds(part):
        v5, v6 = part.states[:, nv + FIFTH], part.states[:, nv + SIXTH]
        moving = np.abs(v5) > identifier.standstill_[FIFTH]
        return v5[moving], v6[moving]

    def against(part):
        v5, v6 = speeds(part)
        return float(100 * np.mean(v5 * (v5 + v6) < 0))

    def moving_time(part):
        return speeds(part)[0].size * identifier.dt

    zero = np.zeros(test.Phi.shape[2])
    joints = {
        "nothing predicted (zero torque)": errors(test.Phi, zero, test),
        "declared columns, fitted to the first part": errors(test.Phi, declared, test),
        "declared columns, fitted to the held-out part": errors(
            test.Phi, hindsight, test
        ),
        "with the coupling columns, fitted to the first part": errors(
            wide_test, coupled, test
        ),
    }
    own_hindsight = errors(test.Phi, alone, test)[FIFTH]
    values = {
        "best in hindsight: declared columns, fitted to joint 5 of the held-out part "
        "alone: error [%]": 100 * own_hindsight,
        "time in motion, first part [s]": moving_time(train),
        "time in motion, held-out part [s]": moving_time(test),
        "v5 + v6 against v5, first part [% of the time in motion]": against(train),
        "v5 + v6 against v5, held-out part [% of the time in motion]": against(test),
        "standard deviation of the torque, first part [N m]": spread(train),
        "standard deviation of the torque, held-out part [N m]": spread(test),
        "friction by the declared columns, mean size, first part [N m]": friction(
            train
        ),
        "the same, held-out part [N m]": friction(test),
        "with the coupling columns, held-out part: own friction, mean size [N m]": size(
            test, own
        ),
        "friction on v5 + v6, mean size [N m]": size(test, shared),
        "their sum, mean size [N m]": size(test, own + shared),
    }
    return joints, values
