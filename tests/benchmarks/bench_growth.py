"""Growth of time, peak memory and error with rows, columns and joints.

Run ``python tests/benchmarks/bench_growth.py [--study rows] [--missing] [--write]``.
Each method runs in a process of its own, whose peak memory is the operating system's
figure. What would take more than a minute or more than 4 GB, by extrapolation from the
sizes before, is not run. Measured figures are kept in a file, so that a study can be
measured in parts; the same problems and models are run by asv. The picture of the guide
is drawn from the tables by ``python docs/images/growth.py``.
"""

import importlib.metadata
import importlib.util
import json
import os
import resource
import signal
import subprocess
import sys
from math import log
from pathlib import Path

from _growth_problems import (
    CHUNK,
    COLUMNS,
    DISCOVERY,
    INPUT_NOISE,
    MOST_ROWS,
    PROJECTION,
    RELEVANT,
    ROWS,
    STREAMED,
    STUDIES,
    UNDECLARED,
    make_task,
)
from _ledger import note, noted
from _report import commit, parser, publish, rst_table, rst_title

MOST_SECONDS = 60.0
MOST_MEGABYTES = 4096.0
# A process also starts, imports and makes the data; a run that the extrapolation was
# wrong about ends after this and twice the limit.
START_SECONDS = 30.0
# What takes less than this is run again, to fill a time but not more often than that.
REPEAT_SECONDS = 2.0
FILL_SECONDS = 1.0
MOST_RUNS = 50
RESULTS = Path(__file__).resolve().parent / ".asv" / "growth.json"
QUICK = {"rows": (10**3, 10**4), "columns": (10, 50), "joints": (1, 6)}
TITLES = {
    "rows": f"Rows, {COLUMNS} columns",
    "columns": f"Columns, {ROWS} rows",
    "joints": "Joints",
}


