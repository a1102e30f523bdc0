"""Wrong channels: how often they are noticed, and sound ones called wrong.

Run ``python tests/benchmarks/bench_channel_faults.py [--data-home FOLDER] [--cases N]
[--sound N] [--write]``. Sound recordings: the ten measured sets, whole, each recording
alone, and halves of each; simulated ones of several robots, lengths, rates, noise and
friction. Then one fault at a time is put into simulated recordings and into TX40, UR5
and Panda. A case counts as seen if an error or a doubt of the fault's own kind names
it, as "other" if some error or doubt does, else as missed; where the nominal model
cannot show the fault (see `visible`) nothing should be said.
"""

import time
import warnings
from collections import Counter
from importlib import resources

import _undeclared_robots as robots
import numpy as np
from _paper_robots import load_paper_robot
from _report import add_root_to_path, fixed, parser, publish, rst_table, rst_title

from sklearn_vbjfa import datasets
from sklearn_vbjfa.datasets import Recording, make_robot_recording
from sklearn_vbjfa.inspection import inspect_channels
from sklearn_vbjfa.model import is_prismatic, load_model

add_root_to_path()
from tests.inspection._channel_faults import FAULTS, visible  # noqa: E402

MEASURED = (
    "bam_xl330",
    "dfki_double_pendulum",
    "emps",
    "franka_panda",
    "kuka_kr300",
    "kuka_lbr_med7",
    "staubli_tx40",
    "tflex_1dof",
    "tiago",
    "ur5",
)
WITH_FAULTS = ("staubli_tx40", "ur5", "franka_panda")
# Stretches of a measured set that a fault is put into.
PIECES = 4
# Recordings below this length are not cut in halves.
SHORTEST = 1000
URDFS = ("demo_arm", "arm", "head", "kr300_nominal")
GRAVE = {"error", "doubt"}


def _described(name):
    """Return the model of a robot by name."""
    if name in ("arm", "head"):
        return load_paper_robot(name)
    folder = resources.files("sklearn_vbjfa.datasets").joinpath("robots")
    return load_model(str(folder.joinpath(f"{name}.urdf")))


def simulated(seed):
    """One sound recording: nominal model, positions, torques, sample period."""
    rng = np.random.default_rng([seed, 77])
    which = seed % (len(URDFS) + 3)
    if which < len(URDFS):
        model = _described(URDFS[which])
    else:
        model = robots.nominal_robot(("serial", "prismatic", "tree")[which - 4], rng)
        for _ in range(50):
            q = rng.uniform(-1, 1, size=(50, model.nv))
            if robots.feels_gravity(model, q):
                break
            model = robots.nominal_robot(
                ("serial", "prismatic", "tree")[which - 4], rng
            )
    friction = [
        ("viscous", "coulomb"),
        ("viscous", "coulomb", "offset", "rotor_inertia"),
        ("viscous",),
    ][int(rng.integers(3))]
    recording = make_robot_recording(
        model,
        duration=float(rng.uniform(8, 25)),
        dt=float(rng.choice([0.002, 0.004, 0.01])),
        frequency=float(rng.uniform(0.3, 1.0)),
        encoder_noise=float(10 ** rng.uniform(-5, -3.5)),
        torque_noise=float(10 ** rng.uniform(-2, -0.8)),
        perturbation=float(rng.uniform(0.1, 0.4)),
        friction=friction,
        random_state=seed,
    )
    return model, recording.q, recording.tau, recording.dt


def inspect(model, q, tau, dt, groups=None):
    """Errors and doubts only."""
    found = inspect_channels(model, q, tau, dt, groups)
    return [finding for finding in found if finding.severity in GRAVE]


# -- sound recordings ------------------------------------------------------------------


