"""Tables out of spreadsheets: Excel and OpenDocument, by pandas and calamine."""

import contextlib
import zipfile
from importlib.util import find_spec

from sklearn_vbjfa.recording._table import (
    Format,
    Source,
    Table,
    check_size,
    no_rows,
    pandas_of,
)
from sklearn_vbjfa.recording.formats._cells import (
    check_header,
    names_and_start,
    table_of_cells,
)


def read_sheet(path: Source, wanted) -> Table:
    """Read the first sheet that is not empty, below the names of its columns."""
    pandas = pandas_of(path)
    if find_spec("python_calamine") is None:
        raise SHEET.missing(path)
    from python_calamine import CalamineError

    check_size(path, _unpacked_size(path), "save a shorter recording, or CSV")
    try:
        options = {"header": None, "keep_default_na": False, "na_values": []}
        with pandas.ExcelFile(path.file, engine="calamine") as book:
            sheets = book.sheet_names
            frame = pandas.DataFrame()
            for sheet in sheets:
                frame = pandas.read_excel(book, sheet, dtype=object, **options)
                if len(frame):
                    break
    except (CalamineError, OSError, ValueError) as error:
        raise ValueError(
            f"{path}: is not a complete spreadsheet ({error}); save it as CSV."
        ) from error
    frame.index += 1
    frame = frame[(frame != "").any(axis=1)]
    if len(frame) < 2:
        raise no_rows(path)
    rows = ([str(x).strip() for x in row] for row in frame.itertuples(index=False))
    at, start, units = names_and_start(rows)
    if at is None:
        names = [str(k + 1) for k in range(frame.shape[1])]
    else:
        names = [str(x).strip() for x in frame.iloc[at]]
        check_header(path, [x for x in names if x], frame.index[at])
    used = [k for k, name in enumerate(names) if name]
    known = dict(units)
    frame = frame.iloc[start:, used]
    frame.columns = [names[k] for k in used]
    if not len(frame):
        raise ValueError(f"{path}: only a header and no rows of data.")
    return table_of_cells(
        path,
        frame,
        place="line {} of sheet " + repr(sheet).replace("{", "{{").replace("}", "}}"),
        notes=(f"sheet {sheet!r} of {len(sheets)} was read.",) * (len(sheets) > 1),
        units=known,
        nameless=at is None,
    )


def _unpacked_size(path):
    """Return the bytes of a file, or of what is packed in it."""
    size = path.file.stat().st_size
    with (
        contextlib.suppress(zipfile.BadZipFile, OSError),
        zipfile.ZipFile(path.file) as archive,
    ):
        size = max(size, sum(x.file_size for x in archive.infolist()))
    return size


SHEET = Format(
    name="Excel",
    endings=(".xlsx", ".xlsm", ".xlsb", ".xls", ".ods"),
    read=read_sheet,
    begins=((b"\xd0\xcf\x11\xe0", ".xls"),),
    needs=("python-calamine", "spreadsheets", "excel"),
)
