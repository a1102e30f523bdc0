"""The search on measured robots, with numbers that were chosen on the other ones.

Run ``python tests/benchmarks/bench_leave_one_set_out.py --data-home DIR --out FILE
[--data SET ...] [--settings NAME ...] [--write]``.

Ten measured sets. Where a set has several motions, all pairs of the frozen protocol
(`PAIRED_SETS`): fitted to some recordings and judged on the one that is left out,
errors over the spread of the torque in the moving time of all recordings of the set. A
joint of a pair counts where 80 % or more of the judged range of its torque and of its
speed were fitted; a pair without such a joint is shown and not counted. Where there is
one motion, the part that the loop holds out (`bench_measured_sets.py`), all of
its joints.

Judged for each pair:

- least squares: viscous and Coulomb friction, offset and rotor inertia on every joint,
  joints weighted by their noise, no projection and no search; same recordings, cut-off
  and mask.
- completed: what `EffectDiscovery` ends with.

Ratio: the mean of the completed model's errors over the joints that count, over that of
least squares. Of a set: the mean over its pairs. Of all: the mean over the sets.

Every pair is run with each of a few settings of the search (`SETTINGS`). What a user
gets on a robot that nobody has seen is the ratio on a set with the settings that are
best on the other nine: a choice that looks at the set that it is judged on says
nothing. Beside it stands the ratio with the defaults.

``--out`` keeps the results, by settings, set and pair; of several files the first is
written to and the others are read, ``--table`` runs nothing. The file holds the values
of the settings, and other values of the same name are other settings.
"""

import functools
import time
import warnings

import numpy as np
from _ledger import Ledger
from _protocol_sets import PAIRED_SETS, pairs
from _report import fixed, parser, publish, rst_table, rst_title
from bench_measured_sets import PLAIN, judge_set, load
from bench_protocol_pairs import judge, measure_scale
from sklearn.base import clone

from sklearn_vbjfa.robot import methods

# Name -> values of `SearchSettings` that differ from the defaults. The first is the one
# that the others are compared with.
SETTINGS = {
    "default": {},
}
DEFAULT = next(iter(SETTINGS))
# Sets of one motion.
HELD_OUT_SETS = (
    "staubli_tx40",
    "tflex_1dof",
    "franka_panda",
    "kuka_lbr_med7",
    "tiago",
)
SETS = (*PAIRED_SETS, *HELD_OUT_SETS)
HELD_OUT = "held-out part"
KEYS = ("settings", "values", "set", "pair")


def arguments_of(values):
    """Arguments of `EffectDiscovery` for the values of some settings.

    Without any there are none: versions from before there were settings have no such
    argument.
    """
    if not values:
        return {}
    from sklearn_vbjfa import diagnosis

    return {"settings": diagnosis.SearchSettings(**values)}


# -- pairs -----------------------------------------------------------------------------


def least_squares(identifier, fitted, judged):
    """Root mean square on some recordings of least squares on others, (nv,)."""
    model = clone(identifier).set_params(friction=PLAIN, **methods(1)["WLS"])
    model.fit(fitted.q, fitted.tau, groups=fitted.groups)
    return model.residuals(judged.q, judged.tau, groups=judged.groups).rms()


def judge_pair(recording, identifier, scale, pair, **settings):
    """Close the loop on the fitted recordings of a pair; errors on the others.

    Parameters
    ----------
    recording : Recording
        All recordings of the set.
    identifier : RobotIdentifier
        The declared model.
    scale : Scale
        Of the set.
    pair : tuple of (str, tuple of str, tuple of str)
        Label, names fitted, names judged.
    **settings
        Arguments of `EffectDiscovery`.

    Returns
    -------
    dict
        Errors over the spread of the torque, which joints count, what was found.
    """
    _, fitted, judged = pair
    verdict = judge(recording, identifier, scale, *pair, **settings)
    plain = least_squares(
        identifier, recording.select(*fitted), recording.select(*judged)
    )
    return {
        "least_squares": (plain / scale.spread).tolist(),
        "completed": (verdict.after / scale.spread).tolist(),
        "counted": verdict.counted.tolist(),
        "effects": list(verdict.effects),
        "perhaps": list(verdict.perhaps),
        "seconds": verdict.seconds,
    }


def judge_held_out(parts, identifier, **settings):
    """Close the loop on a motion; errors on the part that it holds out.

    Parameters
    ----------
    parts : tuple of ndarray
        Positions, torques and labels.
    identifier : RobotIdentifier
        The declared model.
    **settings
        Arguments of `EffectDiscovery`.

    Returns
    -------
    dict
        As of `judge_pair`.
    """
    found = judge_set(*parts, identifier, names=("WLS",), **settings)
    completed = found["errors"]["completed"]
    return {
        "least_squares": found["errors"]["WLS"],
        "completed": completed,
        "counted": [True] * len(completed),
        **{
            what: [f"{name} {joint + 1}" for name, joint in found[what]]
            for what in ("effects", "perhaps")
        },
        "seconds": found["seconds"],
    }


