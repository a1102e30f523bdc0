"""Write ``docs/evidence.md`` from the tables in ``docs/tables``.

Run ``python docs/evidence.py`` after a benchmark has written a table; with ``--check``
it writes nothing, ends with exit code 1 if the page differs, and names the tables that
other code than today's made, which are an error with ``--fresh``. Every figure of the
page is read from ``docs/tables/NAME.json``.
"""

import argparse
import re
import sys
from math import exp, log
from pathlib import Path
from statistics import median

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

import recorded

PAGE = Path(__file__).with_name("evidence.md")
INTRODUCTION = """\
<!-- Written by docs/evidence.py from docs/tables. Do not edit. -->

# Evidence

Each section answers one question with a verdict, a table and its limitations.
Torque errors are normalised RMS errors: RMSE / standard deviation of the torque.
Errors of simulated positions are relative to a robot that stays where it is.
Splits and filters differ between the sections, and so do figures of the same data set.
The script below each table reproduces it, and the commit names the version of the
package that made it; not all tables are from the present version.
`tests/benchmarks/README.md` describes the studies.
*Declared* is the model before the search (viscous friction unless stated), *four terms*
has viscous and Coulomb friction, offset and rotor inertia, and *completed* is the model
after the search.
"""


class Tables:
    """The tables of one file, with their figures."""

    def __init__(self, name):
        self.name = name
        self.tables = recorded.read_tables(name)

    def table(self, number=1, columns=None, rows=None, names=None):
        """Return a table of Markdown; `names` maps columns to their headings."""
        chosen = self.tables[number - 1].chosen(columns, rows)
        names = names or {}
        headers = [names.get(header, header) for header in chosen.headers]
        lines = [headers, ["---"] * len(headers), *chosen.rows]
        return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)

    def column(self, header, number=1, rows=None):
        """Return the numbers of a column, a dict by the first cell."""
        table = self.tables[number - 1].chosen([self.first(number), header], rows)
        return {first: number_of(cell) for first, cell in table.rows}

    def first(self, number=1):
        """Return the heading of the first column."""
        return self.tables[number - 1].headers[0]

    def cell(self, row, header, number=1):
        """Return the text of a cell."""
        table = self.tables[number - 1]
        place = table.headers.index(header)
        (found,) = {cells[place] for cells in table.rows if cells[0] == row}
        return found

    def source(self):
        """Return script and commits, a line of Markdown."""
        return recorded.made(self.name)


def number_of(cell):
    """Return the number that a cell begins with, nan if there is none."""
    try:
        return float(cell.replace("%", "").split("±")[0])
    except ValueError:
        return float("nan")


def span(values, digits=1):
    """Return the lowest and the highest value as "LOW to HIGH"."""
    low, high = min(values), max(values)
    return f"{low:.{digits}f} to {high:.{digits}f}"


# -- sections, functions that return (question, verdict, tables, limitations) ----------


def published():
    """Show EMPS by its authors' protocol."""
    data = Tables("protocol_emps")
    rows = ("published, least squares", "the same, repeated here")
    models = data.tables[0].rows
    by_positions = [row for row in models if row[1] == "positions"]
    judged = {row[0]: row[3] for row in by_positions}
    completed = judged["EffectDiscovery, completed model"]
    verdict = (
        "On EMPS, a linear axis, by the protocol of its authors, the completed model "
        "reduces the force error on the second recording from "
        f"{data.cell(rows[0], 'judged recording [%]')} % "
        f"to {completed} %."
    )
    limitation = (
        "EMPS was used during development, and a single axis has no coupling between "
        "joints "
        "and no gravity."
    )
    return "Is a published error reduced?", verdict, data, data.table(), limitation


