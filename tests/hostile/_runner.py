"""Run the command line in separate processes with limited memory and time.

A server process imports the package once and forks for each case, so that a crash, a
hang or an exhausted memory ends that fork only.
"""

import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

# Limit of processor time [s], which does not depend on the load of the machine; the
# slowest input needs 23 s.
SECONDS = 120
# Limit of elapsed time [s]: waiting processes use no processor time.
_PATIENCE = 900
MEMORY = 2 << 30  # bytes
# The address space exceeds the memory in use; allocations beyond the limit fail.
_ADDRESS_SPACE = 3 << 30


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of a run."""

    code: int  # negative for a signal
    out: str
    err: str
    seconds: float  # processor time
    memory: int  # peak [bytes]


class Runner:
    """A process that runs the command line in forks."""

    def __enter__(self):
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.hostile._runner"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=Path(__file__).resolve().parents[2],
        )
        return self

    def __exit__(self, *exception):
        self._process.stdin.close()
        self._process.wait()

    def run(self, argv, folder):
        """Run the command line in a folder; return the outcome."""
        task = {"argv": [str(x) for x in argv], "folder": str(folder)}
        print(json.dumps(task), file=self._process.stdin, flush=True)
        return Outcome(**json.loads(self._process.stdout.readline()))


def _serve():
    with contextlib.suppress(ImportError):
        from pyarrow import parquet  # noqa: F401
    for number, line in enumerate(sys.stdin):
        if number == 0:
            _warm_up(json.loads(line))
        task = json.loads(line)
        folder = Path(task["folder"])
        out, err = folder / ".stdout", folder / ".stderr"
        child = os.fork()
        if child == 0:
            _run(task["argv"], folder, out, err)
        _, status, usage = os.wait4(child, 0)
        outcome = Outcome(
            code=os.waitstatus_to_exitcode(status),
            out=out.read_text(encoding="utf-8", errors="replace"),
            err=err.read_text(encoding="utf-8", errors="replace"),
            seconds=usage.ru_utime + usage.ru_stime,
            memory=usage.ru_maxrss * 1024,
        )
        print(json.dumps(vars(outcome)), flush=True)


def _warm_up(task):
    """Run the first task in the server, so that forks inherit its imports."""
    from sklearn_vbjfa._cli import main

    os.chdir(task["folder"])
    with (
        tempfile.TemporaryDirectory() as out,
        open(os.devnull, "w", encoding="utf-8") as null,
        contextlib.redirect_stdout(null),
        contextlib.redirect_stderr(null),
    ):
        main([*task["argv"], "--out", out])
    os.chdir("/")


def _run(argv, folder, out, err):
    """Run the command line in this fork; never return."""
    from sklearn_vbjfa._cli import main

    code = 70
    try:
        os.chdir(folder)
        for path, number in ((out, 1), (err, 2)):
            os.dup2(os.open(path, os.O_CREAT | os.O_WRONLY | os.O_TRUNC), number)
        sys.stdin = open(os.devnull, encoding="utf-8")
        resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        # Default handlers also end a hang inside of a library.
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.signal(signal.SIGXCPU, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
        signal.alarm(_PATIENCE)
        code = main(argv)
    except SystemExit as stop:
        code = stop.code
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        with contextlib.suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code if isinstance(code, int) else 1)


if __name__ == "__main__":
    _serve()
