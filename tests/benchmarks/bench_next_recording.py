"""The error that a report promises for the next recording, and what it is.

Run ``python tests/benchmarks/bench_next_recording.py --data-home DIR --seeds 30 59
[--out FILE] [--write]``.

Data: the measured sets with several recordings, cut-offs and masks frozen
(``_protocol_sets.py``). Each left-out side of the frozen pairs is judged: by a model
fitted to all others, and by models fitted to the first one or two of those. Four plain
terms; effects are searched where all others are fitted (``--search``), else none.
Promised: the mean of the joints and its interval, as the report prints them; judged:
the error of the same model on the recording that was left out, over the same spread.
Joints whose range of torque or speed was not fitted count as well: the promise does not
exclude them.

Simulated sets: see ``_differing_sets.py``; the promise of each is judged on one more
recording. The default search runs; differences between recordings are those that the
report names.
"""

import time
import warnings

import _differing_sets as differing
import numpy as np
from _protocol_sets import PAIRED_SETS, pairs
from _report import fixed, parser, publish, rst_table, run_study
from scipy import stats

from sklearn_vbjfa import EffectDiscovery

KEYS = ("set", "judged", "fitted", "search")
COUNTS = {"all others": None, "two": 2, "one": 1}


def judge(task):
    """Promise and truth of one case, plain data for JSON."""
    name, search, data_home = task["set"], task["search"], task["data_home"]
    fitted, judged = task["names"]
    frozen = PAIRED_SETS[name]
    recording = frozen.recording(data_home)
    identifier = frozen.identifier(recording.robot_model(), recording.dt)
    fit, unseen = recording.select(*fitted), recording.select(*judged)
    effects = {} if search else {"effects": []}
    started = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        loop = EffectDiscovery(identifier, random_state=0, **effects)
        loop.fit(fit.q, fit.tau, groups=fit.groups)
        left = loop.identifier_.residuals(unseen.q, unseen.tau, groups=unseen.groups)
    promised = loop.report_.outcome.facts_of("next recording")
    median = np.array([one.value for one in promised[:-1]])
    low, high = np.array([one.interval for one in promised[:-1]]).T
    error = left.rms() / loop.torque_std_
    known = np.isfinite(median) & np.isfinite(error)
    return {
        **{key: task[key] for key in KEYS},
        "source": promised[-1].source,
        "promised": promised[-1].value,
        "true": float(error[known].mean()),
        "untouched": float(loop.error_after_[known].mean()),
        "inside": int(((error >= low) & (error <= high))[known].sum()),
        "joints": int(known.sum()),
        "interval": list(promised[-1].interval),
        "seconds": time.process_time() - started,
    }


def tasks(names, data_home=None, search=False):
    """Yield the tasks of some sets."""
    for name in names:
        frozen = PAIRED_SETS[name]
        recording = frozen.recording(data_home)
        for label, fitted, judged in pairs(recording.group_names, frozen.leave_out):
            for count in (None,) if search else COUNTS.values():
                some = fitted if count is None else fitted[:count]
                if count is None or count < len(fitted):
                    yield {
                        "set": name,
                        "judged": label,
                        "fitted": len(some),
                        "search": search,
                        "names": (some, judged),
                        "data_home": data_home,
                    }


def against(results):
    """Whether errors are as promised, upper over lower end, true over promised."""
    names = "true", "promised"
    true, promised = np.array([[r[name] for name in names] for r in results]).T
    low, high = np.array([r["interval"] for r in results]).T
    return (low <= true) & (true <= high), high / low, true / promised


def summary(results):
    """Rows by what was fitted."""
    rows = []
    for search in (False, True):
        for kind in ("assumed", "partly measured", "measured"):
            own = [r for r in results if r["source"] == kind and r["search"] == search]
            if not own:
                continue
            held, width, ratio = against(own)
            before = np.array([r["true"] / r["untouched"] for r in own])
            joints = sum(r["joints"] for r in own)
            inside = sum(r["inside"] for r in own)
            rows.append(
                [
                    kind,
                    "yes" if search else "no",
                    str(len(own)),
                    *fixed([np.median(ratio), ratio.min(), ratio.max()], 2),
                    *fixed([np.median(before), before.max()], 2),
                    str(joints),
                    *fixed([100 * inside / joints], 0),
                    *fixed([100 * np.mean(held)], 0),
                    *fixed([np.median(width)], 1),
                ]
            )
    heads = [
        "differences",
        "effects searched",
        "cases",
        "judged / promised, median",
        "least",
        "largest",
        "judged / held-out, median",
        "largest",
        "joints",
        "in their interval [%]",
        "means in theirs [%]",
        "upper / lower end",
    ]
    return rst_table(rows, heads, n_labels=2)