def measured():
    """Show ten measured sets."""
    confirmed, developed = map(
        Tables, ("measured_sets_confirmation", "measured_sets_development")
    )
    columns = ["set", "declared", "four terms", "completed", "WLS", "LASSO"]
    columns += ["stepwise", "IDIM-IV"]
    sets = [
        [row[0] for row in data.tables[0].rows if row[0] != "mean"]
        for data in (developed, confirmed)
    ]
    ratios = []
    for data, names in zip((developed, confirmed), sets):
        plain, completed = (
            data.column(header, rows=names) for header in ("four terms", "completed")
        )
        ratios += [completed[name] / plain[name] for name in names]
    better, little = sum(r < 0.9 for r in ratios), sum(r > 0.99 for r in ratios)
    verdict = (
        f"On {better} of {len(ratios)} measured robots the effects reduce the held-out "
        f"error by more than a tenth relative to the four terms; on {little} it falls "
        "by less than 1 % or rises. The median ratio of the errors is "
        f"{median(ratios):.2f}."
    )
    table = developed.table(columns=columns, rows=sets[0])
    table += "\n" + "\n".join(
        confirmed.table(columns=columns, rows=sets[1]).split("\n")[2:]
    )
    limitation = (
        "All ten sets were used while the search was developed, the last five of the "
        "table a few times; no set was judged that nobody had looked at before. Where "
        "the completed model has friction with memory (UR5), rows at rest count in all "
        "errors, and the other models do not predict them."
    )
    question = "What is the held-out error on measured robots?"
    return question, verdict, (developed, confirmed), table, limitation


def field():
    """Show other programs on eleven measured sets."""
    data = Tables("field")
    first = {}
    for estimator in ("RobotIdentifier", "EffectDiscovery"):
        for what in ("torque", "positions"):
            ours = data.column(f"{what} [%], {estimator}")
            theirs = data.column(f"{what} [%], best rival")
            first[estimator, what] = sum(ours[k] <= theirs[k] for k in ours)
        count = len(data.tables[0].rows)
    positions = [
        data.column(f"positions [%], {by}")
        for by in ("RobotIdentifier", "EffectDiscovery", "best rival")
    ]
    lost = [k for k in positions[0] if min(found[k] for found in positions) >= 100]
    resting = "On every set at least one method"
    if lost:
        resting = f"On {', '.join(lost)} no method"
    verdict = (
        "Compared with scikit-learn regressors, FIGAROH, mujoco.sysid and CMA-ES, "
        "`EffectDiscovery` has the lowest torque error on "
        f"{first['EffectDiscovery', 'torque']} of {count} sets and the lowest "
        "simulated "
        f"position error on {first['EffectDiscovery', 'positions']}."
    )
    torque = [
        data.column(f"torque [%], {by}")
        for by in ("RobotIdentifier", "EffectDiscovery")
    ]
    worse = [k for k in torque[0] if torque[1][k] > 1.05 * torque[0][k]]
    limitation = (
        f"Without the search, `RobotIdentifier` has the lowest torque error on "
        f"{first['RobotIdentifier', 'torque']} sets only. On "
        f"{', '.join(worse) or 'no set'} the search raises the error by more than 5 %. "
        f"{resting} simulates a second of motion better than a robot at rest."
    )
    return (
        "How does it compare with other programs?",
        verdict,
        data,
        data.table(),
        limitation,
    )


def tx40():
    """Show the TX40 by the protocol of FIGAROH."""
    data = Tables("protocol_tx40")
    rows = ["FIGAROH, as published", "declared model", "completed by EffectDiscovery"]
    mean = data.column("mean")
    verdict = (
        "On the Stäubli TX40, by FIGAROH's protocol, the mean torque error is "
        f"{mean[rows[2]]:.2f} N m after the search, {mean[rows[1]]:.2f} N m before "
        "it, and "
        f"{mean[rows[0]]:.2f} N m as published."
    )
    limitation = (
        "The published figures were not reproduced by running FIGAROH, and the "
        "coupling of "
        "joints 5 and 6, which makes the difference, was known from the publication."
    )
    question = "Does the search find a published coupling?"
    return question, verdict, data, data.table(rows=rows), limitation


