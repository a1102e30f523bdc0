"""Writing robot descriptions: comments, and files that are never half written."""

import os
import uuid
import xml.etree.ElementTree as ElementTree
from pathlib import Path


def number(value):
    """Text of a number from which the same number is read back."""
    return repr(float(value) + 0.0)  # no -0.0


def numbers(values):
    """Text of several numbers, separated by spaces."""
    return " ".join(map(number, values))


def add_comment(root, note):
    """Put a comment at the top of an element, unless it is empty."""
    if note:
        # Two hyphens would end the comment.
        lines = note.replace("--", "- -").replace("\n", "\n    ")
        root.insert(0, ElementTree.Comment(f" {lines} "))


def write_tree(tree, target, like=None):
    """Write an indented XML tree to a file, or leave the file as it was."""
    # like: file whose permissions the new one gets; None leaves them to the system.
    ElementTree.indent(tree)
    target = Path(target)
    # Written beside the target and moved: an interrupted run leaves no half of a file.
    temporary = target.with_name(f".{uuid.uuid4().hex}{target.suffix}")
    try:
        with temporary.open("xb") as file:
            tree.write(file, encoding="utf-8", xml_declaration=True)
        if like is not None:
            os.chmod(temporary, Path(like).stat().st_mode & 0o666)
        os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