def load(name, data_home):
    """One measured set."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return getattr(datasets, f"fetch_{name}")(data_home=data_home)


def parts_of(recording: Recording):
    """Whole, each recording, halves: label, rows and groups."""
    yield "whole", slice(None), recording.groups
    for label, name in enumerate(recording.group_names):
        rows = np.flatnonzero(recording.groups == label)
        if len(recording.group_names) > 1:
            yield name, rows, None
        if rows.size >= SHORTEST:
            middle = rows.size // 2
            yield f"{name}, first half", rows[:middle], None
            yield f"{name}, second half", rows[middle:], None


def measured_alarms(data_home, names=MEASURED):
    """Rows (set, part, joints, finding) and the number of parts looked at."""
    rows, count = [], 0
    for name in names:
        recording = load(name, data_home)
        model = recording.robot_model()
        for part, at, groups in parts_of(recording):
            count += 1
            rows += [
                (name, part, ", ".join(str(j + 1) for j in f.joints), f)
                for f in inspect(
                    model, recording.q[at], recording.tau[at], recording.dt, groups
                )
            ]
    return rows, count


def simulated_alarms(seeds):
    """Rows (seed, finding) of sound simulated recordings."""
    return [(seed, f) for seed in seeds for f in inspect(*simulated(seed))]


# -- faults ----------------------------------------------------------------------------


def judge(model, q, tau, dt, fault, seed):
    """Put one fault in: "seen", "other", "missed", "silent" or "alarm"."""
    rng = np.random.default_rng([seed, 5])
    revolute = np.flatnonzero(~is_prismatic(model))
    joints = revolute if fault.revolute else np.arange(model.nv)
    whole = fault.put.__name__ in ("degrees", "counts_of_all")
    if (
        joints.size == 0
        or (model.nv == 1 and "order" in fault.put.__name__)
        or (whole and revolute.size < model.nv)
    ):
        return None
    j = int(rng.choice(joints))
    state = rng.bit_generator.state
    can = visible(model, fault, q, tau, dt, j, rng)
    rng.bit_generator.state = state
    wrong = fault.put(q, tau, dt, j, rng)
    kinds = {finding.kind for finding in inspect(model, *wrong)}
    # What is named is seen, whatever was thought to be visible.
    if kinds & fault.kinds:
        return "seen"
    if not can:
        return "alarm" if kinds else "silent"
    return "other" if kinds else "missed"


def study(cases, faults=FAULTS, first=1000):
    """Count verdicts by fault in simulated recordings, at least `cases` visible."""
    counts = {name: Counter() for name in faults}
    for name, fault in faults.items():
        seed = first
        while (
            sum(counts[name][v] for v in VISIBLE) < cases and seed < first + 4 * cases
        ):
            verdict = judge(*simulated(seed), fault, seed)
            counts[name][verdict] += 1
            seed += 1
    return counts


VISIBLE = ("seen", "other", "missed")


def pieces(recording, n, longest=4000, seconds=4.0):
    """Cut stretches of equal length, with some motion, out of a measured set."""
    longest = max(longest, round(seconds / recording.dt))
    longest = min(longest, recording.n_samples // 2)
    whole = [np.flatnonzero(recording.groups == k) for k in set(recording.groups)]
    whole = [rows for rows in whole if rows.size >= 500]
    share = np.linspace(0, 1, -(-n // len(whole)))
    cut = []
    for x in share:
        for rows in whole:
            size = min(longest, rows.size)
            start = int(x * (rows.size - size))
            cut.append(rows[start : start + size])
    return cut[:n]


def measured_study(data_home, cases, faults=FAULTS, names=WITH_FAULTS):
    """Count verdicts by set and fault in measured recordings."""
    counts = {}
    for name in names:
        recording = load(name, data_home)
        model = recording.robot_model()
        for label, fault in faults.items():
            count = counts[name, label] = Counter()
            for seed, rows in enumerate(pieces(recording, cases)):
                q, tau = recording.q[rows], recording.tau[rows]
                count[judge(model, q, tau, recording.dt, fault, seed)] += 1
    return counts


# -- report ----------------------------------------------------------------------------


def _cells(count):
    visible_ = sum(count[v] for v in VISIBLE)
    hidden = count["silent"] + count["alarm"]
    return [
        visible_,
        *(count[v] for v in VISIBLE),
        hidden if hidden else "–",
        count["silent"] if hidden else "–",
    ]


HEADERS = ["fault", "visible", "seen", "other", "missed", "not visible", "silent"]


def report(data_home, cases, sound):
    """Text of the whole benchmark."""
    lines = []
    began = time.perf_counter()
    if data_home is not None:
        rows, count = measured_alarms(data_home)
        lines += [
            rst_title("Sound recordings"),
            "",
            f"Measured sets: errors and doubts in {len({r[:2] for r in rows})} of "
            f"{count} whole recordings and parts.",
            "",
        ]
        if rows:
            table = [[a, b, c, f.kind, f.severity] for a, b, c, f in rows]
            lines += [
                rst_table(table, ["set", "part", "joints", "kind", "severity"], 5),
                "",
            ]
    alarms = simulated_alarms(range(sound))
    wrong = sorted({seed for seed, _ in alarms})
    share = fixed([100 * len(wrong) / max(sound, 1)])[0]
    lines += [f"Simulated: {len(wrong)} of {sound} ({share} %).", ""]
    if alarms:
        kinds = Counter(f.kind for _, f in alarms)
        lines += [
            "By kind: " + ", ".join(f"{k} {n}" for k, n in kinds.items()) + ".",
            "",
        ]
    lines += [rst_title("Simulated robots"), ""]
    counts = study(cases)
    lines += [rst_table([[k, *_cells(c)] for k, c in counts.items()], HEADERS), ""]
    if data_home is not None:
        measured = measured_study(data_home, PIECES)
        for name in WITH_FAULTS:
            own = [[k, *_cells(c)] for (s, k), c in measured.items() if s == name]
            lines += [rst_title(name), "", rst_table(own, HEADERS), ""]
    print(f"{time.perf_counter() - began:.0f} s")
    return "\n".join(lines)


def main():
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--data-home", help="folder of the measured sets")
    arguments.add_argument("--cases", type=int, default=20, help="cases of a fault")
    arguments.add_argument("--sound", type=int, default=210, help="sound recordings")
    chosen = arguments.parse_args()
    publish(
        "channel_faults",
        report(chosen.data_home, chosen.cases, chosen.sound),
        write=chosen.write,
        command="python tests/benchmarks/bench_channel_faults.py --data-home FOLDER",
    )


if __name__ == "__main__":
    main()
