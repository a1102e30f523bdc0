"""What is said of logs to which one thing was done, and of sound ones.

Run ``python tests/benchmarks/bench_log_hypotheses.py --out FILE [--seeds FIRST LAST]
[--data-home FOLDER] [--write]``.

Data: simulated recordings of 10 to 20 s at 100 to 250 Hz of seven kinds of robots: the
arm of the package, a SCARA, a gantry with a wrist, a leg, two arms on one base, a
palletiser and an arm of seven joints, with sizes and masses drawn. The bodies of the
description are wrong by up to 30 %; friction is not described. Every seed makes one
sound log and two logs to which one thing was done, at a strength that is drawn.

A log is *visible* if the sound log has log odds above 3 against it, by the likelihood
of the inspection with its prior odds. *right*: the findings that are more than warnings
(and lags) are of that kind, and a factor or a lag is right; *silent*: there are none;
*wrong*: there are others. With ``--data-home`` the measured sets, whole and in halves.

Seeds 0 to 99 are for work, from 1000 on to confirm.
"""

import warnings

import numpy as np
from _report import parser, publish, rst_table, run_study

KEYS = ("seed", "what")
MEASURED = (
    "bam_xl330 dfki_double_pendulum emps franka_panda kuka_kr300 kuka_lbr_med7 "
    "staubli_tx40 tflex_1dof tiago unitree_go2 ur5"
).split()
ROBOTS = {
    "arm": None,
    "SCARA": ("RZ", "RZ", "PZ", "RZ"),
    "gantry": ("PX", "PY", "PZ", "RY"),
    "leg": ("RX", "RY", "RY"),
    "two arms": ("RY", "RX", "RY", "RX"),
    "palletiser": ("RZ", "RY", "RY", "RX", "RY"),
    "seven joints": ("RZ", "RY", "RZ", "RY", "RZ", "RY", "RZ"),
}
VISIBLE = 3.0


def robot(kind, rng):
    """Draw a robot of a kind, a Pinocchio model; None for that of the package."""
    import pinocchio as pin

    axes = ROBOTS[kind]
    if axes is None:
        return None
    model, size = pin.Model(), rng.uniform(0.5, 1.5)
    for j, axis in enumerate(axes):
        along = np.array([0, 0, 0.3]) if kind != "SCARA" else np.array([0.3, 0, 0])
        shift = size * (along + 0.05 * rng.normal(size=3))
        parent = 0 if kind == "two arms" and j == 2 else j
        joint = getattr(pin, f"JointModel{axis}")()
        place = pin.SE3(np.eye(3), shift)
        number = model.addJoint(parent, joint, place, f"joint_{j + 1}")
        mass = size**2 * rng.uniform(2, 8) / (1 + 0.7 * j)
        link = pin.Inertia.FromBox(mass, *(size * np.array([0.1, 0.08, 0.3])))
        centre = size * (0.5 * along + 0.03 * rng.normal(size=3))
        model.appendBodyToJoint(number, link, pin.SE3(np.eye(3), centre))
    return model


def weight_of(model, q, gravity=None):
    """Torques (n, nv) of the described weight, perhaps under another gravity."""
    import pinocchio as pin

    if gravity is not None:
        model = model.copy()
        model.gravity.linear = gravity
    data = model.createData()
    return np.array([pin.computeGeneralizedGravity(model, data, x).copy() for x in q])


# -- what is done: -> q, tau, dt, kinds that name it, strength -----------------------


def scaled(model, q, tau, dt, rng):
    factor = np.exp(rng.choice([-1, 1]) * rng.uniform(np.log(3.5), np.log(60)))
    return q, factor * tau, dt, "torque_unit", factor


def factors(model, q, tau, dt, rng):
    own = np.exp(rng.uniform(np.log(2), np.log(100), size=tau.shape[1]))
    return q, tau / own, dt, "torque_factors torque_unit gear_factor", None


def motor_side(model, q, tau, dt, rng):
    tau = tau.copy()
    tau[:, rng.integers(tau.shape[1])] /= rng.uniform(40, 160)
    return q, tau, dt, "gear_factor silent_torque", None


def without_weight(model, q, tau, dt, rng):
    return q, tau - weight_of(model, q), dt, "no_gravity", None


def weight_alone(model, q, tau, dt, rng):
    names = "gravity_only constant_torque computed_torque"
    return q, weight_of(model, q), dt, names, None