def pairs():
    """Show recordings that were not fitted."""
    developed, confirmed = (
        Tables(f"protocol_pairs_{stage}") for stage in ("development", "confirmation")
    )
    columns = ["set", "counted", "declared, median [%]", "completed, median [%]"]
    columns += ["completed worse than declared", "judged / reported, median"]
    names = {"counted": "joints counted", columns[4]: "completed worse"}
    names[columns[5]] = "error there / held-out error here, median"
    table = developed.table(columns=columns, names=names)
    table += "\n" + "\n".join(confirmed.table(columns=columns).split("\n")[2:])
    worse = {
        key: value
        for data in (developed, confirmed)
        for key, value in data.column(columns[4]).items()
    }
    counted = sum(
        sum(data.column("counted").values()) for data in (developed, confirmed)
    )
    verdict = (
        "On recordings left out of the fit, the completed model is worse than the "
        "declared "
        f"one on {sum(worse.values()):.0f} of {counted:.0f} joints, all of them in "
        f"{', '.join(key for key, value in worse.items() if value) or 'no set'}."
    )
    limitation = (
        "On the UR5 the median error of the completed model is "
        f"{developed.cell('ur5', columns[3])} %, that of the declared one "
        f"{developed.cell('ur5', columns[2])} %."
    )
    question = "Does the completed model hold on recordings that were not fitted?"
    return question, verdict, (developed, confirmed), table, limitation


def false_alarms():
    """Show robots that lack nothing."""
    data = Tables("false_alarms")
    columns = ["residual", "joints", "recordings", "false alarms, %", "any perhaps, %"]
    columns += ["found, %"]
    rows = ["white, 40 s", "AR(1), 0.5 s, 40 s", "AR(1), 5 s, 40 s"]
    rows += [
        "random walk, 40 s",
        "random walk, 60 s",
        "torque times AR(1) of 8 s, 40 s",
    ]
    rows += ["torque times AR(1) of 8 s, 60 s", "all"]
    names = {
        "false alarms, %": "with a reported effect [%]",
        "any perhaps, %": "with a possible effect [%]",
        "found, %": "true effect found [%]",
    }
    verdict = (
        f"Of {data.cell('all', 'recordings')} simulated recordings with a correct "
        "model, "
        f"{data.cell('all', 'false alarms, %')} % have a reported effect (target: at "
        "most "
        f"5 %); with one effect added, it is found in {data.cell('all', 'found, %')} %."
    )
    limitation = (
        "Slow disturbances are the worst case. With six joints, "
        f"{data.cell(rows[4], 'false alarms, %')} % of the recordings with a random "
        "walk and "
        f"{data.cell(rows[6], 'false alarms, %')} % of those with a slowly varying "
        "torque "
        f"gain have a reported effect ({data.cell(rows[4], 'recordings')} recordings "
        "each), and the payload is found "
        "in "
        f"{data.cell('payload', 'found, %', 2)} % only. Of the reported effects "
        f"{data.cell('named', 'right, %', 3)} % are right, of those that are listed as "
        f"possible {data.cell('perhaps, all', 'right, %', 3)} %. The table shows some "
        "of the disturbances."
    )
    table = data.table(columns=columns, rows=rows, names=names)
    return (
        "How often is an effect reported that is not there?",
        verdict,
        data,
        table,
        limitation,
    )


def whole_robots():
    """Show six joints with three further effects each."""
    data = Tables("whole_robots_confirmation")
    columns = ["declared friction", "robots", "joints within 1 %", "joints within 3 %"]
    columns += ["largest", "effects named", "names right"]
    names = {"effects named": "effects reported", "names right": "reports correct"}
    names["largest"] = "largest error"
    row = "viscous and coulomb"
    verdict = (
        f"On {data.cell(row, 'robots')} simulated six-axis robots with three to six "
        f"effects besides friction, {data.cell(row, 'effects named')} of the effects "
        "are reported and "
        f"{data.cell(row, 'names right')} of the reports are correct."
    )
    limitation = (
        "The simulator shares no code with the package, but the effects are those "
        "of the "
        f"library; the largest error is {data.cell(row, 'largest')} (target: 3 %)."
    )
    table = data.table(columns=columns, names=names)
    return "Are the reported effects correct?", verdict, data, table, limitation


