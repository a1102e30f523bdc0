"""Many generated robots and recordings, with and without faulty channels.

The same faults are put into measured recordings if these are available.
"""

import numpy as np
import pytest
from _undeclared import simulate

from sklearn_vbjfa import datasets
from sklearn_vbjfa.datasets import make_robot_recording
from sklearn_vbjfa.inspection import inspect_channels
from sklearn_vbjfa.model import is_prismatic
from tests._quick import checkered, one_in
from tests.model._robots import random_tree

CASES = 4
MEASURED = ("staubli_tx40", "ur5", "franka_panda")


def of(channels, j, values):
    """Return a copy of channels (n, nv) with one column replaced."""
    channels = channels.copy()
    channels[:, j] = values
    return channels


def held(x, k):
    """Repeat every k-th row k times."""
    return x[k * (np.arange(len(x)) // k)]


def frozen(q, tau, dt, j, rng):
    """Repeat one row for 0.3 s (at most 5 % of the recording), in three places."""
    q, tau = q.copy(), tau.copy()
    n = max(8, min(round(0.3 / dt), len(q) // 20))
    for share in (0.25, 0.5, 0.7):
        start = int(share * len(q))
        q[start : start + n], tau[start : start + n] = q[start], tau[start]
    return q, tau, dt


def wrapped(q, tau, dt, j, rng):
    """Wrap one position at an angle within the motion."""
    x = q[:, j]
    return of(q, j, np.where(x > np.median(x), x - 2 * np.pi, x)), tau, dt


def rolled(q, tau, dt, j, rng, positions=True):
    """Shift the columns of joints, or of torques only, cyclically."""
    shift = int(rng.integers(1, q.shape[1]))
    tau = np.roll(tau, shift, axis=1)
    return (np.roll(q, shift, axis=1) if positions else q), tau, dt


def counts(q, rng):
    """Positions in encoder counts."""
    return np.round(q * rng.choice((4096, 20000, 2**17)) / (2 * np.pi))


def shuffled(q, tau, dt, j, rng):
    """Rows in random order."""
    order = rng.permutation(len(q))
    return q[order], tau[order], dt


def thinned(q, tau, dt, j, rng):
    """Leave out rows at random."""
    kept = rng.uniform(size=len(q)) > rng.uniform(0.01, 0.08)
    return q[kept], tau[kept], dt


# Faults visible without the robot description: expected kinds of findings, and a
# function of positions, torques, sample period, joint and generator.
SAMPLES = {
    "wrapped angle": ("wrapped_position", wrapped),
    "frozen logger": ("repeated_rows", frozen),
    "missing rows": ("missing_rows", thinned),
    "positions held": ("held_position", lambda q, tau, dt, j, rng: (
        held(q, int(rng.integers(3, 9))), tau, dt)),
    "torques held": ("held_torque", lambda q, tau, dt, j, rng: (
        q, held(tau, int(rng.integers(3, 9))), dt)),
    "degrees": ("position_degrees", lambda q, tau, dt, j, rng: (
        np.rad2deg(q), tau, dt)),
    "counts of one": ("position_counts", lambda q, tau, dt, j, rng: (
        of(q, j, counts(q[:, j], rng)), tau, dt)),
    "counts of all": ("position_counts", lambda q, tau, dt, j, rng: (
        counts(q, rng), tau, dt)),
    "dt in ms": ("wrong_dt", lambda q, tau, dt, j, rng: (q, tau, 1e3 * dt)),
    "rate as dt": ("wrong_dt", lambda q, tau, dt, j, rng: (q, tau, 1 / dt)),
    "dt a thousandth": ("wrong_dt", lambda q, tau, dt, j, rng: (q, tau, 1e-3 * dt)),
    "shuffled rows": ("shuffled_rows", shuffled),
    "rows of two robots": ("shuffled_rows", lambda q, tau, dt, j, rng: (
        np.hstack([q, q[::-1]]).reshape(-1, q.shape[1]), np.repeat(tau, 2, 0), dt)),
}  # fmt: skip
# Faults found by comparison with the description, at least in half of the cases.
ORDER = "swapped_joints swapped_positions swapped_torques"
DESCRIBED = {
    "motor side": ("gear_factor", lambda q, tau, dt, j, rng: (
        q, of(tau, j, tau[:, j] / rng.uniform(50, 160)), dt)),
    "N mm": ("torque_unit", lambda q, tau, dt, j, rng: (q, 1e3 * tau, dt)),
    "one sign": ("torque_sign", lambda q, tau, dt, j, rng: (
        q, of(tau, j, -tau[:, j]), dt)),
    "both signs": ("flipped_joint", lambda q, tau, dt, j, rng: (
        of(q, j, -q[:, j]), of(tau, j, -tau[:, j]), dt)),
    "reverse order": (ORDER, lambda q, tau, dt, j, rng: (
        q[:, ::-1].copy(), tau[:, ::-1].copy(), dt)),
    "cyclic order": (ORDER, rolled),
    "torques in cyclic order": (ORDER, lambda *args: rolled(*args, positions=False)),
    # A zero offset of the first joint is equivalent to a rotated base.
    "quarter turn": ("position_zero base_orientation", lambda q, tau, dt, j, rng: (
        of(q, j, q[:, j] + rng.choice([-1, 1]) * np.pi / 2), tau, dt)),
    "dt off by ten": ("wrong_dt", lambda q, tau, dt, j, rng: (
        q, tau, dt * float(rng.choice([0.1, 10.0])))),
}  # fmt: skip
FAULTS = SAMPLES | DESCRIBED
OF_ANGLES = ("wrapped angle", "degrees", "counts of one", "counts of all")


def chain(rng, axes):
    """Build an arm whose links extend from joint to joint."""
    import pinocchio as pin

    model = pin.Model()
    for j, axis in enumerate(axes):
        joint = getattr(pin, f"JointModel{axis}")()
        shift = np.array([0.0, 0.0, 0.3]) + 0.05 * rng.normal(size=3)
        joint_id = model.addJoint(j, joint, pin.SE3(np.eye(3), shift), f"joint_{j}")
        link = pin.Inertia.FromBox(4.0 / (1 + j), 0.08, 0.1, 0.3)
        placement = pin.SE3(np.eye(3), np.array([0.02, 0.03, 0.15]))
        model.appendBodyToJoint(joint_id, link, placement)
    return model


def robot(seed):
    """Generate a small robot and a recording of it without faults."""
    rng = np.random.default_rng([seed, 12])
    if seed % 2:
        axes = [("RY", "RX", "RY"), ("RZ", "RY", "RX", "RY")][seed % 4 // 2]
        model = chain(rng, axes)
    else:
        model, _ = random_tree(rng, 2 + seed % 3, ("RX", "RY", "RZ", "PZ"))
    recording = make_robot_recording(
        model,
        duration=float(rng.uniform(6, 10)),
        dt=float(rng.choice([0.005, 0.01])),
        frequency=float(rng.uniform(0.6, 1.2)),
        encoder_noise=float(10 ** rng.uniform(-5, -4)),
        torque_noise=float(rng.uniform(0.01, 0.1)),
        random_state=seed,
    )
    return model, recording.q, recording.tau, recording.dt


def put(name, log, seed):
    """Put a fault into a log (model, q, tau, dt); None if it does not apply."""
    model, *channels = log
    rng, turns = np.random.default_rng([seed, 13]), np.flatnonzero(~is_prismatic(model))
    if name in OF_ANGLES and turns.size < model.nv:
        return None
    return model, *FAULTS[name][1](*channels, int(rng.choice(turns)), rng)


def graves(model, q, tau, dt, groups=None):
    """Check the form of the findings; return kinds of those that are not notes."""
    findings = inspect_channels(model, q, tau, dt, groups)
    order = ["error", "warning", "note"]
    ranks = [order.index(finding.severity) for finding in findings]
    assert ranks == sorted(ranks)
    for finding in findings:
        assert "\n" not in finding.message
        assert len(finding.message) > 40
        assert finding.joints
        assert set(finding.joints) <= set(range(model.nv))
    return {x.kind for x in findings if x.severity != "note"}


@pytest.mark.parametrize("name", one_in(5, FAULTS))
def test_each_fault_is_reported_for_generated_robots(name):
    kinds = set(FAULTS[name][0].split())
    logs = [put(name, robot(seed), seed) for seed in range(CASES)]
    kinds_by_log = [graves(*log) for log in logs if log is not None]
    n_correct = sum(bool(kinds & x) for x in kinds_by_log)
    if name in SAMPLES:
        assert kinds_by_log
        assert all(kinds_by_log)
        assert n_correct >= len(kinds_by_log) - 1
    else:
        # Zeros of some joints are not observable.
        assert n_correct >= (1 if name == "quarter turn" else CASES / 2)


@pytest.mark.parametrize("seed", one_in(3, range(15)))
def test_generated_recordings_without_fault_have_no_findings(seed):
    assert not graves(*robot(100 + seed))


@pytest.mark.parametrize("seed", one_in(3, range(30)))
def test_two_faults_of_one_recording_are_reported(seed):
    log = robot(200 + seed)
    names = np.random.default_rng([seed, 14]).choice(list(FAULTS), 2, replace=False)
    for name in names:
        log = put(name, log, seed) or log
    kinds = graves(*log)
    if set(names) & (set(SAMPLES) - set(OF_ANGLES)):
        assert kinds, names


@pytest.mark.parametrize(
    ("name", "seed"), checkered(["frozen logger", "positions held"], range(3))
)
def test_a_fault_in_one_of_two_recordings_is_reported(name, seed):
    model, q, tau, dt = robot(401 + seed)
    _, wrong_q, wrong_tau, _ = put(name, (model, q, tau, dt), seed)
    q, tau = np.vstack([q, wrong_q]), np.vstack([tau, wrong_tau])
    groups = np.repeat([0, 1], len(wrong_q))
    assert FAULTS[name][0] in graves(model, q, tau, dt, groups)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:The robot description")
@pytest.mark.parametrize("name", MEASURED)
def test_faults_in_measured_recordings_are_reported(measured_data_home, name):
    recording = getattr(datasets, f"fetch_{name}")(
        data_home=measured_data_home, download_if_missing=False
    )
    # At least 4 s of motion.
    count = max(4000, round(4.0 / recording.dt))
    rows = np.flatnonzero(recording.groups == 0)[:count]
    log = recording.robot_model(), recording.q[rows], recording.tau[rows], recording.dt
    for label in SAMPLES:
        assert graves(*put(label, log, 3)), label


@pytest.mark.parametrize(
    ("effects", "seed"),
    [
        ({"payload": 2.734042, "backlash": 5.665245}, (482, 1, 15)),
        ({"jerk": 6.0}, (485, 0, 18)),
        ({"torque_filter": 1.971459, "jerk": 2.16456, "drift": 1.71942}, (482, 2, 19)),
        ({"counterbalance": 5.021482, "elastic": 4.181096}, (499, 1, 10)),
    ],
)
def test_unmodelled_torque_is_no_fault(effects, seed):
    log = simulate([*effects], size=[*effects.values()], seed=seed)
    findings = inspect_channels(log.model, log.q, log.tau, log.dt)
    assert [x for x in findings if x.severity == "error"] == []
