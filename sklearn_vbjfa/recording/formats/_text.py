"""Tables out of text: names and separator by the first lines, cells by pandas."""

import csv
import re

from sklearn_vbjfa.recording._table import (
    CUT,
    Format,
    NotATable,
    Source,
    Table,
    no_rows,
    pandas_of,
)
from sklearn_vbjfa.recording.formats._cells import (
    LONGEST_PREAMBLE,
    check_header,
    is_data,
    names_and_start,
    table_of_cells,
)
from sklearn_vbjfa.recording.formats._precheck import (
    cells_of,
    check_rows,
    is_number,
    separator_of,
    text_in_utf8,
    without_comments,
)

# Other separators that a header in one piece may have.
_OTHER_MARKS = ("|", ":", "/")
_ANY = re.compile(r"[;,\s]+")
# This line is the separator for Excel.
_EXCEL_SEPARATOR = re.compile(r'"?sep=.?"?', re.IGNORECASE)
# A row of numbers some of which stand in brackets, as YARP prints its ports.
_BRACKETED = re.compile(r"[-+\d.eE\s,;]*[(\[][-+\d.eE\s,;()\[\]]*")
# What pandas takes for nothing; "inf" it knows.
_NOTHING = ["", "nan", "NaN", "NAN", "-nan", "+nan", "-NaN", "-NAN"]


def read_text(path: Source, wanted) -> Table:
    """Read text with a header line; blank lines and comments (#) are skipped."""
    text = text_in_utf8(path)
    lines = text.lines(2 * LONGEST_PREAMBLE)
    try:
        if _BRACKETED.fullmatch(_first_content(path, lines)):
            text = text.without_brackets()
            lines = text.lines(2 * LONGEST_PREAMBLE)
        return _read(text, lines)
    except csv.Error as error:
        raise ValueError(
            f"{path}: is not a table of numbers ({error}); save it as CSV in UTF-8."
        ) from error
    except ValueError as error:
        content = [_content(line) for line in lines if _content(line)]
        # An empty log is one, and broken.
        if len(content) < 2 or any(is_data(re.split(_ANY, x)) for x in content):
            raise
        raise NotATable(path.shown, str(error)) from error


def _first_content(path, lines):
    for line in lines:
        if _content(line):
            return line
    raise no_rows(path)


def _content(line):
    """Return a line without its comment, "" for one that tells Excel the separator."""
    line = line.split("#", 1)[0].strip()
    return "" if _EXCEL_SEPARATOR.fullmatch(line) else line


def _read(text, lines):
    path, pandas = text.path, pandas_of(text.path)
    names, start, separator, units, notes = _head(path, lines)
    without_comments(path, [line.encode() for line in lines[:start]])
    columns = names or _places(lines[start], separator)
    numbers, cut = check_rows(text, start, columns, separator)
    if not numbers.size:
        raise ValueError(f"{path}: only a header and no rows of data.")
    try:
        with text.open() as file:
            frame = pandas.read_csv(
                file,
                sep=separator or r"\s+",
                header=None,
                names=columns,
                index_col=False,
                skiprows=start,
                nrows=len(numbers),
                comment="#",
                keep_default_na=False,
                na_values=_NOTHING,
                encoding="utf-8-sig",
                decimal="," if separator != "," and "," in lines[start] else ".",
            )
    except (pandas.errors.ParserError, pandas.errors.EmptyDataError) as error:
        reason = " ".join(str(error).split()).rstrip(".")
        raise ValueError(f"{path}: is not a table of numbers ({reason}).") from error
    if len(frame) != len(numbers):
        raise ValueError(
            f"{path}: has {len(numbers)} lines and {len(frame)} rows; write each row "
            "in one line."
        )
    frame.index = numbers
    return table_of_cells(
        path,
        frame,
        comma=separator != ",",
        notes=(*notes, *[CUT] * cut, *text.notes),
        units=dict(units),
        nameless=not names,
    )


def _places(line, separator):
    """Return names for the columns of a table that has none, by a row."""
    cells = cells_of(line, separator)
    while not cells[-1]:
        cells.pop()
    return [str(k + 1) for k in range(len(cells))]


def _head(path, lines):
    """Return the names, the first line of data, the separator, units and notes."""
    content = [(k, _content(line)) for k, line in enumerate(lines)]
    content = [(k, line) for k, line in content if line]
    first, line = content[0]
    echo = _echo_names(line)
    if echo:
        return echo, first, ",", (), []
    rows = (cells_of(x, separator_of(x)) for _, x in content)
    at, start, units = names_and_start(rows)
    # Of a file with a header alone the data begin after it.
    content.append((len(lines), ""))
    start = content[start][0]
    if at is None:
        # Numbers at once: the header may be the last comment before them.
        header = next((k for k in reversed(range(first)) if lines[k].strip()), None)
        line = content[0][1]
        found = "" if header is None else lines[header].strip().lstrip("#")
        found = found.split("#")[0].strip()
        cells = cells_of(found, separator_of(found))
        if len(cells) != len(_places(line, separator_of(line))) or any(
            map(is_number, cells)
        ):
            return [], start, separator_of(line), (), []
    else:
        header, found = content[at]
    separator = separator_of(found)
    names = cells_of(found, separator)
    while names and not names[-1]:
        names.pop()
    _check_marks(path, found, names, header + 1)
    check_header(path, names, header + 1)
    notes = [f"the names of the columns are in line {header + 1}."] if at else []
    return names, start, separator, units, notes


def _check_marks(path, text, names, line):
    """Refuse a header in one piece."""
    if text == "header:":
        raise ValueError(
            f"{path}: holds messages as topic echo shows them; write them one a line, "
            "ros2 topic echo --csv TOPIC > FILE.csv (rostopic echo -p), or record a bag"
        )
    marks = [mark for mark in _OTHER_MARKS if mark in text]
    if len(names) == 1 and marks:
        raise ValueError(
            f"{path}: line {line} is one cell, with {marks[0]!r} in it; separate the "
            "columns by comma, semicolon, tab or blanks."
        )


def _echo_names(line):
    """Return names for the cells of a JointState by ``ros2 topic echo --csv``."""
    # It writes the values of a message one after another and no header (message_to_csv
    # in rosidl_runtime_py/convert.py of github.com/ros2/rosidl_runtime_py): the stamp,
    # the frame, names, positions, velocities and efforts. [] if the line is not one.
    cells = cells_of(line, ",")
    n, rest = divmod(len(cells) - 3, 4)
    if n < 1 or rest or not all(re.fullmatch(r"\d+", x) for x in cells[:2]):
        return []
    joints, numbers = cells[3 : 3 + n], cells[3 + n :]
    if any(map(is_number, joints)) or not all(map(is_number, numbers)):
        return []
    names = ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id"]
    for what in ("name", "position", "velocity", "effort"):
        names += [f"{what}_{k}" for k in range(n)]
    return names


TEXT = Format(
    name="CSV (also .gz, .bz2, .xz)",
    endings=(".csv", ".tsv", ".txt", ".dat"),
    read=read_text,
)