def peak_megabytes():
    """Peak memory of this process [MB]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # Kilobytes, but on macOS bytes.
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


def measure_here(study, method, size):
    """Figures of one run in this process."""
    before = peak_megabytes()
    task = make_task(study, method, size)
    seconds = task.run()
    peak = peak_megabytes()
    if seconds < REPEAT_SECONDS:
        # The first run loads libraries; the processor's clock may tick in
        # milliseconds, which many runs average out.
        times = []
        while not sum(times) or (sum(times) < FILL_SECONDS and len(times) < MOST_RUNS):
            times.append(task.run())
        seconds = sum(times) / len(times)
    return {
        "seconds": seconds,
        "megabytes": peak,
        "megabytes_before": before,
        "error": task.error(),
    }


def measure_apart(study, method, size, most_seconds=MOST_SECONDS):
    """Figures of one run in a process of its own, on one thread."""
    # This process must stay small: a child's peak begins at its parent's.
    limit = round(START_SECONDS + 2 * most_seconds)
    command = [sys.executable, __file__, "--run", study, method, str(size), str(limit)]
    answer = subprocess.run(
        command,
        env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    if answer.returncode == -signal.SIGXCPU:
        return {"skipped": f"stopped after {2 * most_seconds:g} s"}
    if answer.returncode < 0:
        return {"skipped": f"ended by signal {-answer.returncode}"}
    if answer.returncode:
        raise RuntimeError(f"{study}, {method}, {size} failed:\n{answer.stderr}")
    return json.loads(answer.stdout.splitlines()[-1])


def extrapolate(sizes, values, size):
    """Value at the next size by the power law of the last two, at least linear."""
    power = 1.0
    if len(sizes) > 1:
        rise = log(values[-1] / values[-2]) / log(sizes[-1] / sizes[-2])
        power = max(power, rise)
    return values[-1] * (size / sizes[-1]) ** power


def reason_to_skip(done, size, most_seconds=MOST_SECONDS):
    """Why a size is not run, from what the sizes before took; or None."""
    if any("skipped" in entry for entry in done.values()):
        return "too large"
    sizes = list(done)
    if not sizes:
        return None
    seconds = extrapolate(sizes, [done[n]["seconds"] for n in sizes], size)
    if seconds > most_seconds:
        return f"about {short(seconds)} s"
    own = [max(e["megabytes"] - e["megabytes_before"], 1.0) for e in done.values()]
    megabytes = done[sizes[-1]]["megabytes_before"] + extrapolate(sizes, own, size)
    if megabytes > MOST_MEGABYTES:
        return f"about {megabytes / 1024:.2g} GB"
    return None


def measure(
    study, method, sizes, run=measure_apart, most_seconds=MOST_SECONDS, kept=None
):
    """Size -> figures, or why there are none; figures in `kept` stay."""
    done = {n: e for n, e in (kept or {}).items() if "skipped" not in e}
    for size in sizes:
        if size in done:
            continue
        streamed = method in STREAMED and study == "rows" and size > MOST_ROWS
        # In chunks neither memory nor time go on as they did before.
        reason = None if streamed else reason_to_skip(done, size, most_seconds)
        if reason:
            done[size] = {"skipped": reason}
        else:
            figures = run(study, method, size, most_seconds)
            done[size] = {**figures, "commit": commit()}
        print(f"{study}, {method}, {size}: {done[size]}", file=sys.stderr, flush=True)
    return done


def short(value):
    """Two digits, and no powers of ten."""
    return f"{value:.0f}" if value >= 99.5 else f"{value:.2g}"


def cell(entry):
    """Text of one run."""
    if "skipped" in entry:
        return f"not run: {entry['skipped']}"
    return (
        f"{short(entry['seconds'])} s, {entry['megabytes']:.0f} MB, "
        f"{short(100 * entry['error'])} %"
    )


def table(results):
    """Methods by sizes; results: method -> size -> figures."""
    sizes = sorted({size for done in results.values() for size in done})
    rows = [
        [method, *[cell(done[n]) if n in done else "" for n in sizes]]
        for method, done in results.items()
    ]
    return rst_table(rows, ["method", *[f"{n:,}" for n in sizes]])


def _odrpack():
    if importlib.util.find_spec("odrpack") is None:
        return "odrpack was not installed."
    return f"odrpack {importlib.metadata.version('odrpack')} takes all noise as equal."


def report(results, most_seconds=MOST_SECONDS):
    """All tables; results: study -> method -> size -> figures."""
    parts = [
        "Seconds of processor time, peak memory of the process (Python, libraries and "
        "data included), and relative error. Each run in a process of its own, on one "
        f"thread; the mean of up to {MOST_RUNS} further runs, {FILL_SECONDS:.0f} s "
        f"together, where the first takes less than {REPEAT_SECONDS:.0f} s. "
        f"Not run is what would take more than {most_seconds:g} s or "
        f"{MOST_MEGABYTES / 1024:.0f} GB by extrapolation from the sizes before, with "
        "that figure; what then took twice as long all the same was stopped.",
        f"Rows and columns: {RELEVANT} relevant columns, noise in the output, and "
        f"noise in the columns, {100 * INPUT_NOISE:.0f} % of their variance. The error "
        "is the distance of the coefficients for noiseless inputs from the truth, "
        'relative to its length; zero coefficients have 100 %. "Noise given" is told '
        f"the variances of that noise. Above {MOST_ROWS:,} rows the package's models "
        f"take them in chunks of {CHUNK:,} by ``partial_fit``, the time of which is "
        "shown. Everything else has its defaults: PLSRegression two components. "
        f"{_odrpack()}",
        "Joints: chains of revolute joints, 20 s at 100 Hz, eleven parameters a joint. "
        "RobotIdentifier with its defaults, then with other regressors and no "
        "projection; the error is that of the parameters in the metric of another, "
        f"noiseless motion. {PROJECTION}: seconds of one projection, and the distance "
        f"from the truth after it over that before. {DISCOVERY}: the whole library, "
        f"with Coulomb friction of {100 * UNDECLARED:.0f} % of the first joint's "
        "torque to find; the error is that of the friction, 100 % if it is not named.",
    ]
    for study, found in results.items():
        parts += [rst_title(TITLES[study], "~"), table(found)]
    return "\n\n".join(parts)


def load(path):
    """Results kept in a file: study -> method -> size -> figures."""
    if not path.is_file():
        return {}
    kept = json.loads(path.read_text(encoding="utf-8"))
    return {
        study: {
            method: {int(n): entry for n, entry in done.items()}
            for method, done in found.items()
        }
        for study, found in kept.items()
    }


def in_order(results):
    """Studies and methods in the order of their definition."""
    return {
        study: {m: results[study][m] for m in methods if m in results[study]}
        for study, (_, methods, _) in STUDIES.items()
        if study in results
    }


def main(argv=None, run=measure_apart):
    """Measure, keep, and print the tables."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--study", action="append", choices=list(STUDIES))
    arguments.add_argument("--method", action="append", help="these methods alone")
    arguments.add_argument(
        "--missing", action="store_true", help="only what has no figures yet"
    )
    arguments.add_argument(
        "--report-only", action="store_true", help="measure nothing, show what is kept"
    )
    arguments.add_argument(
        "--quick", action="store_true", help="two small sizes; keeps and writes nothing"
    )
    arguments.add_argument(
        "--most-seconds", type=float, default=MOST_SECONDS, help="limit of one run"
    )
    arguments.add_argument("--results", type=Path, default=RESULTS)
    arguments.add_argument(
        "--run",
        nargs=4,
        metavar=("STUDY", "METHOD", "SIZE", "LIMIT"),
        help="one run in this process, with its limit of processor time [s]",
    )
    arguments = arguments.parse_args(argv)
    if arguments.run:
        study, method, size, limit = arguments.run
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit) + 5))
        print(json.dumps(measure_here(study, method, int(size))))
        return
    results = {} if arguments.quick else load(arguments.results)
    for study in [] if arguments.report_only else arguments.study or list(STUDIES):
        sizes, methods, _ = STUDIES[study]
        found = results.setdefault(study, {})
        sizes = QUICK[study] if arguments.quick else sizes
        for method in methods:
            if arguments.method is not None and method not in arguments.method:
                continue
            kept = found.get(method) if arguments.missing else None
            limit = arguments.most_seconds
            found[method] = measure(study, method, sizes, run, limit, kept)
            if not arguments.quick:
                arguments.results.parent.mkdir(parents=True, exist_ok=True)
                arguments.results.write_text(json.dumps(results, indent=1))
    # at the end, as it takes memory that further processes would begin with
    if not (arguments.quick or arguments.report_only):
        note(arguments.results)
    results = in_order(results)
    write = arguments.write and not arguments.quick
    text = report(results, arguments.most_seconds)
    publish("growth", text, write=write, states=states(results, arguments.results))


def states(results, path):
    """Return the code that the figures were made with, as it was kept beside a file."""
    made = [
        entry.get("commit")
        for found in results.values()
        for done in found.values()
        for entry in done.values()
        if "skipped" not in entry
    ]
    return noted([path], list(dict.fromkeys(made)))


if __name__ == "__main__":
    main()