def cases_of(name, data_home=None, recording=None):
    """Return label -> function that judges a pair of a set, see `judge_pair`.

    Parameters
    ----------
    name : str
        Set.
    data_home : str or None
        Folder of the measured sets.
    recording : Recording or None
        In place of a measured one with several motions, for a trial at small size.
    """
    if name in HELD_OUT_SETS:
        recording, rows, identifier = load(name, data_home)
        parts = recording.q[rows], recording.tau[rows], recording.groups[rows]
        return {HELD_OUT: functools.partial(judge_held_out, parts, identifier)}
    frozen = PAIRED_SETS[name]
    recording = recording or frozen.recording(data_home)
    identifier = frozen.identifier(recording.robot_model(), recording.dt)
    scale = measure_scale(recording, identifier)
    return {
        pair[0]: functools.partial(judge_pair, recording, identifier, scale, pair)
        for pair in pairs(recording.group_names, frozen.leave_out)
    }


def task_of(settings, name, label):
    """Task of a pair with some settings, a dict with `KEYS`."""
    values = [list(item) for item in sorted(SETTINGS[settings].items())]
    return dict(zip(KEYS, (settings, values, name, label), strict=True))


def run_set(name, chosen, ledger, data_home=None, recording=None, **extra):
    """Judge the pairs of a set with all settings, those that the ledger lacks.

    Parameters
    ----------
    name : str
        Set.
    chosen : sequence of str
        Settings, keys of `SETTINGS`.
    ledger : Ledger
        Results.
    data_home, recording : str or None, Recording or None
        See `cases_of`.
    **extra
        Further arguments of `EffectDiscovery`.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cases = cases_of(name, data_home, recording)
        tasks = [task_of(one, name, label) for label in cases for one in chosen]
        for task in ledger.missing(tasks):
            settings = arguments_of(SETTINGS[task["settings"]])
            started = time.perf_counter()
            try:
                found = cases[task["pair"]](**settings, **extra)
            except Exception as error:  # shown, and these settings are not the best
                found = {
                    "error": f"{type(error).__name__}: {error}",
                    "seconds": time.perf_counter() - started,
                }
            ledger.add({**task, **found})
            print(line(ledger.results[-1]), flush=True)


# -- figures ---------------------------------------------------------------------------


def _means(result, counted=True):
    """Return mean errors of least squares and of the completed model over joints."""
    errors = np.array([result["least_squares"], result["completed"]], dtype=float)
    use = np.isfinite(errors).all(axis=0)
    if counted:
        use &= np.array(result["counted"])
    return errors[:, use].mean(axis=1) if use.any() else np.full(2, np.nan)


def ratio(result, counted=True):
    """Ratio of a pair over the joints that count, or all; infinite for an error."""
    if "error" in result:
        return np.inf
    plain, completed = _means(result, counted)
    return float(completed / plain)


def _finite_mean(values):
    """Mean of what is not nan."""
    values = [x for x in values if not np.isnan(x)]
    return float(np.mean(values)) if values else np.nan


def ratios(results):
    """Ratios by settings and set: dict of dicts.

    Infinite where a pair ended in an error; nan where no pair counts, or where pairs
    are missing that other settings have.
    """
    wanted, own = {}, {}
    for r in results:
        wanted.setdefault(r["set"], set()).add(r["pair"])
        own.setdefault(_label(r), {}).setdefault(r["set"], {})[r["pair"]] = ratio(r)
    return {
        label: {
            name: _finite_mean(by_pair.values())
            if (by_pair := sets.get(name, {})).keys() == labels
            else np.nan
            for name, labels in wanted.items()
        }
        for label, sets in own.items()
    }


def _label(result):
    """Name the settings of a result, with their values unless they are `SETTINGS`."""
    values = dict(result["values"])
    if values == SETTINGS.get(result["settings"]):
        return result["settings"]
    told = ", ".join(f"{name} = {value}" for name, value in values.items())
    return f"{result['settings']} ({told})"


def best_on_the_others(found, name):
    """Return the settings with the lowest mean ratio on all sets but one.

    Parameters
    ----------
    found : dict of dict
        What `ratios` returns.
    name : str
        Set that is left out.

    Returns
    -------
    str or None
        Settings, the first of equal ones; None where none has results on the sets that
        others have.
    """
    countable = {
        s for sets in found.values() for s, x in sets.items() if np.isfinite(x)
    } - {name}
    means = {
        label: np.mean([sets[s] for s in countable])
        for label, sets in found.items()
        if countable and not any(np.isnan(sets[s]) for s in countable)
    }
    return min(means, key=means.get) if means else None


# -- report ----------------------------------------------------------------------------


def line(result):
    """One line about one pair."""
    start = f"{result['set']}, {result['pair']}, {result['settings']}"
    if "error" in result:
        return f"{start}: {result['error']}"
    found = ", ".join(result["effects"]) or "nothing"
    perhaps = ", ".join(result["perhaps"]) or "nothing"
    return (
        f"{start}: {ratio(result):.2f}; {found}; perhaps {perhaps}; "
        f"{result['seconds']:.0f} s"
    )


def _told(value):
    """Two digits, a dash for what is not there, a word for an error."""
    return "failed" if np.isinf(value) else fixed([value], 2)[0]


def _numbers(results):
    """Numbers of names and of what is left open, as a cell."""
    totals = (
        sum(len(r.get(what, ())) for r in results) for what in ("effects", "perhaps")
    )
    return " / ".join(map(str, totals))


SUMMARY = [
    "set",
    "pairs",
    "counted",
    "least squares [%]",
    "completed [%]",
    "ratio",
    "ratio, best on the other sets",
    "these settings",
    "names / perhaps",
]


def summary(results, found):
    """Rows of the first table: a set each, then their mean."""
    rows, defaults, chosen = [], [], []
    for name in dict.fromkeys(r["set"] for r in results):
        own = [r for r in results if r["set"] == name and _label(r) == DEFAULT]
        here = found.get(DEFAULT, {}).get(name, np.nan)
        best = best_on_the_others(found, name)
        there = found[best][name] if best else np.nan
        known = [_means(r) for r in own if np.isfinite(ratio(r))]
        errors = 100 * np.mean(known, axis=0) if known else np.full(2, np.nan)
        defaults.append(here)
        chosen.append(there)
        rows.append(
            [
                name,
                len(own),
                len(known),
                *fixed(errors),
                _told(here),
                _told(there),
                best or "–",
                _numbers(own),
            ]
        )
    means = [_told(_finite_mean(x)) for x in (defaults, chosen)]
    default = [r for r in results if _label(r) == DEFAULT]
    rows.append(["mean", *[""] * 4, *means, "", _numbers(default)])
    return rows


def grid(found, names):
    """Rows of the second table: settings with their ratio on each set."""
    rows = []
    for label, sets in found.items():
        values = [sets[name] for name in names]
        rows.append([label, *map(_told, values), _told(_finite_mean(values))])
    return rows


PAIRS = [
    "set",
    "judged",
    "ratio",
    "ratio, all joints",
    "least squares, each joint [%]",
    "completed, each joint [%]",
    "names / perhaps",
    "s",
]


def pair_rows(results):
    """Rows of the third table: pairs with the defaults, joints not counted in ()."""
    rows = []
    for r in results:
        if _label(r) != DEFAULT:
            continue
        cells = ["–", "–"]
        if "error" not in r:
            cells = [
                " ".join(
                    cell if use else f"({cell})"
                    for cell, use in zip(
                        fixed(100 * np.array(r[what])), r["counted"], strict=True
                    )
                )
                for what in ("least_squares", "completed")
            ]
        rows.append(
            [
                r["set"],
                r["pair"],
                _told(ratio(r)),
                _told(ratio(r, counted=False)),
                *cells,
                _numbers([r]),
                f"{r['seconds']:.0f}",
            ]
        )
    return rows


def report(results):
    """Text with the tables."""
    found = ratios(results)
    names = list(dict.fromkeys(r["set"] for r in results))
    parts = [
        "Errors over the spread of the torque, mean over the joints that count; ratio: "
        "completed over least squares with the four plain terms; pairs, counted, "
        "errors and names are those with the defaults.",
        rst_table(summary(results, found), SUMMARY),
        rst_title("Settings"),
        rst_table(grid(found, names), ["settings", *names, "mean"]),
        rst_title("Pairs"),
        "With the defaults; in brackets: joints whose judged range was not fitted.",
        rst_table(pair_rows(results), PAIRS, n_labels=2),
    ]
    for r in results:
        if _label(r) == DEFAULT and "error" not in r:
            names = ", ".join(r["effects"]) or "nothing"
            perhaps = f"; perhaps {', '.join(r['perhaps'])}" if r["perhaps"] else ""
            parts.append(f"{r['set']}, {r['pair']}: {names}{perhaps}.")
    parts += [
        f"{r['set']}, {r['pair']}, {_label(r)}, failed: {r['error']}"
        for r in results
        if "error" in r
    ]
    return "\n\n".join(parts)


def main(argv=None):
    """Print the tables."""
    arguments = parser(__doc__.splitlines()[0])
    arguments.add_argument(
        "--data", nargs="+", choices=SETS, default=SETS, help="some of the sets"
    )
    arguments.add_argument(
        "--settings", nargs="+", choices=SETTINGS, default=list(SETTINGS)
    )
    arguments.add_argument("--data-home", default=None, metavar="DIR")
    arguments.add_argument(
        "--out", nargs="+", metavar="FILE", help="results so far, as JSON lines"
    )
    arguments.add_argument(
        "--table", action="store_true", help="run nothing, show what the files hold"
    )
    arguments = arguments.parse_args(argv)
    ledger = Ledger(arguments.out, KEYS)
    if not arguments.table:
        for name in arguments.data:
            run_set(name, arguments.settings, ledger, arguments.data_home)
    results = [r for name in SETS for r in ledger.results if r["set"] == name]
    if not results:
        raise SystemExit("No pair was judged, and the files hold none.")
    publish(
        "leave_one_set_out",
        report(results),
        write=arguments.write,
        states=ledger.states(),
    )


if __name__ == "__main__":
    main()
