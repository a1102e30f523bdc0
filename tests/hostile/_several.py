"""Several files of one recording, and folders that hold other things."""

import os

import numpy as np

from tests.hostile._case import Case, argv, clean_text, columns

_Q, _TAU = ("t", "q1", "q2"), ("t", "tau1", "tau2")


def _save(path, names, table, header=True):
    rows = np.column_stack([table[name] for name in names])
    head = ",".join(names) if header else ""
    np.savetxt(path, rows, "%.9g", delimiter=",", header=head, comments="")


def _case(name, write, expect, message="", options=()):
    def build(folder, rng):
        log = folder / "log"
        log.mkdir()
        write(log, columns(), rng)
        return argv("log", *options)

    return Case(name=f"several: {name}", build=build, expect=expect, message=message)


def _two(change=lambda table, rng: table):
    """Return a writer of positions, and of torques that are changed."""

    def write(log, table, rng):
        _save(log / "positions.csv", _Q, table)
        _save(log / "torques.csv", _TAU, change(dict(table), rng))

    return write


def _late(seconds):
    return lambda table, rng: table | {"t": table["t"] + seconds}


def _rows(keep):
    return lambda table, rng: {name: x[keep(rng)] for name, x in table.items()}


def _and(prepare):
    """Return a writer of the two files and of something beside them."""

    def write(log, table, rng):
        _two()(log, table, rng)
        prepare(log, table, rng)

    return write


def _bare(names):
    """Return a writer of tables without names, called after what they hold."""

    def write(log, table, rng):
        _save(log / "t.txt", ("t",), table, header=False)
        for name, kind in names.items():
            _save(log / name, (f"{kind}1", f"{kind}2"), table, header=False)

    return write


def _damaged(log, table, rng):
    _two()(log, table, rng)
    content = bytearray((log / "torques.csv").read_bytes())
    content[rng.integers(200, len(content))] = 0
    (log / "torques.csv").write_bytes(bytes(content))


def _again(log, table, rng):
    _save(log / "more.csv", _Q, table | {"q1": table["q1"] + 1})


def _runs(log, table, rng):
    for k in range(2):
        text = clean_text().replace("0.1", f"0.{k + 1}1")
        (log / f"run{k}.csv").write_text(text)


def _loop(log, table, rng):
    (log / "again").symlink_to(log)
    os.mkfifo(log / "pipe.csv")
    (log / "gone.csv").symlink_to(log / "nowhere")
    (log / ".hidden.csv").write_text("x")
    (log / "notes.md").write_text("recorded on Monday")


def cases():
    """Return all cases of several files."""
    names = {"q.txt": "q", "tau.txt": "tau"}
    return [
        _case("two files", _two(), "same", "2 files of one recording, row by row"),
        _case("two files, asked for", _two(), "same", "one recording", ("--join",)),
        _case("late by half a period", _two(_late(0.0025)), "read", "straight lines"),
        _case("late by an hour", _two(_late(3600.0)), "refused", "nothing in common"),
        _case("time in one backwards", _two(_late(0)), "same"),
        _case(
            "rows missing",
            _two(_rows(lambda rng: np.r_[0:700, 760:1500])),
            "read",
            "not in all files",
        ),
        _case(
            "one row",
            _two(_rows(lambda rng: np.r_[5])),
            "refused",
        ),
        _case(
            "time shuffled in one",
            _two(_rows(lambda rng: np.random.default_rng(1).permutation(1500))),
            "refused",
            "time does not rise",
        ),
        _case("without names", _bare(names), "same", "t.txt .t.: *|t.txt"),
        _case(
            "without names that say anything",
            _bare({"a.txt": "q", "b.txt": "tau"}),
            "refused",
            "do not say what",
        ),
        _case("a channel twice", _and(_again), "refused", "'q1' is in"),
        _case("damaged", _damaged, "either"),
        _case("a folder of recordings", _runs, "either"),
        _case("a folder of recordings, joined", _runs, "refused", "", ("--join",)),
        _case("links, pipes, notes", _and(_loop), "same"),
        _case("nothing", lambda log, table, rng: None, "refused", "holds nothing"),
        _case(
            "only positions",
            lambda log, table, rng: _save(log / "positions.csv", _Q, table),
            "refused",
            "no torques",
        ),
    ]
