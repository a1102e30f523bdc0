"""Currents of which drives logged the sizes: found, and identified as with their sign.

Run ``python tests/benchmarks/bench_unsigned_currents.py [--trials N] [--seed S]
[--write]``. Simulated arms of one to six joints as in ``bench_coarse_torques.py``, with
friction, encoder noise, white noise and 12 bits of the current, gains of the channels
between 0.3 and 3 A/(N m), bodies of the description off by 20 %. The same recording is
identified with its sign and without it, from currents of unknown gain. Judged is the
error of the current against the noiseless one, with its sign, on another motion.

Asked for: named in all recordings, at most 1.3 times the error of the signed currents.
Seeds 0 to 19 were looked at while this was made; confirmation is from seed 6000 on.
"""

import warnings

import numpy as np
from _report import parser, publish, rst_table
from _undeclared_robots import draw_motion, inverse_dynamics
from bench_coarse_torques import DT, ENCODER, SECONDS, arm

from sklearn_vbjfa import RobotIdentifier
from sklearn_vbjfa.inspection import inspect_channels
from sklearn_vbjfa.robot import CurrentDrive

JOINTS = (1, 2, 3, 4, 6)
NOISE, BITS, WRONG = 0.02, 12, 0.2
# Share of the samples that must have the rarer sign for a channel to show both.
SELDOM = 0.05


class Truth:
    """An arm with friction and channels of its own."""

    def __init__(self, n_joints, seed):
        import pinocchio as pin

        self.rng = np.random.default_rng([n_joints, seed, 7])
        self.model = arm(n_joints, self.rng)
        self.true = self.model.copy()
        for k in range(1, self.model.njoints):
            body = self.model.inertias[k].toDynamicParameters()
            body = body * (1.0 + WRONG * self.rng.uniform(-1, 1))
            self.true.inertias[k] = pin.Inertia.FromDynamicParameters(body)
        self.gain = np.exp(self.rng.uniform(np.log(0.3), np.log(3.0), n_joints))
        self.viscous, self.coulomb = self.rng.uniform(0.05, 0.3, size=(2, n_joints))
        self.scale = None

    def record(self):
        """Positions, and currents without and with noise (n, nv)."""
        t = np.arange(0.0, SECONDS, DT)
        motion = draw_motion(np.ones(self.model.nv), 0.9, t, self.rng)
        q, v, a = motion.at(t)
        load = inverse_dynamics(self.true, q, v, a)
        if self.scale is None:
            self.scale = load.std(axis=0) + 1e-3, v.std(axis=0)
        size, fast = self.scale
        tau = load + size * (self.viscous * v / fast + self.coulomb * np.sign(v))
        exact = self.gain * tau
        noisy = exact + NOISE * exact.std(axis=0) * self.rng.normal(size=tau.shape)
        step = np.abs(noisy).max(axis=0) / 2**BITS
        q = q + ENCODER * self.rng.normal(size=q.shape)
        return q, exact, step * np.round(noisy / step)


def run(n_joints, seed):
    """Identify one arm both ways, as a dict."""
    truth = Truth(n_joints, seed)
    q, _, current = truth.record()
    other, exact, _ = truth.record()
    sizes = np.abs(current)
    found = inspect_channels(truth.model, q, sizes, DT)
    named = {j for f in found if f.kind == "unsigned_torque" for j in f.joints}
    false = any(
        f.kind == "unsigned_torque"
        for f in inspect_channels(truth.model, q, current, DT)
    )
    below = (current < 0).mean(axis=0)
    changing = set(np.flatnonzero(np.minimum(below, 1 - below) > SELDOM).tolist())
    errors = []
    for y, signed in ((current, True), (sizes, False)):
        robot = RobotIdentifier(truth.model, dt=DT, drive=CurrentDrive(signed=signed))
        with warnings.catch_warnings():
            # gains of joints that share nothing
            warnings.simplefilter("ignore", UserWarning)
            predicted = robot.fit(q, y).predict(other)
        inner = slice(50, -50)
        left = (predicted - exact)[inner].std(axis=0) / exact[inner].std(axis=0)
        errors.append(np.sqrt((left**2).mean()))
    return {
        "joints": n_joints,
        "changing": len(changing),
        "named": len(changing & named),
        "false": false,
        "errors": errors,
    }


def report(results):
    """Text with the table."""
    rows = []
    for n in sorted({one["joints"] for one in results}):
        own = [one for one in results if one["joints"] == n]
        errors = np.array([one["errors"] for one in own])
        ratio = errors[:, 1] / errors[:, 0]
        rows.append(
            [
                str(n),
                len(own),
                f"{sum(one['named'] for one in own)} of "
                f"{sum(one['changing'] for one in own)}",
                sum(one["named"] > 0 for one in own),
                sum(one["false"] for one in own),
                *(f"{100 * x:.2f}" for x in np.median(errors, axis=0)),
                f"{np.median(ratio):.3f}",
                f"{ratio.max():.3f}",
            ]
        )
    heads = ["joints", "recordings", "channels named", "with a name", "false"]
    heads += ["error, signed [%]", "sizes [%]", "ratio, median", "largest"]
    return "\n\n".join(
        [
            rst_table(rows, heads, n_labels=1),
            f"Channels named, of those with each sign in at least {100 * SELDOM:g} % "
            f"of the samples; {SECONDS:g} s of each arm; a false name is one of a "
            "channel with its sign. Error of the current on another motion, against "
            "the noiseless one.",
        ]
    )


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--trials", type=int, default=20)
    arguments.add_argument("--seed", type=int, default=0, help="first seed")
    arguments = arguments.parse_args(argv)
    seeds = range(arguments.seed, arguments.seed + arguments.trials)
    results = [run(n, seed) for seed in seeds for n in JOINTS]
    publish("unsigned_currents", report(results), write=arguments.write)


if __name__ == "__main__":
    main()
