"""Single effects by kind and size: the right name on the right joint, how often.

Run ``python tests/benchmarks/bench_single_effects.py --out FILE [--seeds FIRST LAST]
[--studies single two] [--kinds spring ...] [--sizes 0.5 1 2 6] [--jobs N] [--write]``.

Data: ``_undeclared.py``, which shares no code with the library of effects: robots of
two to seven joints, 30 to 60 s at 100 to 200 Hz in one or two recordings, white torque
noise of 2 to 5 % of the spread, viscous friction declared. The
size of an effect is the root mean square of the part that the declared columns cannot
absorb, weighted by the torque noise, over that noise. Where an effect cannot have the
size asked for within what is physical (an elastic joint, a delay of 40 ms, a filter of
the torque of 2 Hz), in none of four robots, the case is not counted.

- ``single``: every kind at every size, ten seeds. Named: the right name, or one
  whose declared rivals have it, on the right joint; other names are counted apart.
- ``two``, ``three``: kinds drawn evenly, sizes 1 to 6; all of them named, as above,
  and nothing else but what the simulated effects contain.
- ``none``: nothing is missing; any name is wrong.

Beside every share stands its lower bound at 90 % (Clopper and Pearson 1934).

What the loop gives as perhaps is judged as names are, and counted apart.

Seeds 0 to 99 are for work, those from 300 on to confirm. The other studies have seeds
from the first one on.
"""

import time
import warnings
from collections import Counter

import numpy as np
from _perhaps import PERHAPS, calibration, counts, stated
from _report import parser, publish, rst_table, rst_title, run_study
from _undeclared import CHANNELS, LIBRARY, PLAIN, draw_cases, simulate
from scipy.stats import beta

from sklearn_vbjfa import EffectDiscovery, RobotIdentifier

# The numbers of the kinds are part of the seeds.
ALL = ("viscous", *LIBRARY, *CHANNELS)
KINDS = tuple(kind for kind in ALL if kind not in PLAIN)
# Sizes with the shares that are to be named.
SIZES = {0.5: 0.70, 1.0: 0.85, 2.0: 0.94, 6.0: 0.96}
SEVERAL = {"two": 2, "three": 3}
SEVERAL_SIZES = (1.0, 6.0)
SEVERAL_TARGET = 0.85
FALSE_ALARMS = 0.05
STUDIES = ("single", *SEVERAL, "none")
KEYS = ("study", "kinds", "sizes", "seed")
LEVEL = 0.9


def lower_bound(successes, n):
    """Bound that a share exceeds with `LEVEL`, after Clopper and Pearson."""
    if successes == 0 or n == 0:
        return 0.0
    return float(beta.ppf(1.0 - LEVEL, successes, n - successes + 1))


def tasks_of(studies, kinds, sizes, seed, n_seeds, n_cases):
    """Tasks as dicts with `KEYS`, seeds outermost, so that a part is a sample."""
    tasks = []
    if "single" in studies:
        tasks += [
            {"study": "single", "kinds": [kind], "sizes": [float(size)], "seed": s}
            for s in range(seed, seed + n_seeds)
            for kind in kinds
            for size in sizes
        ]
    drawn = [kind for kind in KINDS if kind in kinds]
    for study in (study for study in SEVERAL if study in studies):
        cases = draw_cases(n_cases, SEVERAL[study], SEVERAL_SIZES, seed, drawn)
        tasks += [
            {
                "study": study,
                "kinds": chosen,
                "sizes": [round(size, 6) for size in drawn_sizes],
                "seed": seed + i,
            }
            for i, (chosen, drawn_sizes) in enumerate(cases)
        ]
    if "none" in studies:
        tasks += [
            {"study": "none", "kinds": [], "sizes": [], "seed": s}
            for s in range(seed, seed + n_cases)
        ]
    return tasks


