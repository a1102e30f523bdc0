"""Tables out of spreadsheets: Excel and OpenDocument, read by calamine."""

import datetime
import zipfile

import numpy as np

from sklearn_vbjfa.recording._table import Format, Source, Table, check_size, quoted
from sklearn_vbjfa.recording.formats._text import row_of_units, spread_lists


def read_sheet(path: Source, wanted) -> Table:
    """Read the first sheet that is not empty; its first row has the names."""
    try:
        from python_calamine import CalamineError, CalamineWorkbook
    except ImportError as error:
        raise SHEET.missing(path) from error
    broken = f"{path}: is not a complete spreadsheet"
    try:
        check_size(path, _unpacked_size(path), "save a shorter recording, or CSV")
        with CalamineWorkbook.from_path(path.file) as book:
            names = book.sheet_names
            rows, used = [], ""
            for used in names:
                rows = book.get_sheet_by_name(used).to_python(skip_empty_area=False)
                if rows:
                    break
    except (CalamineError, OSError, zipfile.BadZipFile) as error:
        raise ValueError(f"{broken} ({error}); save it anew, or as CSV.") from error
    filled = [k for k, row in enumerate(rows) if any(x != "" for x in row)]
    if len(filled) < 2:
        raise ValueError(
            f"{path}: no rows of data; expected one row per sample below the names of "
            "the columns."
        )
    filled = filled[_titles(rows, filled) :]
    first = [x for x in rows[filled[0]] if x != ""]
    nameless = all(isinstance(x, (int, float)) for x in first)
    if nameless:
        header, lines = [str(k + 1) for k in range(len(first))], filled
    else:
        header, lines = _header(path, rows[filled[0]], filled[0]), filled[1:]
    keep = [k for k, name in enumerate(header) if name]
    header = [header[k] for k in keep]
    cells = [[rows[k][j] if j < len(rows[k]) else "" for j in keep] for k in lines]
    units = row_of_units([str(x) for x in cells[0]], header)
    if units:
        cells, lines = cells[1:], lines[1:]
        if not cells:
            raise ValueError(f"{path}: only a header and no rows of data.")

    def where(row):
        return f"line {lines[row] + 1} of sheet {used!r}"

    columns = {
        name: _column(path, name, [row[k] for row in cells], where)
        for k, name in enumerate(header)
    }
    notes: tuple[str, ...] = ()
    if len(names) > 1:
        notes = (f"sheet {used!r} of {len(names)} was read.",)
    return Table(
        path=path.shown,
        columns=spread_lists(path, columns),
        where=where,
        units=units,
        nameless=nameless,
        notes=notes,
    )


def _unpacked_size(path):
    """Return the bytes of a file, or of what is packed in it."""
    size = path.file.stat().st_size
    if zipfile.is_zipfile(path.file):
        with zipfile.ZipFile(path.file) as archive:
            size = max(size, sum(x.file_size for x in archive.infolist()))
    return size


def _titles(rows, filled):
    """Count the rows above the names: the names fill the cells that numbers do."""
    # The first row of numbers tells which; a row of units may stand between.
    cells = {k: [j for j, x in enumerate(rows[k]) if x != ""] for k in filled}
    count = next((n for n, k in enumerate(filled) if _is_data(rows[k])), 0)
    k = filled[count]
    if not count or cells[filled[0]] == cells[k]:
        return 0
    names = [n for n in range(count) if cells[filled[n]] == cells[k]]
    texts = {n: [str(rows[filled[n]][j]) for j in cells[k]] for n in names}
    names = [n for n in names if not row_of_units(texts[n], texts[n])]
    return names[-1] if names else 0


def _is_data(row):
    """Whether most cells of a row that are filled are numbers."""
    cells = [x for x in row if x != ""]
    return 2 * sum(isinstance(x, (int, float)) for x in cells) > len(cells)


def _header(path, row, line):
    names = [str(x).strip() for x in row]
    for name in names:
        if name and names.count(name) > 1:
            raise ValueError(
                f"{path}: line {line + 1} names column {name!r} twice; each column "
                "needs its own name."
            )
    return names


def _column(path, name, cells, where):
    """Return cells as numbers, dates or text; a column is what its first cell is."""
    first = next((x for x in cells if x != ""), "")
    if isinstance(first, (datetime.datetime, datetime.date)):
        stamps = [str(x).replace(" ", "T") for x in cells]
        try:
            return np.array(stamps, dtype="datetime64[ns]")
        except ValueError:
            return np.array([str(x) for x in cells])
    if isinstance(first, (bool, int, float)):
        for row, x in enumerate(cells):
            if x != "" and not isinstance(x, (bool, int, float)):
                raise ValueError(
                    f"{path}: {quoted(str(x))} in {where(row)}, column {name!r} is not "
                    "a number; correct or remove that line."
                )
        return np.array([np.nan if x == "" else float(x) for x in cells])
    return np.array([str(x) for x in cells])


SHEET = Format(
    name="Excel",
    endings=(".xlsx", ".xlsm", ".xlsb", ".xls", ".ods"),
    read=read_sheet,
    begins=((b"\xd0\xcf\x11\xe0", ".xls"),),
    needs=("python-calamine", "spreadsheets"),
)
