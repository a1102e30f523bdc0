"""Held-out torque error on the ten measured sets, method by method.

Run as ``python tests/benchmarks/bench_measured_robots.py --data-home DIR``; without
``--data-home`` the sets are downloaded to scikit-learn's data folder. Splits, filters,
masks and friction columns are those of the command line (``datasets/_protocols.py``).
"""

import sys
import time
import warnings

import numpy as np
from _coupling import study
from _report import fixed, parser, publish, rst_table, rst_title
from sklearn.base import clone
from sklearn.linear_model import LinearRegression

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.datasets import protocols
from sklearn_vbjfa.robot import OURS, compare_methods, methods

_SEED = 0
_RESAMPLES = 1000
_BLOCK = 1.0  # s
# With fewer blocks of motion there is no interval to speak of.
_FEWEST_BLOCKS = 5
_BOOTSTRAPPED = ("ur5", "staubli_tx40")
# Weighted least squares on the same split, filter and mask, done independently.
_REFERENCE_UR5 = (10.5, 9.2, 9.9, 19.8, 15.1, 18.3)
_EMPS_MASS = 95.1  # kg, Janot, Gautier and Brunot (2019)


def load(name, data_home):
    """Load a set: recording, protocol, identifier set up by it, and the two parts."""
    protocol = protocols()[name]
    if name == "demo":
        recording = protocol.load()
    else:
        recording = protocol.load(data_home=data_home)
    identifier = RobotIdentifier(
        recording.robot_model(),
        dt=recording.dt,
        friction=protocol.friction,
        cutoff=protocol.cutoff,
        standstill=protocol.standstill,
    )
    parts = [
        (recording.q[rows], recording.tau[rows], recording.groups[rows])
        for rows in protocol.split(recording)
    ]
    return recording, protocol, identifier, parts


def block_bootstrap(ours, other, part, dt, *, resamples=_RESAMPLES, seed=_SEED):
    """Difference of two errors per joint, with a 90 % interval over blocks of time.

    Parameters
    ----------
    ours, other : TorqueResiduals
        Residuals of two models on the same filtered samples.
    part : tuple of (X, y, groups)
        The recording that they were computed from.
    dt : float
        Sample period [s].

    Returns
    -------
    difference, low, high : ndarray of shape (nv,)
        ours minus other, as shares of the torque's standard deviation; nan for a
        joint that never counts, and limits of nan for too few blocks.
    n_blocks : int
        Blocks of time in which some joint moves.
    """
    groups = part[2]
    first = np.r_[0, np.flatnonzero(np.diff(groups)) + 1]
    recording = np.searchsorted(first, ours.index, side="right") - 1
    second = np.floor((ours.index - first[recording]) * dt / _BLOCK).astype(int)
    _, block = np.unique(
        np.column_stack([recording, second]), axis=0, return_inverse=True
    )
    block = block.ravel()
    n_blocks = int(block.max()) + 1
    nv = ours.torque.shape[1]
    sums = np.zeros((3, n_blocks, nv))
    w = ours.weight
    for total, values in zip(sums, (w, w * ours.residual**2, w * other.residual**2)):
        np.add.at(total, block, values)
    # Blocks in which the whole robot stands still say nothing.
    sums = sums[:, sums[0].any(axis=1)]
    n_blocks = sums.shape[1]
    # The torque's deviation is a unit of measurement here and stays the same.
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = ours.rms() / ours.normalised_error()

        def difference(counts):
            weight, a, b = np.einsum("b,kbj->kj", counts, sums)
            return (np.sqrt(a / weight) - np.sqrt(b / weight)) / spread

        whole = difference(np.ones(n_blocks))
        if n_blocks < _FEWEST_BLOCKS:
            nothing = np.full(nv, np.nan)
            return whole, nothing, nothing, n_blocks
        rng = np.random.default_rng(seed)
        drawn = rng.multinomial(n_blocks, np.full(n_blocks, 1 / n_blocks), resamples)
        sample = np.array([difference(counts) for counts in drawn])
        low, high = np.nanquantile(sample, [0.05, 0.95], axis=0)
        return whole, low, high, n_blocks


def _fit(identifier, part, **settings):
    return clone(identifier).set_params(**settings).fit(*part[:2], groups=part[2])


def _rows(results):
    rows = []
    for result in results:
        percent = 100 * result.error
        finite = percent[np.isfinite(percent)]
        mean = finite.mean() if finite.size else np.nan
        rows.append([result.name, *fixed(percent), *fixed([mean])])
    return rows


