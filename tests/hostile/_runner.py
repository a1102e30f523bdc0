"""Run the command line in processes of their own, with bounded memory and time.

A process is started once, imports what a run needs and forks for every case: a crash, a
hang or a full memory ends that fork and no more.
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

# Guards against what never ends. Of the processor, as a busy machine is no hang; the
# slowest input needs 23 s.
SECONDS = 120
# What waits uses no processor: it is ended after this time on the wall [s].
_PATIENCE = 900
MEMORY = 2 << 30  # bytes
# The address space holds more than the memory in use; beyond it an allocation fails.
_ADDRESS_SPACE = 3 << 30


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a run."""

    code: int  # negative for a signal
    out: str
    err: str
    seconds: float  # of the processor
    memory: int  # the largest in use [bytes]


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
        """Run the command line in a folder; its outcome."""
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
    """Run the first task here, so that what it imports need not be in each fork."""
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
    """Become the run; never returns."""
    from sklearn_vbjfa._cli import main

    code = 70
    try:
        os.chdir(folder)
        for path, number in ((out, 1), (err, 2)):
            os.dup2(os.open(path, os.O_CREAT | os.O_WRONLY | os.O_TRUNC), number)
        sys.stdin = open(os.devnull, encoding="utf-8")
        resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        # No handler of Python's: what hangs inside of a library is ended as well.
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
