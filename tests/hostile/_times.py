"""Time stamps with faults, and columns that could be two things."""

import numpy as np

from tests.hostile._case import DT, FINE, N, columns, fine_recording, table_case


def _stamps(change):
    """Return a change of the stamps alone: sampling was steady."""
    return lambda table, rng: table | {"t": change(table["t"], rng)}


def _rows(choose):
    """Return a change that keeps some rows, chosen by their number."""

    def change(table, rng):
        keep = choose(len(table["t"]), rng)
        return {name: x[keep] for name, x in table.items()}

    return change


def _sampled(when):
    """Return a change that samples the robot when the stamps say so."""

    def change(table, rng):
        t = when(table["t"], rng)
        last = fine_recording().n_samples - 1
        rows = np.clip(np.rint(t / (DT / FINE)).astype(int), 0, last)
        return columns(np.unique(rows))

    return change


def late(share, dt=DT):
    """Return stamps early or late by a share of a period (standard deviation)."""
    return lambda t, rng: t + dt * np.clip(share * rng.normal(size=t.size), -0.45, 0.45)


def _delayed(mean):
    """Return stamps that are only ever late, as of a busy computer."""
    return lambda t, rng: np.maximum.accumulate(
        t + DT * rng.exponential(mean, size=t.size)
    )


def lost(share):
    """Return rows some of which were lost."""

    def choose(n, rng):
        keep = rng.random(n) >= share
        keep[[0, -1]] = True
        return np.flatnonzero(keep)

    return choose


def gaps(count, longest):
    """Return rows with gaps of six rows to `longest`."""

    def choose(n, rng):
        keep = np.ones(n, dtype=bool)
        for start in rng.integers(50, n - longest - 50, size=count):
            keep[start : start + rng.integers(6, longest)] = False
        return np.flatnonzero(keep)

    return choose


def repeated(share):
    """Return rows some of which were written twice."""

    def choose(n, rng):
        return np.sort(np.r_[np.arange(n), rng.choice(n, int(share * n))])

    return choose


def stale(share):
    """Return stamps some of which were not renewed."""

    def change(t, rng):
        rows = rng.choice(np.arange(1, t.size - 1), int(share * t.size), replace=False)
        t = t.copy()
        t[rows] = t[rows - 1]
        return np.maximum.accumulate(t)

    return change


def drift(share):
    """Return stamps of a clock that is slow at first and fast at the end."""
    return lambda t, rng: t + share * t * (t / t[-1] - 1)


def _wander(share):
    """Return stamps of a clock that runs now faster, now slower."""
    return lambda t, rng: t + share / (2 * np.pi / 3.0) * np.sin(2 * np.pi * t / 3.0)


