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
(and lags) are of that kind, and a factor or a lag is right; *undecided*: another kind,
with that one named as less than 19 times less probable; *silent*: there are none;
*wrong*: there are others. With ``--data-home`` the same is done to measured robots, a
minute of each, and all measured sets are inspected, whole and in halves.

Seeds 0 to 99 are for work, from 1000 on to confirm.
"""

import warnings

import numpy as np
from _report import parser, publish, rst_table, run_study

KEYS = ("set", "seed", "what")
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
# Measured robots to which things are done, and rows of each at most.
DONE_TO, ROWS = "ur5 franka_panda staubli_tx40 kuka_lbr_med7".split(), 12_000
VISIBLE = 3.0
OTHERS = ("undecided", "silent", "wrong")
TO_MEASURED = f"The same done to measured robots ({', '.join(DONE_TO)}), twice each:"


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


def real(model, inertial):
    """Return the robot with its true bodies (nv, 10) in place of the described ones."""
    import pinocchio as pin

    model = model.copy()
    for joint, row in enumerate(inertial, start=1):
        model.inertias[joint] = pin.Inertia.FromDynamicParameters(row)
    return model


# -- what is done ----------------------------------------------------------------------


def negative(n, rng):
    return np.where(np.arange(n) == rng.integers(n), -1.0, 1.0)


def exchanged(n, rng):
    """Order (n,) in which two are exchanged."""
    order, pair = np.arange(n), rng.choice(n, 2, replace=False)
    order[pair] = order[pair[::-1]]
    return order


def of_one(n, rng, value, others):
    """Values (n,) of which one is another."""
    return np.where(np.arange(n) == rng.integers(n), value, others)


def turned(model, q, rng):
    """Torques by which the weight is another one on a base that is turned."""
    down = rng.normal(size=3) + [0, 0, 0.5]
    return weight_of(model, q, 9.81 * down / np.linalg.norm(down)) - weight_of(model, q)


def pushed(tau, dt, rng):
    """Torques with those of a contact of some seconds."""
    begin, rows = int(rng.uniform(0.2, 0.6) * len(tau)), round(rng.uniform(2, 4) / dt)
    tau = tau.copy()
    tau[begin : begin + rows] += rng.uniform(1.0, 3.0) * tau.std(axis=0)
    return tau


def silenced(tau, rng):
    """Torques of which one is noise."""
    tau, j = tau.copy(), rng.integers(tau.shape[1])
    tau[:, j] = rng.normal(0, 0.02 * tau[:, j].std(), len(tau))
    return tau


def drawn(low, high, rng, size=None):
    """Factors that are even in their logarithm."""
    return np.exp(rng.uniform(np.log(low), np.log(high), size))


ORDERS = "swapped_joints swapped_torques swapped_positions"
STATIC = "gravity_only constant_torque computed_torque"
# name: kinds of findings that name it, and a function of model (of the real bodies
# where the base is turned), q, tau, dt, the number of joints and a generator to
# positions, torques, sample period and strength
DONE = {
    "larger": ("torque_unit", lambda m, q, y, dt, n, r: (
        q, (f := drawn(3.5, 60, r)) * y, dt, f)),
    "smaller": ("torque_unit", lambda m, q, y, dt, n, r: (
        q, (f := 1 / drawn(3.5, 60, r)) * y, dt, f)),
    "currents": ("torque_factors torque_unit gear_factor", lambda m, q, y, dt, n, r: (
        q, y / drawn(2, 100, r, n), dt, None)),
    "motor side": ("gear_factor silent_torque", lambda m, q, y, dt, n, r: (
        q, y / of_one(n, r, drawn(40, 160, r), 1), dt, None)),
    "without weight": ("no_gravity", lambda m, q, y, dt, n, r: (
        q, y - weight_of(m, q), dt, None)),
    "weight alone": (STATIC, lambda m, q, y, dt, n, r: (q, weight_of(m, q), dt, None)),
    "base turned": ("base_orientation", lambda m, q, y, dt, n, r: (
        q, y + turned(m, q, r), dt, None)),
    "turns": ("position_turns", lambda m, q, y, dt, n, r: (
        q / (2 * np.pi), y, dt, None)),
    "degrees": ("position_degrees position_counts", lambda m, q, y, dt, n, r: (
        np.rad2deg(q), y, dt, None)),
    "late": ("delay", lambda m, q, y, dt, n, r: (
        q[(k := max(1, round(r.uniform(0.005, 0.06) / dt))) :], y[:-k], dt, k * dt)),
    "zeros at power-up": ("position_zeros position_zero", lambda m, q, y, dt, n, r: (
        q - q[0], y, dt, None)),
    "one sign": ("torque_sign", lambda m, q, y, dt, n, r: (
        q, negative(n, r) * y, dt, None)),
    "all signs": ("torque_sign", lambda m, q, y, dt, n, r: (q, -y, dt, None)),
    "mirrored": ("position_sign", lambda m, q, y, dt, n, r: (
        negative(n, r) * q, y, dt, None)),
    "flipped": ("flipped_joint", lambda m, q, y, dt, n, r: (
        (x := negative(n, r)) * q, x * y, dt, None)),
    "torques swapped": (ORDERS, lambda m, q, y, dt, n, r: (
        q, y[:, exchanged(n, r)], dt, None)),
    "positions swapped": (ORDERS, lambda m, q, y, dt, n, r: (
        q[:, exchanged(n, r)], y, dt, None)),
    "another order": (ORDERS, lambda m, q, y, dt, n, r: (
        q[:, (o := r.permutation(n))], y[:, o], dt, None)),
    "one zero": ("position_zero", lambda m, q, y, dt, n, r: (
        q + of_one(n, r, r.choice([-1, 1]) * r.uniform(0.8, 3.1), 0), y, dt, None)),
    "period": ("wrong_dt", lambda m, q, y, dt, n, r: (
        q, y, dt * r.choice([0.1, 10.0, 1e3, 1e-3]), None)),
    "contact": ("external_force", lambda m, q, y, dt, n, r: (
        q, pushed(y, dt, r), dt, None)),
    "noise": ("silent_torque gear_factor", lambda m, q, y, dt, n, r: (
        q, silenced(y, r), dt, None)),
}  # fmt: skip


# -- one log ---------------------------------------------------------------------------


def simulated(seed):
    """Draw kind and model of a robot, and a recording of it."""
    from sklearn_vbjfa.datasets import make_robot_recording

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
    return kind, made.robot_model() if model is None else model, made


def run(task):
    from sklearn_vbjfa.inspection import inspect_channels

    seed, what, name = task["seed"], task["what"], task["set"]
    if name:
        made = fetched(name, task["data_home"])
        kind, model = name, made.robot_model()
        made = made.select(0)
    else:
        kind, model, made = simulated(seed)
    q, tau, dt = made.q[:ROWS], made.tau[:ROWS], made.dt
    names, strength = "", None
    if what:
        names, function = DONE[what]
        known = model.nv, np.random.default_rng([seed, 49])
        turns = what == "base turned" and not name
        used = real(model, made.inertial) if turns else model
        q, tau, dt, strength = function(used, q, tau, dt, *known)
    found = inspect_channels(model, q, tau, dt)
    # Measured torques may be late themselves.
    late = what == "late" or not name
    grave = [x for x in found if x.severity != "note" or (late and x.kind == "delay")]
    kinds = {x.kind for x in grave}
    right = bool(kinds) and kinds <= set(names.split())
    if right and what == "late" and not name:
        right = abs(grave[0].value - strength) < 0.002 + 0.1 * strength
    if right and what in ("larger", "smaller"):
        right = abs(np.log(grave[0].value / strength)) < np.log(1.6)
    outcome = "right" if right else "wrong" if kinds else "silent"
    undecided = [{x.kind, *x.rivals} & set(names.split()) for x in grave]
    if outcome == "wrong" and all(undecided):
        outcome = "undecided"
    odds = shown(model, (made.q[:ROWS], made.tau[:ROWS], made.dt), (q, tau, dt))
    return {
        **{key: task[key] for key in KEYS},
        "robot": kind,
        "outcome": outcome,
        "kinds": sorted(kinds),
        "log_odds": odds,
    }


def shown(model, sound, wrong):
    """Log odds of the sound log against the one that was made of it."""
    from sklearn_vbjfa.inspection import Reading
    from sklearn_vbjfa.model import joint_names, load_folded

    scores = []
    for q, tau, dt in (sound, wrong):
        whole = [slice(0, len(q))], np.ones(q.shape, dtype=bool)
        reading = Reading(load_folded(model), joint_names(model), q, tau, dt, *whole)
        if reading.is_uninformative():
            return np.inf
        scores.append(reading.robot.baseline.evidence)
    return float(scores[0] - scores[1] - np.log(100.0))


def fetched(name, data_home):
    from sklearn_vbjfa import datasets

    fetch = getattr(datasets, f"fetch_{name}")
    return fetch(data_home=data_home, download_if_missing=False)


def measured(data_home):
    """Tabulate findings that forbid a use in measured sets, whole and in halves."""
    from sklearn_vbjfa.inspection import inspect_channels

    rows = []
    for name in MEASURED:
        one = fetched(name, data_home)
        half, cells = len(one.q) // 2, [name]
        for part in (slice(None), slice(None, half), slice(half, None)):
            known = one.q[part], one.tau[part], one.dt, one.groups[part]
            found = inspect_channels(one.robot_model(), *known)
            if any(unit not in ("N m", "N", "") for unit in one.torque_units):
                found = [x for x in found if x.kind != "torque_unit"]
            cells.append(", ".join(x.kind for x in found if x.severity != "note"))
        rows.append([cells[0], *(cell or "none" for cell in cells[1:])])
    return rst_table(rows, ["set", "whole", "first half", "second half"], n_labels=4)


def report(results):
    rows = []
    for what in ["", *DONE]:
        own = [r for r in results if r["what"] == what]
        if not own:
            continue
        seen = [r for r in own if r["log_odds"] > VISIBLE or not what]
        counts = [sum(r["outcome"] == x for r in own) for x in OTHERS]
        visible = sum(r["outcome"] == "right" for r in seen)
        cells = ["–", "–"] if not what else [str(len(seen)), str(visible)]
        rows.append([what or "sound", str(len(own)), *cells, *map(str, counts)])
    heads = ["what was done", "logs", "visible", "of these right", *OTHERS]
    return rst_table(rows, heads)


def main(argv=None):
    arguments = parser(__doc__, data=True, out=True, seeds=(0, 99)).parse_args(argv)
    first, last = arguments.seeds
    if arguments.quick:
        last = first + 1
    names, tasks = list(DONE), []
    for seed in range(first, last + 1):
        own = names[2 * seed % len(DONE)], names[(2 * seed + 1) % len(DONE)]
        tasks += [{"set": "", "seed": seed, "what": what} for what in ("", *own)]
    home = arguments.data_home
    done_to = [
        {"set": name, "seed": seed, "what": what, "data_home": home}
        for name in DONE_TO * bool(home)
        for seed in (first, last)
        for what in DONE
        if what != "base turned"
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        ledger = run_study(run, tasks + done_to, KEYS, out=arguments.out)
        text = report(ledger.of(tasks))
        if home:
            parts = text, TO_MEASURED, report(ledger.of(done_to)), measured(home)
            text = "\n\n".join(parts)
    publish(
        "log_hypotheses",
        text,
        arguments,
        command=f"log_hypotheses.py --seeds {first} {last}",
        commits=ledger.commits(tasks),
    )


if __name__ == "__main__":
    main()