def draw(task):
    """Draw the recording of a task."""
    number = ALL.index(task["kinds"][0]) if task["kinds"] else len(ALL)
    return simulate(
        task["kinds"],
        size=task["sizes"],
        seed=(task["seed"], STUDIES.index(task["study"]), number),
    )


def judge(recording, effects):
    """Compare what was found with the truth."""
    truth = [(e.name, e.joint) for e in recording.truth]
    contained = {(name, e.joint) for e in recording.truth for name in e.contains}
    found = {(e.name, e.joint) for e in effects}
    rivals = {(name, e.joint) for e in effects for name in e.rivals}
    excused = {
        (e.name, e.joint)
        for e in effects
        if {(name, e.joint) for name in e.rivals} & set(truth)
    }
    named = [pair in found | rivals for pair in truth]
    by_rival = [pair in rivals - found for pair in truth]
    return named, by_rival, sorted(found - set(truth) - contained - excused)


def run(task):
    """Close the loop on one case."""
    recording = draw(task)
    result = {
        **task,
        "visible": recording.visible,
        "truth": [[e.name, e.joint, round(e.outside, 3)] for e in recording.truth],
        "declared": list(recording.declared),
    }
    if not recording.visible:
        return result
    identifier = RobotIdentifier(
        recording.model, dt=recording.dt, friction=recording.declared
    )
    loop = EffectDiscovery(identifier, random_state=0)
    started = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        loop.fit(recording.q, recording.tau, groups=recording.groups)
    named, by_rival, extra = judge(recording, loop.effects_)
    perhaps, _, wrong = judge(recording, loop.possible_)
    return {
        **result,
        "named": named,
        "by_rival": by_rival,
        "extra": [list(pair) for pair in extra],
        "found": [[e.name, e.joint, list(e.rivals)] for e in loop.effects_],
        "names": stated(loop.effects_, extra),
        "perhaps": stated(loop.possible_, wrong),
        "named_or_perhaps": [a or b for a, b in zip(named, perhaps, strict=True)],
        "seconds": time.perf_counter() - started,
    }


def line(result):
    """One line about one case."""
    truth = ", ".join(f"{n} {j + 1} ({size:.2g})" for n, j, size in result["truth"])
    start = f"{result['study']} seed {result['seed']}: {truth or 'nothing'}"
    if not result["visible"]:
        return f"{start}: not of this size in any robot"
    found = ", ".join(f"{n} {j + 1}" for n, j, _ in result["found"]) or "nothing"
    verdict = "named" if all(result["named"]) else "MISSED"
    wrong = "; wrong name" if result["extra"] else ""
    perhaps = ", ".join(f"{e['name']} {e['joint'] + 1}" for e in result["perhaps"])
    found += f"; perhaps {perhaps}" if perhaps else ""
    return f"{start}: {verdict}{wrong}; found {found}; {result['seconds']:.0f} s"


def _share(flags):
    n, k = len(flags), sum(flags)
    if not n:
        return ["0", "–", "–"]
    return [str(n), f"{100 * k / n:.0f} %", f"{100 * lower_bound(k, n):.0f} %"]


def _sizes_table(results):
    rows = []
    for size, target in SIZES.items():
        own = [r for r in results if r["sizes"] == [size]]
        if not own:
            continue
        counted = [r for r in own if r["visible"]]
        rivals = [r["by_rival"][0] for r in counted]
        wrong = [bool(r["extra"]) for r in counted]
        rows.append(
            [
                f"{size:g}",
                *_share([r["named"][0] for r in counted]),
                f"{100 * target:.0f} %",
                f"{sum(rivals)}",
                f"{sum(wrong)}",
                f"{sum(r['named_or_perhaps'][0] for r in counted)}",
                *counts(counted),
                f"{len(own) - len(counted)}",
            ]
        )
    headers = [
        "size",
        "cases",
        "named",
        "lower bound",
        "target",
        "of these as a rival",
        "with another name",
        "named or perhaps",
        *PERHAPS,
        "not of this size",
    ]
    return rst_table(rows, headers)


