"""Run a command, and write a recording for it."""

import numpy as np

from sklearn_vbjfa._cli import main


def run(capsys, *argv):
    """Return the exit code, stdout and stderr."""
    code = main([*map(str, argv)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def refused(command, capsys, *argv):
    """Return the only line on stderr of a refused command."""
    code, out, err = run(capsys, command, *argv)
    assert (code, out) == (2, "")
    (line,) = err.splitlines()
    assert line.startswith("sklearn-vbjfa: ")
    return line


def write_csv(path, recording, *, q=None, tau=None, t=True, rows=slice(None)):
    """Write columns t, q1, ..., tau1, ...; q and tau replace the recorded ones."""
    q = recording.q if q is None else q
    tau = recording.tau if tau is None else tau
    names = [f"q{k + 1}" for k in range(q.shape[1])]
    names += [f"tau{k + 1}" for k in range(tau.shape[1])]
    table = np.hstack([q, tau])
    if t:
        names, table = ["t", *names], np.column_stack([recording.t, table])
    header = ",".join(names)
    np.savetxt(path, table[rows], fmt="%.8g", delimiter=",", header=header, comments="")
    return path
