"""Files that are there as a whole or not at all."""

import os
import secrets
from pathlib import Path


def write_whole(path, text):
    """Write a text file beside its place and move it there.

    An interrupted program leaves no half of a file, and the old one if there was one.

    Parameters
    ----------
    path : str or os.PathLike
        File to write.
    text : str
        Content, written as UTF-8.

    Raises
    ------
    FileNotFoundError
        If its folder does not exist.
    """
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
