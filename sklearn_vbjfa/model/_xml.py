"""XML of robot descriptions: read safely, and written whole or not at all.

A description is checked before a parser sees it, since these do not limit the depth.
"""

import os
import re
import shlex
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from xml.parsers import expat
from xml.parsers.expat import ExpatError

from sklearn_vbjfa._core import write_whole

# Robots of a hundred joints stay far below.
_DEEPEST, _MOST_ELEMENTS, _MOST_ATTRIBUTES = 100, 200_000, 1000


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
        lines = re.sub("-(?=-)", "- ", note).replace("\n", "\n    ")
        root.insert(0, ElementTree.Comment(f" {lines} "))


def write_tree(tree, target, like=None):
    """Write an indented XML tree to a file, or leave the file as it was."""
    # like: file whose permissions the new one gets; None leaves them to the system.
    ElementTree.indent(tree)
    text = ElementTree.tostring(tree.getroot(), encoding="unicode")
    write_whole(target, f"<?xml version='1.0' encoding='utf-8'?>\n{text}")
    if like is not None:
        os.chmod(target, Path(like).stat().st_mode & 0o666)


def parse_description(path):
    """Read the XML of a robot description, `ElementTree`; refuse what is none."""
    if not path.is_file():
        raise FileNotFoundError(
            f"No robot description at {str(path)!r}; expected the path of a URDF or "
            "MJCF file."
        )
    return parse_text(path.read_bytes(), path)


def parse_text(content, path):
    """Parse the bytes of a description; path : what messages name."""
    try:
        _check_structure(content)
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ExpatError, LookupError, ValueError) as error:
        raise ValueError(
            f"{str(path)!r} is not readable as URDF or MJCF (XML): {error}. "
            "A xacro file must be expanded first: xacro FILE > robot.urdf"
        ) from error
    if any("xacro" in str(one.tag).rpartition("}")[0] for one in root.iter()):
        raise ValueError(
            f"{str(path)!r} is a xacro file, from which a URDF is made first: "
            f"{_expanding(path)}"
        )
    return ElementTree.ElementTree(root)


def _expanding(path):
    """Return the command that makes a URDF of a xacro file."""
    path = Path(path)
    stem = path.name.removesuffix(".xacro").removesuffix(".urdf")
    if not path.name.endswith(".xacro"):
        stem += "-expanded"
    return f"xacro {shlex.quote(str(path))} > {shlex.quote(f'{stem}.urdf')}"


def _check_structure(content):
    """Refuse XML that is not a robot's, before a parser makes a tree of it."""
    # Parsers call themselves once a level: a file of some hundred kilobytes can overrun
    # the stack of the process.
    depth, elements = 0, 0

    def start(name, attributes):
        nonlocal depth, elements
        depth, elements = depth + 1, elements + 1
        if depth > _DEEPEST:
            raise ValueError(f"elements are nested more than {_DEEPEST} deep")
        if elements > _MOST_ELEMENTS:
            raise ValueError(f"there are more than {_MOST_ELEMENTS} elements")
        if len(attributes) > _MOST_ATTRIBUTES:
            raise ValueError(f"<{name}> has more than {_MOST_ATTRIBUTES} attributes")

    def end(name):
        nonlocal depth
        depth -= 1

    def entity(name, *rest):
        raise ValueError(
            f"it declares the entity {name[:40]!r}, write what it stands for"
        )

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.EntityDeclHandler = entity
    parser.Parse(content, True)
