"""Functions that Numba compiles."""

import zlib
from pathlib import Path

try:
    import numba
except ImportError as error:
    raise ImportError(
        "Regressors, friction with memory and simulations need Numba, which is not "
        'installed: pip install "sklearn-vbjfa[robot]".'
    ) from error


def compiler(*files, **more):
    """Return a decorator that compiles functions whose source is in some files."""
    # The machine code is kept on disk: only the first use takes the seconds of the
    # compilation. Numba looks for changes in the file of a function alone; those that
    # it calls are in its name. Fused multiplications and additions round once.
    stamp = zlib.crc32(b"".join(Path(one).read_bytes() for one in files))

    def compiled(function):
        function.__qualname__ = f"{function.__qualname__}_{stamp:08x}"
        options = {"error_model": "numpy", "fastmath": {"contract"}}
        return numba.njit(nogil=True, cache=True, **options, **more)(function)

    return compiled
