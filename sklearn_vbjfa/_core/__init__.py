"""Mathematics of the estimators in NumPy, independent of scikit-learn."""

import os
import secrets
from pathlib import Path


def write_whole(path, text):
    """Write a text (UTF-8) beside its place and move it there: never half a file."""
    path = Path(path)
    if not path.parent.is_dir():
        raise FileNotFoundError(
            f"There is no folder {str(path.parent)!r} to write {path.name!r} into."
        )
    temporary = path.parent / f".{path.name}.{secrets.token_hex(8)}"
    try:
        # Exclusively, so that nothing is written through a link.
        with temporary.open("x", encoding="utf-8", newline="\n") as file:
            file.write(text)
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