def _kinds_table(results):
    rows = []
    for kind in KINDS:
        own = [r for r in results if r["kinds"] == [kind]]
        if not own:
            continue
        cells = []
        for size in SIZES:
            here = [r for r in own if r["sizes"] == [size] and r["visible"]]
            named = sum(r["named"][0] for r in here)
            cells.append(f"{named} of {len(here)}" if here else "–")
        instead = Counter(
            name
            for r in own
            if r["visible"] and not r["named"][0]
            for name in {found[0] for found in r["found"]} or {"nothing"}
        )
        words = ", ".join(f"{name} {n}" for name, n in instead.most_common(4))
        rows.append([kind, *cells, words or "–", *counts(own)])
    headers = ["kind", *(f"size {size:g}" for size in SIZES), "found instead", *PERHAPS]
    return rst_table(rows, headers)


def _others_table(results):
    rows = []
    for study in SEVERAL:
        own = [r for r in results if r["study"] == study]
        counted = [r for r in own if r["visible"]]
        if own:
            right = [all(r["named"]) and not r["extra"] for r in counted]
            each = [flag for r in counted for flag in r["named"]]
            rows.append(
                [
                    f"{study} effects, sizes {SEVERAL_SIZES[0]:g} to "
                    f"{SEVERAL_SIZES[1]:g}: all named, nothing else",
                    *_share(right),
                    f"{100 * SEVERAL_TARGET:.0f} %",
                    f"{100 * np.mean(each):.0f} %" if each else "–",
                    *counts(counted),
                ]
            )
    none = [r for r in results if r["study"] == "none"]
    clean = [not r["extra"] for r in none]
    if clean:
        label = "nothing missing: nothing named"
        target = f"{100 * (1 - FALSE_ALARMS):.0f} %"
        rows.append([label, *_share(clean), target, "–", *counts(none)])
    if not rows:
        return ""
    headers = ["undeclared", "cases", "share", "lower bound", "target", "each effect"]
    return rst_table(rows, [*headers, *PERHAPS])


def report(results):
    """Text with the tables of the results that there are."""
    single = [r for r in results if r["study"] == "single"]
    parts = ["Sizes: the part that the declared columns cannot absorb, over the noise."]
    if single:
        parts += [_sizes_table(single), rst_title("By kind"), _kinds_table(single)]
    others = _others_table(results)
    if others:
        parts += [rst_title("Several, and none"), others]
    parts.append(calibration(results))
    times = [r["seconds"] for r in results if "seconds" in r]
    if times:
        parts.append(f"Median time of the loop: {np.median(times):.1f} s.")
    return "\n\n".join(parts)


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__, out=True, jobs=True, seeds=(0, 9))
    arguments.add_argument("--studies", nargs="+", choices=STUDIES, default=STUDIES)
    arguments.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    arguments.add_argument(
        "--sizes", nargs="+", type=float, choices=tuple(SIZES), default=tuple(SIZES)
    )
    arguments.add_argument("--cases", type=int, default=40, help="not of single ones")
    arguments = arguments.parse_args(argv)
    given = arguments.studies, arguments.kinds, arguments.sizes
    (first, last), cases = arguments.seeds, arguments.cases
    if arguments.quick:
        given, last, cases = (("single",), KINDS[:1], (6.0,)), first, 1
    tasks = tasks_of(*given, first, last - first + 1, cases)
    ledger = run_study(
        run, tasks, KEYS, out=arguments.out, jobs=arguments.jobs, line=line
    )
    publish(
        "single_effects" + ("" if first < 100 else "_confirmation"),
        report(ledger.of(tasks)),
        arguments,
        command=f"single_effects.py --seeds {first} {last} --cases {cases}",
        commits=ledger.commits(tasks),
    )


if __name__ == "__main__":
    main()