def turned(model, q, tau, dt, rng):
    down = rng.normal(size=3) + [0, 0, 0.5]
    down *= 9.81 / np.linalg.norm(down)
    other = weight_of(model, q, down) - weight_of(model, q)
    return q, tau + other, dt, "base_orientation", None


def turns(model, q, tau, dt, rng):
    return q / (2 * np.pi), tau, dt, "position_turns", None


def degrees(model, q, tau, dt, rng):
    return np.rad2deg(q), tau, dt, "position_degrees position_counts", None


def late(model, q, tau, dt, rng):
    k = max(1, round(rng.uniform(0.005, 0.06) / dt))
    return q[k:], tau[:-k], dt, "delay", k * dt


def power_up(model, q, tau, dt, rng):
    return q - q[0], tau, dt, "position_zeros position_zero", None


def one_sign(model, q, tau, dt, rng):
    sign = np.ones(tau.shape[1])
    sign[rng.integers(sign.size)] = -1
    return q, sign * tau, dt, "torque_sign", None


def all_signs(model, q, tau, dt, rng):
    return q, -tau, dt, "torque_sign", None


def mirrored(model, q, tau, dt, rng):
    sign = np.ones(tau.shape[1])
    sign[rng.integers(sign.size)] = -1
    return sign * q, tau, dt, "position_sign", None


def flipped(model, q, tau, dt, rng):
    sign = np.ones(tau.shape[1])
    sign[rng.integers(sign.size)] = -1
    return sign * q, sign * tau, dt, "flipped_joint", None


def _pair(n, rng):
    order = np.arange(n)
    pair = rng.choice(n, 2, replace=False)
    order[pair] = order[pair[::-1]]
    return order


def swapped_torques(model, q, tau, dt, rng):
    return q, tau[:, _pair(len(tau.T), rng)], dt, "swapped_torques swapped_joints", None


def swapped_positions(model, q, tau, dt, rng):
    order = _pair(len(tau.T), rng)
    return q[:, order], tau, dt, "swapped_positions swapped_joints", None


def order(model, q, tau, dt, rng):
    own = rng.permutation(len(tau.T))
    names = "swapped_joints swapped_torques swapped_positions"
    return q[:, own], tau[:, own], dt, names, None


def zero(model, q, tau, dt, rng):
    q = q.copy()
    q[:, rng.integers(q.shape[1])] += rng.choice([-1, 1]) * rng.uniform(0.8, 3.1)
    return q, tau, dt, "position_zero", None


def period(model, q, tau, dt, rng):
    return q, tau, dt * rng.choice([0.1, 10.0, 1e3, 1e-3]), "wrong_dt", None


def contact(model, q, tau, dt, rng):
    begin, rows = int(rng.uniform(0.2, 0.6) * len(q)), round(rng.uniform(2, 4) / dt)
    tau = tau.copy()
    tau[begin : begin + rows] += rng.uniform(1.0, 3.0) * tau.std(axis=0)
    return q, tau, dt, "external_force", None


def noise(model, q, tau, dt, rng):
    tau, j = tau.copy(), rng.integers(tau.shape[1])
    tau[:, j] = rng.normal(0, 0.02 * tau[:, j].std(), len(tau))
    return q, tau, dt, "silent_torque gear_factor", None


DONE = (
    *(scaled, factors, motor_side, without_weight, weight_alone, turned, turns),
    *(degrees, late, power_up, one_sign, all_signs, mirrored, flipped),
    *(swapped_torques, swapped_positions, order, zero, period, contact, noise),
)


# -- one log ---------------------------------------------------------------------------