def single_effects():
    """Show one effect at a time."""
    data = Tables("single_effects_confirmation")
    columns = ["size", "cases", "named", "lower bound", "target"]
    columns += ["of these as a rival", "with another name"]
    names = {
        "size": "size / noise",
        "named": "found",
        "of these as a rival": "of these, as a rival",
        "with another name": "another effect reported",
    }
    named = data.column("named")
    three = data.tables[2].rows[1]
    each = data.column("cases")["0.5"] / len(data.tables[1].rows)
    verdict = (
        "An effect whose torque is half the noise is found in "
        f"{named['0.5']:.0f} % of the cases, one of twice the noise in "
        f"{named['2']:.0f} %."
    )
    limitation = (
        f"Three effects at once are all found in {three[2]} of the cases (target: "
        f"{three[4]}), and each kind of effect has {each:.0f} cases per size only."
    )
    table = data.table(columns=columns, names=names)
    return "How small an effect is found?", verdict, data, table, limitation


def friction_memory():
    """Show friction with memory."""
    data = Tables("friction_memory")
    middle, largest = data.column("error over the noise, median"), data.column("worst")
    names, wrong = data.column("names"), data.column("wrong names")
    four = "the four with memory"
    verdict = (
        "On four laws of friction with memory the torque error of the next 40 s is "
        f"{middle[four]:.2f} times that of the noise in the median and "
        f"{largest[four]:.1f} times at worst; {wrong['all']:.0f} of "
        f"{names['all']:.0f} names on all laws are wrong."
    )
    limitation = (
        "The arms have two joints and 40 s of data, and often move further afterwards "
        "than in the fit. A law that the library lacks may be named as the closest one."
    )
    question = "Is friction that depends on the past motion modelled?"
    return question, verdict, data, data.table(), limitation


def geometry():
    """Show faults of the geometry and of the channels."""
    data = Tables("geometry_confirmation")
    columns = [
        "kind",
        "cases",
        "all named",
        "as one of the class",
        "with another wrong name",
    ]
    names = {
        "kind": "fault",
        "all named": "found",
        "as one of the class": "as an equivalent fault",
        "with another wrong name": "with a wrong report",
    }
    found = data.column("all named", rows=["tilt", "zero", "axis", "gain"])
    faults = {"tilt": "tilt", "zero": "encoder zero", "axis": "axis", "gain": "gain"}
    in_interval = data.column("in their interval", 2, rows=list(faults))
    cases = data.column("cases", rows=list(faults))
    worst = min(in_interval, key=in_interval.get)
    least = min(found.values())
    share = "all" if least == 100 else f"at least {least:.0f} % of the"
    verdict = (
        "A tilted base, a wrong encoder zero, a misaligned axis or a wrong torque "
        "gain is "
        f"found in {share} cases."
    )
    limitation = (
        f"There are {min(cases.values()):.0f} cases per fault, and 90 % intervals of "
        f"the {faults[worst]} contain the true value in {in_interval[worst]:.0f} % of "
        "them."
    )
    question = "Are wrong geometry and wrong channels found?"
    return question, verdict, data, data.table(columns=columns, names=names), limitation


