"""What halving and doubling each number of the search does to names and false names.

Run ``python tests/benchmarks/bench_search_sensitivity.py --results FILE [--trials N]
[--write]``. Data: the recordings of ``bench_false_alarms.py`` with one joint, of each
kind of residual, with nothing missing and with one effect put in; seeds from 3000 on,
used for nothing else. A row is one `SearchSettings` in which one number is half or
twice its default (a share stays below one). Split: that of `EffectDiscovery`.
"""

from dataclasses import fields

from _ledger import Ledger
from _report import parser, publish, rst_table
from bench_false_alarms import RESIDUALS, judge

KEYS = ("number", "factor", "residual", "seed", "study")
SEED = 3000
FACTORS = (0.5, 2.0)


def settings_of(number, factor):
    """Return `SearchSettings` with one number multiplied by a factor."""
    from sklearn_vbjfa.diagnosis import SearchSettings

    if number == "defaults":
        return SearchSettings()
    value = getattr(SearchSettings(), number)
    changed = value * factor
    if number == "undecided":
        # Half and twice the odds.
        odds = factor * value / (1 - value)
        changed = odds / (1 + odds)
    return SearchSettings(**{number: type(value)(max(changed, 1e-6))})


def rows_of_study():
    """Return (number, factor) of every row."""
    from sklearn_vbjfa.diagnosis import SearchSettings

    numbers = [field.name for field in fields(SearchSettings)]
    return [("defaults", 1.0), *((n, f) for n in numbers for f in FACTORS)]


def study(trials, results=None):
    """Run what is missing; returns the `Ledger`."""
    ledger = Ledger(results, KEYS)
    tasks = [
        dict(zip(KEYS, (number, factor, residual, seed, which), strict=True))
        for seed in range(SEED, SEED + trials)
        for number, factor in rows_of_study()
        for residual in RESIDUALS
        for which in ("null", "power")
    ]
    for task in ledger.missing(tasks):
        own = settings_of(task["number"], task["factor"])
        found = judge(
            task["residual"], 1, task["seed"], task["study"] == "power", settings=own
        )
        ledger.add({**found, **task})
    return ledger


def row(number, factor, results):
    """Row of the table."""
    own = [r for r in results if (r["number"], r["factor"]) == (number, factor)]
    null = [r for r in own if r["study"] == "null" and "error" not in r]
    power = [r for r in own if r["study"] == "power" and "error" not in r]

    def share(flags):
        flags = list(flags)
        return f"{100 * sum(flags) / len(flags):.1f}" if flags else "–"

    value = getattr(settings_of(number, factor), number, "")
    return [
        number,
        f"{value:.3g}" if value != "" else "",
        str(len(null)),
        share(bool(r["names"]) for r in null),
        share(bool(r["perhaps"]) for r in null),
        str(len(power)),
        share(r["found"] for r in power),
        share(r["found or perhaps"] for r in power),
        share(any(not one["right"] for one in r["names"]) for r in power),
    ]


HEADERS = [
    "number",
    "value",
    "nothing missing",
    "any name [%]",
    "any perhaps [%]",
    "with an effect",
    "named [%]",
    "or perhaps [%]",
    "a wrong name [%]",
]


def main(argv=None):
    """Print the table."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument("--trials", type=int, default=3, help="of each residual")
    arguments.add_argument("--results", metavar="FILE", help="JSON lines to go on with")
    arguments = arguments.parse_args(argv)
    ledger = study(arguments.trials, arguments.results)
    rows = [row(*one, ledger.results) for one in rows_of_study()]
    publish(
        "search_sensitivity",
        rst_table(rows, HEADERS, n_labels=2),
        write=arguments.write,
        states=ledger.states(),
    )


if __name__ == "__main__":
    main()