def run(task):
    """Inspect one log."""
    from sklearn_vbjfa.datasets import make_robot_recording
    from sklearn_vbjfa.inspection import inspect_channels

    seed, what = task["seed"], task["what"]
    rng = np.random.default_rng([seed, 48])
    kind = list(ROBOTS)[seed % len(ROBOTS)]
    model = robot(kind, rng)
    made = make_robot_recording(
        *([] if model is None else [model]),
        duration=float(rng.uniform(10, 20)),
        dt=float(rng.choice([0.004, 0.01])),
        frequency=float(rng.uniform(0.4, 1.0)),
        torque_noise=float(rng.uniform(0.01, 0.1)),
        encoder_noise=float(10 ** rng.uniform(-5, -4)),
        perturbation=float(rng.uniform(0, 0.3)),
        random_state=seed,
    )
    model = made.robot_model() if model is None else model
    q, tau, dt, names, strength = made.q, made.tau, made.dt, "", None
    if what:
        function = {one.__name__: one for one in DONE}[what]
        rng = np.random.default_rng([seed, 49])
        q, tau, dt, names, strength = function(model, q, tau, dt, rng)
    found = inspect_channels(model, q, tau, dt)
    grave = [x for x in found if x.severity != "warning" or x.kind == "delay"]
    kinds = {x.kind for x in grave}
    right = bool(kinds) and kinds <= set(names.split())
    if right and what == "late":
        right = abs(grave[0].value - strength) < 0.002 + 0.1 * strength
    if right and what == "scaled":
        told = float(grave[0].message.split(" are ")[1].split()[0])
        right = abs(np.log(told / strength)) < np.log(1.6)
    outcome = "right" if right else "wrong" if kinds else "silent"
    odds = shown(model, (made.q, made.tau, made.dt), (q, tau, dt))
    return {
        **task,
        "robot": kind,
        "outcome": outcome,
        "kinds": sorted(kinds),
        "log_odds": odds,
    }


def shown(model, sound, wrong):
    """Log odds of the sound log against the one that was made of it."""
    from sklearn_vbjfa.inspection import Reading, score_of
    from sklearn_vbjfa.model import joint_names

    scores = []
    for q, tau, dt in (sound, wrong):
        whole = [slice(0, len(q))], np.ones(q.shape, dtype=bool)
        reading = Reading(model, joint_names(model), q, tau, dt, *whole)
        if reading.tell_nothing():
            return np.inf
        scores.append(score_of(reading.robot).evidence)
    return float(scores[0] - scores[1] - np.log(100.0))


def measured(data_home):
    """Tabulate findings that forbid a use in measured sets, whole and in halves."""
    from sklearn_vbjfa import datasets
    from sklearn_vbjfa.inspection import inspect_channels

    rows = []
    for name in MEASURED:
        fetch = getattr(datasets, f"fetch_{name}")
        one = fetch(data_home=data_home, download_if_missing=False)
        half, cells = len(one.q) // 2, [name]
        for part in (slice(None), slice(None, half), slice(half, None)):
            known = one.q[part], one.tau[part], one.dt, one.groups[part]
            found = inspect_channels(one.robot_model(), *known)
            if any(unit not in ("N m", "N", "") for unit in one.torque_units):
                found = [x for x in found if x.kind != "torque_unit"]
            cells.append(", ".join(x.kind for x in found if x.severity != "warning"))
        rows.append([cells[0], *(cell or "none" for cell in cells[1:])])
    return rst_table(rows, ["set", "whole", "first half", "second half"], n_labels=4)


def report(results):
    """Return the tables of a study."""
    rows = []
    for what in ["", *(one.__name__ for one in DONE)]:
        own = [r for r in results if r["what"] == what]
        seen = [r for r in own if r["log_odds"] > VISIBLE or not what]
        counts = [sum(r["outcome"] == x for r in own) for x in ("silent", "wrong")]
        visible = sum(r["outcome"] == "right" for r in seen)
        label = what.replace("_", " ") or "sound"
        cells = ["–", "–"] if not what else [str(len(seen)), str(visible)]
        rows.append([label, str(len(own)), *cells, *map(str, counts)])
    heads = ["what was done", "logs", "visible", "of these right", "silent", "wrong"]
    return rst_table(rows, heads)


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__, data=True, out=True, seeds=(0, 99)).parse_args(argv)
    first, last = arguments.seeds
    if arguments.quick:
        last = first + 1
    seeds, n = range(first, last + 1), len(DONE)
    tasks = [{"seed": seed, "what": ""} for seed in seeds]
    for seed in seeds:
        for k in (2 * seed % n, (2 * seed + 1) % n):
            tasks.append({"seed": seed, "what": DONE[k].__name__})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        ledger = run_study(run, tasks, KEYS, out=arguments.out)
        text = report(ledger.of(tasks))
        if arguments.data_home:
            text = f"{text}\n\n{measured(arguments.data_home)}"
    publish(
        "log_hypotheses",
        text,
        arguments,
        command=f"log_hypotheses.py --seeds {first} {last}",
        commits=ledger.commits(tasks),
    )


if __name__ == "__main__":
    main()