def coverage():
    """Show intervals."""
    data = Tables("interval_coverage")
    table = data.tables[0]
    pooled, lines = {}, []
    for kind in dict.fromkeys(row[0] for row in table.rows):
        rows = [row for row in table.rows if row[0] == kind]
        count = sum(int(row[4]) for row in rows)
        held = [number_of(row[5]) for row in rows]
        pooled[kind] = sum(h * int(row[4]) for h, row in zip(held, rows)) / count
        lines.append(f"| {kind} | {count} | {pooled[kind]:.1f} | {span(held)} |")
    verdict = (
        "Nominal 90 % intervals contain the true value in "
        f"{pooled['parameters']:.1f} % of the cases for parameters, "
        f"{pooled['effects']:.1f} % for parameters of effects, and "
        f"{pooled['error after']:.1f} % for errors."
    )
    limitation = (
        "Four effects of the library were tried, with one to three joints; "
        "descriptions are wrong by 20 %."
    )
    head = (
        "| interval of | intervals | contain the true value [%] | single settings [%] |"
    )
    shown = "\n".join([head, "| --- | --- | --- | --- |", *lines])
    return "Do the intervals hold?", verdict, data, shown, limitation


def next_recording():
    """Show errors of later recordings."""
    data, inside = Tables("next_recording"), "in their interval [%]"
    columns = ["differences", "effects searched", "cases", "judged / promised, median"]
    columns += ["least", "judged / held-out, median", inside]
    columns += ["upper / lower end"]
    names = {
        "differences": "variation between recordings",
        "effects searched": "search",
        "judged / promised, median": "actual / predicted error, median",
        "judged / held-out, median": "actual / held-out error, median",
        inside: "joints in their interval [%]",
    }
    ratios = [number_of(row[3]) for row in data.tables[0].rows]
    least, largest = (number_of(data.tables[0].rows[0][k]) for k in (4, 5))
    simulated = data.tables[1]
    shares = dict(
        zip(simulated.column("differing"), map(number_of, simulated.column(inside)))
    )
    ranked = [f"{shares[x]:.0f} % ({x})" for x in sorted(shares, key=shares.get)]
    verdict = (
        f"The actual error on the next recording is {span(ratios, 2)} of what the "
        "report predicts, in the median. "
        f"In simulated sets, {ranked[0]} to {ranked[-1]} of the errors are in their "
        "90 % interval, by what differs between the recordings (by 10 or 25 %)."
    )
    columns.insert(5, data.tables[0].headers[5])
    names |= {"least": "lowest", data.tables[0].headers[5]: "highest"}
    limitation = (
        "For a single recording the prediction rests on an assumed variation and is "
        f"off by a factor of up to {max(largest, 1 / least):.1f}; it was derived from "
        "these same sets. "
        "A single recording cannot tell that the next one has another payload."
    )
    table = data.table(columns=columns, names=names)
    cells = ["differing", "sets", inside, "joints [%]", "upper / lower end"]
    cells += ["difference named [%]", "another named [%]"]
    names = {
        inside: "means in their interval [%]",
        "joints [%]": "joints in theirs [%]",
    }
    table += "\n\n" + data.table(2, cells, names=names)
    table += "\n\n" + data.table(3, ["recordings", *cells[1:]], names=names)
    question = "Is the error on the next recording predicted?"
    return question, verdict, data, table, limitation


def repetition():
    """Show motions that repeat."""
    data = Tables("repetition")
    columns = [
        "row",
        "recordings",
        "any name [%]",
        "any perhaps [%]",
        "effect named [%]",
    ]
    names = {
        "row": "recording",
        "any name [%]": "with a reported effect [%]",
        "any perhaps [%]": "with a possible effect [%]",
        "effect named [%]": "true effect reported [%]",
    }
    sound = [row for row in data.tables[0].rows if not row[0].startswith("power")]
    count = sum(int(row[1]) for row in sound)
    false = sum(round(int(row[1]) * number_of(row[2]) / 100) for row in sound)
    verdict = (
        "If motion and disturbance repeat together, an effect is reported in "
        f"{false} of {count} recordings that lack nothing."
    )
    limitation = "The disturbances are sums of harmonics of the motion's period."
    question = "Are repeated disturbances reported as effects?"
    return question, verdict, data, data.table(columns=columns, names=names), limitation