def measure(name, data_home, names=None):
    """Report of one set: list of paragraphs, and the rows of the summary."""
    recording, protocol, identifier, (train, test) = load(name, data_home)
    results, base = compare_methods(identifier, train, test, names=names)
    joints = base.joint_names_
    headers = ["error [%]", *(f"j{j + 1}" for j in range(len(joints))), "mean"]
    rows = _rows(results)
    if name == "ur5":
        reference = [*fixed(_REFERENCE_UR5), *fixed([np.mean(_REFERENCE_UR5)])]
        rows.append(["WLS, reference", *reference])
    filtered = (
        f"low-pass {base.cutoff_:.3g} Hz"
        if np.isfinite(base.cutoff_)
        else "no low-pass"
    )
    split = protocol.describe(recording)
    paragraphs = [
        rst_title(name, "~"),
        f"{recording}. {split[0].upper()}{split[1:]}. Filter: {filtered}; "
        f"standstill at or below {', '.join(f'{v:.2g}' for v in base.standstill_)} "
        f"rad/s or m/s masked. Friction: {', '.join(protocol.friction)}. Joints: "
        f"{', '.join(joints)}.",
        rst_table(rows, headers),
    ]
    failed = [f"{r.name} failed: {r.message}" for r in results if r.message]
    paragraphs += failed
    by_name = {r.name: np.nanmean(r.error) for r in results}
    change = by_name[OURS] / by_name["VB"] - 1 if "VB" in by_name else np.nan
    smallest = results[0].min_eigenvalue
    paragraphs.append(
        f"Smallest pseudo-inertia eigenvalue with projection: {smallest:.1e} (in units "
        "of each body's mass and length). The projection changes the mean held-out "
        f"error by {100 * change:+.1f} % of itself."
    )
    if name == "emps":
        mass = float(base.theta_[0])
        paragraphs.append(
            f"Mass of the slide: {mass:.2f} kg, {100 * (mass / _EMPS_MASS - 1):+.2f} % "
            f"from the publishers' {_EMPS_MASS} kg."
        )
    if name in _BOOTSTRAPPED:
        paragraphs += _bootstrap(base, identifier, train, test)
    if name == "staubli_tx40":
        paragraphs += _coupling(base, train, test)
    summary = [
        name,
        *fixed([100 * by_name[OURS], 100 * by_name.get("WLS", np.nan)]),
        f"{smallest:.1e}",
        f"{100 * change:+.1f}",
    ]
    return paragraphs, summary


def _bootstrap(base, identifier, train, test):
    rival = _fit(identifier, train, regressor=LinearRegression(), projector=None)
    ours = base.residuals(test[0], test[1], groups=test[2])
    theirs = rival.residuals(test[0], test[1], groups=test[2])
    difference, low, high, n_blocks = block_bootstrap(ours, theirs, test, base.dt)
    rows = [
        [joint, *fixed(100 * np.array([d, a, b]), 2)]
        for joint, d, a, b in zip(base.joint_names_, difference, low, high)
    ]
    headers = ["ours minus WLS [points]", "difference", "5 %", "95 %"]
    note = (
        f"Intervals of 90 %: bootstrap over {n_blocks} blocks of {_BLOCK:.0f} s of the "
        f"filtered residuals, {_RESAMPLES} resamples, seed {_SEED}."
        if n_blocks >= _FEWEST_BLOCKS
        else f"No intervals: the robot moves in only {n_blocks} of the blocks of "
        f"{_BLOCK:.0f} s."
    )
    return [rst_table(rows, headers), note]


def _coupling(base, train, test):
    joints, numbers = study(base, train, test)
    table = rst_table(
        [[name, *fixed(100 * values)] for name, values in joints.items()],
        ["error [%], WLS", *(f"j{j + 1}" for j in range(6))],
    )
    rows = [[name, f"{value:.2f}"] for name, value in numbers.items()]
    return [table, rst_table(rows, ["joint 5", "value"])]


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument(
        "--data", nargs="*", default=None, help="sets; by default all measured ones"
    )
    arguments.add_argument(
        "--methods", nargs="*", default=None, help=f"some of {', '.join(methods(10))}"
    )
    arguments = arguments.parse_args(argv)
    chosen = arguments.data or [name for name in protocols() if name != "demo"]
    names = None
    if arguments.methods is not None:
        names = [OURS, *(m for m in arguments.methods if m != OURS)]
    details, summary = [], []
    for name in chosen:
        started = time.perf_counter()
        with warnings.catch_warnings():
            # How rivals converge is shown by their errors.
            warnings.simplefilter("ignore")
            paragraphs, row = measure(name, arguments.data_home, names)
        seconds = time.perf_counter() - started
        print(f"{name}: {seconds:.0f} s", file=sys.stderr, flush=True)
        details += paragraphs
        summary.append(row)
    overview = rst_table(
        summary,
        [
            "mean error [%]",
            OURS,
            "WLS",
            "smallest eigenvalue",
            "projection's effect [%]",
        ],
    )
    text = "\n\n".join(
        [
            "Errors are root mean squares of the residual over the standard deviation "
            "of the torque, on the held-out part, behind the low-pass and the mask.",
            overview,
            *details,
        ]
    )
    publish("measured_robots", text, write=arguments.write)


if __name__ == "__main__":
    main()