def by_case(results):
    """One row a case."""
    rows = [
        [
            r["set"],
            r["judged"],
            str(r["fitted"]),
            "yes" if r["search"] else "no",
            *fixed([100 * r["untouched"], 100 * r["promised"], 100 * r["true"]], 1),
            *fixed([r["true"] / r["promised"]], 2),
            f"{r['inside']} of {r['joints']}",
        ]
        for r in results
    ]
    heads = ["set", "judged", "fitted", "searched", "held-out [%]", "promised [%]"]
    heads += ["judged [%]", "ratio", "in their interval"]
    return rst_table(rows, heads, n_labels=2)


def by_cell(results, by):
    """One row for the sets of each value of some keys."""
    rows = []
    for cell in dict.fromkeys(tuple(r[key] for key in by) for r in results):
        own = [r for r in results if tuple(r[key] for key in by) == cell]
        held, width, ratio = against(own)
        odds = stats.binomtest(int(held.sum()), held.size, 0.9).pvalue
        # Another payload is named as an effect, too.
        causes = [{*r["differ"], *{"payload"}.intersection(r["named"])} for r in own]
        right = [r["kind"] in one for r, one in zip(own, causes)]
        others = [bool(one - {r["kind"]}) for r, one in zip(own, causes)]
        shares = 100 * np.array([held, right, others]).mean(axis=1)
        label = [f"{x:.0%}" if isinstance(x, float) else str(x) for x in cell]
        joints = 100 * np.mean([r["joints"] for r in own])
        row = [*label, str(len(own)), *fixed([shares[0], joints], 0)]
        middle = np.median([width, ratio], axis=1)
        rows.append([*row, *fixed([odds], 4), *fixed(middle, 2)])
        rows[-1] += fixed(shares[1:], 0)
    heads = ["sets", "in their interval [%]", "joints [%]", "p", "upper / lower end"]
    heads += ["judged / promised, median", "difference named [%]", "another named [%]"]
    names = {"kind": "differing", "size": "by", "count": "recordings"}
    return rst_table(rows, [*(names[key] for key in by), *heads], n_labels=len(by))


def simulated(arguments):
    """Tables of the simulated sets, and the commits of their results."""
    first, last = (0, 0) if arguments.quick else arguments.seeds
    tasks = differing.tasks(range(first, last + 1))
    # Other keys need files of their own.
    out = [f"{path}.sets" for path in arguments.out or ()]
    ledger = run_study(differing.judge, tasks, differing.KEYS, out=out)
    done = [r for r in ledger.of(tasks) if "error" not in r]
    failed = [r for r in ledger.of(tasks) if "error" in r]
    keys = ("kind",), ("count",), ("kind", "size", "count")
    text = [by_cell(done, by) for by in keys]
    said = {key: [r[key] for r in failed] for key in ("kind", "error")}
    text.insert(0, f"Refused: {len(failed)} {said if failed else ''}".rstrip())
    return "\n\n".join(text), ledger.commits(tasks)


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__, data=True, out=True, seeds=[30, 59])
    arguments.add_argument("--sets", nargs="+", choices=PAIRED_SETS)
    arguments.add_argument("--search", action="store_true")
    arguments = arguments.parse_args(argv)
    names = arguments.sets or [n for n in PAIRED_SETS if n != "demo"]
    given = arguments.data_home, arguments.search
    ledger = run_study(
        judge,
        list(tasks(["demo"] if arguments.quick else names, *given)),
        KEYS,
        out=arguments.out,
        line=str,
    )
    sets, commits = simulated(arguments)
    text = "\n\n".join([summary(ledger.results), sets, by_case(ledger.results)])
    commits = list(dict.fromkeys(ledger.commits() + commits))
    publish("next_recording", text, arguments, commits=commits)


if __name__ == "__main__":
    main()