def bodies():
    """Show wrong descriptions."""
    data = Tables("bodies")
    columns = ["robots", "motion", "error of", "prior", "free", "fixed"]
    names = {name: f'bodies="{name}" [%]' for name in ("prior", "free", "fixed")}
    ratio = {}
    for other in ("free", "fixed"):
        logs = [
            log(float(row[3]) / float(row[4 + (other == "fixed")]))
            for row in data.tables[0].rows
        ]
        ratio[other] = exp(sum(logs) / len(logs))
    found = data.tables[2].rows[0]
    verdict = (
        'If the description is wrong by 20 %, `bodies="prior"` has '
        f"{ratio['free']:.2f} times the error of a fit that ignores the description "
        "and "
        f"{ratio['fixed']:.2f} times that of a fit that trusts it (geometric means)."
    )
    limitation = (
        f"A body that is wrong by a factor of two is identified on {found[3]} % of the "
        "robots whose motion shows it (target: 90 %)."
    )
    question = "How much do wrong masses in the description matter?"
    return question, verdict, data, data.table(columns=columns, names=names), limitation


def quadruped():
    """Show ten runs of one quadruped."""
    data = Tables("unitree_go2")
    headers = data.tables[0].headers
    columns = [*headers[:4], *headers[7:9], headers[10]]
    names = {headers[1]: "shared drives"}
    rows = {tuple(row[:2]): row for row in data.tables[0].rows}
    prior, free = rows["prior", "yes"], rows["free", "no"]
    described = re.search(r"description: ([0-9.]+) kg", recorded.read(data.name))[1]
    verdict = (
        f"Ten runs of a Unitree Go2, fitted one by one, give masses of {prior[7]} to "
        f'{prior[8]} kg with `bodies="prior"` and shared drives (description: '
        f"{described} kg) "
        f'and {free[7]} to {free[8]} kg with `bodies="free"` and separate drives.'
    )
    limitation = (
        "The true values of this robot are unknown, and all runs repeat one motion. "
        "Ranges for simulators follow from seven runs; the values of the other three, "
        "each fitted alone, are uncertain themselves."
    )
    ranged = {"in their ranges [%]": "of left-out runs in the ranges [%]"}
    ranged["and deviations [%]"] = "with their own deviation [%]"
    table = data.table(columns=columns, names=names)
    table += "\n\n" + data.table(2, names=ranged)
    return "Do identified values repeat between runs?", verdict, data, table, limitation


def commands():
    """Show robots without torque sensors."""
    data = Tables("commands_confirmation_5183")
    columns = [
        "way",
        "robots",
        "armature [%]",
        "damping [%]",
        "Coulomb [%]",
        "delay [ms]",
    ]
    rows = ["package, drive", "least squares, no delay", "least squares, grid"]
    rows += ["instrumental variables", "CMA-ES"]
    get = data.cell
    verdict = (
        f"On {get(rows[0], 'robots')} simulated quadrupeds, identified from position "
        f"commands, the median errors are {get(rows[0], columns[2])} % (armature), "
        f"{get(rows[0], columns[3])} % (damping), {get(rows[0], columns[4])} % "
        "(Coulomb "
        f"friction) and {get(rows[0], columns[5])} ms (delay); instrumental "
        "variables have "
        f"{get(rows[3], columns[2])} %, {get(rows[3], columns[3])} %, "
        f"{get(rows[3], columns[4])} % and {get(rows[3], columns[5])} ms."
    )
    measured = Tables("commands_measured")
    scatter = measured.cell("package, drive", measured.tables[0].headers[5])
    limitation = (
        "The gains of the control loop were known exactly; on a measured Go2 the "
        "armatures "
        f"scatter by {scatter} % between runs that are fitted one by one "
        "(`docs/tables/commands_measured.rst`)."
    )
    table = data.table(columns=columns, rows=rows, names={"way": "method"})
    question = "How accurate is an identification without torque sensors?"
    return question, verdict, data, table, limitation