def packets(size):
    """Return stamps of packets: the same one for some rows."""
    return lambda t, rng: t[(np.arange(t.size) // size) * size]


def _swapped(count):
    def change(t, rng):
        t = t.copy()
        for row in rng.integers(1, t.size - 2, size=count):
            t[[row, row + 1]] = t[[row + 1, row]]
        return t

    return change


def _reset(t, rng):
    return t % 2.0


def _slower(t, rng, factor=1.5):
    """Return times whose period is longer in the second half."""
    half = t[N // 2]
    return np.where(t > half, half + factor * (t - half), t)


def _random(t, rng):
    return np.sort(rng.uniform(0, t[-1], size=t.size))


def _stamp_cases():
    found = []

    def add(name, change, expect="same", message="", **options):
        found.append(table_case(f"time: {name}", change, expect, message, **options))

    for digits in (2, 3, 4):
        add(f"{digits} decimals", _stamps(lambda t, rng, d=digits: np.round(t, d)))
    add("cut to ms", _stamps(lambda t, rng: np.floor(1e3 * t + 1e-6) / 1e3))
    for start in (-100.0, 1e4, 1e5):
        add(f"from {start:g} s on", _stamps(lambda t, rng, s=start: t + s))
    add("too few digits", _stamps(lambda t, rng: t + 1.7e9), "refused", "time")
    for share in (0.05, 0.1, 0.2, 0.3, 0.4):
        add(f"written late {share}", _stamps(late(share)), message="note: ")
        add(f"sampled late {share}", _sampled(late(share)), message="note: ")
    for mean in (0.2, 1.0):
        add(f"written after {mean} periods", _stamps(_delayed(mean)), message="note: ")
    for share in (0.01, 0.02, 0.05, 0.1):
        add(f"{share} of the rows lost", _rows(lost(share)), message="note: ")
    add("each 10th row lost", _rows(lambda n, rng: np.flatnonzero(np.arange(n) % 10)))
    add(
        "each 2nd row lost at times",
        _rows(
            lambda n, rng: np.flatnonzero(
                (np.arange(n) % 2 == 0) | (np.arange(n) < 700)
            )
        ),
    )
    for share in (0.01, 0.1, 1.0):
        add(f"{share} of the rows twice", _rows(repeated(share)), message="note: ")
        add(
            f"{share / 2} of the stamps stale",
            _stamps(stale(share / 2)),
            message="note: ",
        )
    for share in (-0.02, 0.005, 0.02):
        add(f"clock drifts by {share}", _stamps(drift(share)))
        add(f"clock wanders by {share}", _stamps(_wander(share)))
    # Nothing in the stamps tells it.
    add("clock 2 % fast", _stamps(lambda t, rng: 1.02 * t), "read")
    for size in (2, 5):
        add(f"packets of {size}", _stamps(packets(size)))
    add(
        "packets of 5, lost ones",
        lambda x, rng: _rows(lost(0.02))(_stamps(packets(5))(x, rng), rng),
        "either",
    )
    add("one gap", _rows(gaps(1, 60)), message="gap")
    add("three gaps", _rows(gaps(3, 60)), "read", "gap")
    add(
        "gaps close together",
        _rows(
            lambda n, rng: np.flatnonzero(
                (np.arange(n) < 800) | (np.arange(n) % 20 < 8)
            )
        ),
        "read",
        "left out",
    )
    add(
        "gaps everywhere",
        _rows(lambda n, rng: np.flatnonzero(np.arange(n) % 20 < 8)),
        "refused",
    )
    add(
        "more gap than rows",
        _rows(lambda n, rng: np.flatnonzero(np.arange(n) % 100 < 40)),
        "either",
    )
    for count in (1, 20):
        add(f"{count} rows swapped", _stamps(_swapped(count)), "refused", "backwards")
    add("starts anew", _stamps(_reset), "refused", "backwards")
    add("backwards", _stamps(lambda t, rng: t[::-1]), "refused", "backwards")
    add("stands still", _stamps(lambda t, rng: 0 * t), "refused", "repeats|stand")
    add("at random", _stamps(_random), "refused", "time")
    add("one far off", _stamps(lambda t, rng: np.r_[t[:-1], 1e6]), "either")
    add("first one far off", _stamps(lambda t, rng: np.r_[-1e6, t[1:]]), "either")
    add("first one zero", _stamps(lambda t, rng: np.r_[0, t[1:] + 1e4]), "either")
    for unit, factor in (("ms", 1e3), ("us", 1e6), ("ns", 1e9), ("minutes", 1 / 60)):
        add(f"in {unit}", _stamps(lambda t, rng, f=factor: f * t), "refused")
        kinds = (
            "cannot be in s, in .s this|millisec|microsec|nanosec|minutes|in seconds"
        )
        add(
            f"in {unit}, whole",
            _stamps(lambda t, rng, f=factor: np.round(f * t)),
            "refused",
            kinds if factor > 1 else "time",
        )
        add(f"in {unit}, 4 kHz", _sampled_fast(factor), "refused", kinds)
    add("row numbers", _stamps(lambda t, rng: np.arange(t.size)), "refused", "second")
    add("a period that changes", _stamps(_slower), "refused", "period")
    add("sampled more slowly later", _sampled(_slower))
    add("half of the rows later", _sampled(lambda t, rng: _slower(t, rng, 2.0)))
    add(
        "two periods in segments",
        lambda x, rng: (
            x
            | {
                "segment": (x["t"] > 4) * 1,
                "t": np.where(x["t"] > 4, 2 * x["t"], x["t"]),
            }
        ),
        "refused",
        "periods",
    )
    add(
        "dates",
        lambda x, rng: x | {"t": [f"2024-01-01T00:00:{v:09.6f}" for v in x["t"]]},
        "same",
    )
    return found


def _sampled_fast(factor):
    """Return a change to 4 kHz in another unit, where a period is less than one."""

    def change(table, rng):
        fine = columns(np.arange(fine_recording().n_samples // 2))
        return fine | {"t": fine["t"] * factor}

    return change


def _column_cases():
    found = []

    def add(name, change, expect="refused", message="", **options):
        found.append(table_case(f"columns: {name}", change, expect, message, **options))

    others = {
        "q1": ("q_1", "Q1", "q[1]", "q(1)", "q.1", "q01", "q_shoulder", "q_0", "q"),
        "tau2": ("tau_2", "Tau2", "TAU2", "tau[2]", "tau02", "tau_elbow", "tau.2"),
        "t": ("T",),
    }
    for name, spellings in others.items():
        for other in spellings:

            def beside(table, rng, name=name, other=other):
                first = next(iter(table))
                copy = {other: table[name] + 0.1}
                return (copy | table) if name == first else (table | copy)

            both = f"{name}.*{other}|{other}.*{name}".replace("[", r"\[")
            both = both.replace("(", r"\(").replace(")", r"\)")
            add(f"{name} and {other}", beside, "refused", both)

    def temperature(table, rng):
        return table | {"T": 20 + 3 * table["t"]}

    def only_temperature(table, rng):
        rest = {name: x for name, x in table.items() if name != "t"}
        return {"T": 20 + 0.5 * np.sin(table["t"])} | rest

    add("a temperature T beside t", temperature, "refused", "T")
    add("T a temperature, no t", only_temperature, "refused", "time")
    add(
        "v1 and v_1",
        lambda x, rng: x | {"v1": x["q1"], "v2": x["q2"], "v_1": x["q1"]},
        "refused",
        "v_1",
    )
    add(
        "a1 and A1",
        lambda x, rng: x | {"a1": x["q1"], "a2": x["q2"], "A1": x["q1"]},
        "refused",
        "A1",
    )
    add(
        "segment and Segment",
        lambda x, rng: x | {"segment": np.zeros(N), "Segment": np.ones(N)},
        "refused",
        "Segment",
    )
    add(
        "names and numbers",
        lambda x, rng: {("q_shoulder" if k == "q1" else k): v for k, v in x.items()},
        "refused",
        "q",
    )
    add("from 0 and from 1", lambda x, rng: x | {"q0": x["q1"]}, "refused", "q0")
    add(
        "names",
        lambda x, rng: dict(
            zip(["t", "q_shoulder", "q_elbow", "tau_shoulder", "tau_elbow"], x.values())
        ),
        "same",
    )
    add(
        "from 0",
        lambda x, rng: dict(zip(["t", "q0", "q1", "tau0", "tau1"], x.values())),
        "same",
    )
    add(
        "in brackets",
        lambda x, rng: dict(zip(["t", "q[1]", "q[2]", "tau[1]", "tau[2]"], x.values())),
        "same",
    )
    add(
        "q from 0, tau from 1",
        lambda x, rng: dict(zip(["t", "q0", "q1", "tau1", "tau2"], x.values())),
        "same",
    )
    return found


def cases():
    """Return all cases of time stamps and columns."""
    return _stamp_cases() + _column_cases()
