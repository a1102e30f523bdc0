"""Time, peak memory and accuracy as rows, columns and joints grow."""

import importlib.util
import time
from functools import lru_cache

import _growth_problems as problems

# What a process is asked for more than once is made once.
_make = lru_cache(maxsize=1)(problems.make_task)


class _Growth:
    """Time, peak memory and relative error of a study of `_growth_problems`.

    Peak memory is that of the process, with Python and the data.
    """

    study: str
    params: list
    # That of the processor, as in the tables.
    timer = time.process_time
    # The largest size at which odrpack takes less than a minute or so.
    largest_for_odr = 0

    def setup(self, size, method):
        if method.startswith("ODR"):
            missing = importlib.util.find_spec("odrpack") is None
            if missing or size > self.largest_for_odr:
                raise NotImplementedError("not installed, or too slow")
        self.task = _make(self.study, method, size)

    def time_fit(self, size, method):
        self.task.run()

    def peakmem_fit(self, size, method):
        self.task.run()

    def track_error(self, size, method):
        self.task.run()
        return self.task.error()

    track_error.unit = "relative error"


class Rows(_Growth):
    """Linear models on 20 columns."""

    study = "rows"
    params = [[1_000, 10_000, 100_000], list(problems.LINEAR)]  # noqa: RUF012
    param_names = ["rows", "model"]  # noqa: RUF012
    largest_for_odr = 1_000


class Columns(_Growth):
    """Linear models on 1,000 rows."""

    study = "columns"
    params = [[10, 100, 1_000], list(problems.LINEAR)]  # noqa: RUF012
    param_names = ["columns", "model"]  # noqa: RUF012
    largest_for_odr = 10


class Joints(_Growth):
    """Identification with several regressors, projection, and search for effects."""

    study = "joints"
    params = [[1, 6, 20], list(problems.ROBOT)]  # noqa: RUF012
    param_names = ["joints", "method"]  # noqa: RUF012
    largest_for_odr = 1

    def setup(self, size, method):
        if method == problems.DISCOVERY and size > 6:
            raise NotImplementedError("too slow")
        super().setup(size, method)


class _Chunks:
    """Rows streamed by `partial_fit`, 100,000 at a time and refitted each time."""

    timer = time.process_time
    params = [[100_000, 1_000_000], list(problems.STREAMED)]  # noqa: RUF012
    param_names = ["rows", "model"]  # noqa: RUF012

    def setup(self, size, method):
        task = problems.LinearTask(method, size, problems.COLUMNS, streamed=True)
        self.task = task.prepare()


class ChunksHeld(_Chunks):
    """The fit alone: the chunks are made before."""

    def setup(self, size, method):
        super().setup(size, method)
        self.task.hold()

    def time_partial_fit(self, size, method):
        self.task.run()


class ChunksPassing(_Chunks):
    """Each chunk is made, fitted and forgotten."""

    def peakmem_partial_fit(self, size, method):
        self.task.run()

    def track_error(self, size, method):
        self.task.run()
        return self.task.error()

    track_error.unit = "relative error"