def ranges():
    """Show ranges for simulators."""
    data = Tables("ranges")
    headers = data.tables[0].headers
    shares = [number_of(cell) for row in data.tables[0].rows for cell in row[2:5]]
    alone = [number_of(row[6]) for row in data.tables[0].rows]
    verdict = (
        "90 % ranges of armature, damping and dry friction contain the value of a "
        "left-out "
        f"recording in {span(shares, 0)} % of the cases; ranges from noise alone "
        "contain it "
        f"in {span(alone, 0)} %."
    )
    names = {
        headers[1]: "scatter between recordings [%]",
        headers[6]: "noise alone [%]",
    }
    limitation = (
        "With two recordings the range follows from the prior more than from the "
        "data, and "
        "the recordings must differ as the future ones will."
    )
    question = "Do the ranges for domain randomisation hold?"
    return question, verdict, data, data.table(names=names), limitation


def changed_logs():
    """Show faults that were put into sound logs."""
    data = Tables("log_hypotheses")
    (sound, *changed), done_to, whole = (table.rows for table in data.tables)
    counts = [
        [sum(map(int, cells)) for cells in zip(*(row[1:] for row in rows))]
        for rows in (changed, done_to)
    ]
    (logs, _, right, *_, wrong), (others, seen, named, *_, false) = counts
    sets = [set(row[1:]) == {"none"} for row in whole]
    verdict = (
        f"Of {logs} simulated logs with one fault, {right} are named correctly and "
        f"{wrong} wrongly; of {others} logs of measured robots with one fault ({seen} "
        f"visible), {named} and {false}. The others are not named or left undecided. "
        f"{sound[5]} of {sound[1]} sound logs have no finding, and {sum(sets)} of "
        f"{len(sets)} measured sets have none, whole and in halves."
    )
    limitation = (
        "A fault is visible if the likelihood of the true robot decides for it; the "
        "wrong zero of a single joint, a flipped joint and a moderate factor of the "
        "torques often are not."
    )
    question = "Are faults of a log named?"
    shown = (
        f"{data.table()}\n\nMeasured robots:\n\n{data.table(2)}\n\n"
        f"Findings in measured sets as they are:\n\n{data.table(3)}"
    )
    return question, verdict, data, shown, limitation


def gravity():
    """Show gravity compensation from poses."""
    data = Tables("gravity")
    held = data.column("inside 90 % intervals [%]")
    largest = data.column("largest")
    ratio = data.column("ratio", 2)
    better = sum(x <= 0.8 for x in ratio.values())
    slightly = sum(0.8 < x < 1 for x in ratio.values())
    worse = " and ".join(name for name, x in ratio.items() if x >= 1)
    verdict = (
        "Poses reached from both sides reduce the error of the gravity torque at other "
        f"poses to at most {largest['both sides']:.2f} of the described model's error; "
        f"90 % intervals contain the true torque in {span(held.values())} % of the "
        "cases."
    )
    limitation = (
        "The arms of the first table are simulated, with dry friction that does not "
        "vary with the pose. Of the measured sets, whose motions were not made for it, "
        f"{better} improve by 20 % or more and {slightly} by less; on {worse} the "
        "correction is no better than the description."
    )
    question = "Do poses correct a description for gravity compensation?"
    shown = f"{data.table()}\n\n{data.table(2)}"
    return question, verdict, data, shown, limitation


def known_noise():
    """Show a regression with known input noise."""
    data = Tables("known_noise")
    rows = {tuple(row[:2]): row for row in data.tables[0].rows}
    every, quarter = rows["smoothness", "all"], rows["smoothness", "1 in 4"]
    verdict = (
        f"If {every[2]} % of the variance of an input is noise, least squares "
        "estimates its "
        f"coefficient as {every[3]} and `VBJFARegressor` as {every[4]}; with a "
        "quarter of "
        f"the measurements the estimates are {quarter[3]} and {quarter[4]}."
    )
    asked = data.tables[1].rows
    limitation = (
        f"Predictions for equally noisy inputs do not improve ({asked[0][1]} and "
        f"{asked[0][2]} % squared error), and the noise of the inputs has to be "
        "known and "
        "independent."
    )
    question = "Does known input noise change a regression?"
    return question, verdict, data, data.table(), limitation


def ordinary_tables():
    """Show tables without a robot."""
    data = Tables("ordinary_tables")
    *tables, means = data.tables[0].rows
    worst = max(tables, key=lambda row: float(row[1]))
    verdict = (
        f"On {len(tables)} tables the held-out error of `VBJFARegressor` is {means[1]} "
        "times that of the best of four linear models of scikit-learn (geometric "
        f"mean); theirs are {means[2]}, {means[3]}, {means[4]} and {means[5]} times."
    )
    limitation = (
        f"The largest ratio is {worst[1]} ({worst[0]}); LassoCV is best where few of "
        "many inputs matter."
    )
    question = "Is the default a good regression on ordinary tables?"
    return question, verdict, data, data.table(), limitation


def paper():
    """Show the robots of the paper."""
    data = Tables("paper_robots")
    columns = ["method", "position [rad]", "velocity [rad/s]", "feedback [N m]"]
    rows = ["URDF, not identified", "ridge", "LASSO", "VB-JFA, the paper's"]
    rows += [
        "VB, correlated inputs",
        "completed by EffectDiscovery",
        "the robot itself",
    ]
    get = data.cell
    verdict = (
        "In simulations of the paper's vision head the advantage of Bayesian "
        "regression "
        f"does not appear: the feedback torque is {get(rows[4], columns[3])} N m "
        "with it and "
        f"{get(rows[1], columns[3])} N m with ridge regression."
    )
    limitation = (
        "The paper's robots are not available; smoothing of the positions leaves "
        "little "
        "noise in the inputs of the simulated ones."
    )
    table = data.table(columns=columns, rows=rows)
    return "Are the results of the paper reproduced?", verdict, data, table, limitation


def long_recordings():
    """Show time and memory."""
    data = Tables("long_recordings")
    headers = data.tables[0].headers
    columns = [*headers[:5]]
    row = "7 joints, 30 min"
    verdict = (
        "A search on 30 minutes of seven joints at 1 kHz takes "
        f"{data.cell(row, headers[2])} s "
        f"and {data.cell(row, headers[4])} GB on two cores."
    )
    limitation = "The simulated robots lack one effect."
    question = "How long does a long recording take?"
    return question, verdict, data, data.table(columns=columns), limitation


SECTIONS = (
    published,
    measured,
    field,
    tx40,
    pairs,
    false_alarms,
    whole_robots,
    single_effects,
    friction_memory,
    geometry,
    coverage,
    next_recording,
    repetition,
    bodies,
    quadruped,
    commands,
    ranges,
    changed_logs,
    gravity,
    known_noise,
    ordinary_tables,
    paper,
    long_recordings,
)


def page():
    """Return the text of the page."""
    parts = [INTRODUCTION]
    for section in SECTIONS:
        question, verdict, data, table, limitation = section()
        sources = data if isinstance(data, tuple) else (data,)
        made = " ".join(dict.fromkeys(one.source() for one in sources))
        parts += [f"## {question}\n", f"{verdict}\n", f"{table}\n"]
        parts += [f"Limitations: {limitation}\n", f"*{made}*\n"]
    return "\n".join(parts)


def main():
    """Write or check the page."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--check", action="store_true", help="compare only")
    arguments.add_argument("--fresh", action="store_true", help="refuse stale tables")
    given = arguments.parse_args()
    check = given.check or given.fresh
    text = page()
    if check and PAGE.read_text(encoding="utf-8") != text:
        sys.exit(
            "docs/evidence.md differs from docs/tables: run python docs/evidence.py"
        )
    if check and (stale := recorded.stale()):
        told = f"The code has changed since these tables: {', '.join(stale)}."
        sys.exit(told) if given.fresh else print(f"Warning: {told}")
    if not check:
        PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
