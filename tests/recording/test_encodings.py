"""Text saved by Excel: encodings, decimal commas, unit symbols."""

import numpy as np
import pytest

from tests.recording._reading import read_text, refusal
from tests.recording.test_reader import DT, N, assert_same, table

HEADER = ("t [ms]", "q1 [°]", "q2 [°]", "tau1 [Nm]", "tau2 [Nm]", "Öl [°C]")


def german_csv(separator):
    """Return text with decimal commas, and its columns in units of this package."""
    columns = table()
    cells = [1e3 * np.arange(N) * DT]
    cells += [np.rad2deg(columns[name]) for name in ("q1", "q2")]
    cells += [columns["tau1"], columns["tau2"], np.linspace(20, 40, N)]
    lines = [separator.join(HEADER)]
    for row in zip(*cells):
        cells = [f"{x:.9f}".replace(".", ",") for x in row]
        lines.append(separator.join(f'"{x}"' if separator == "," else x for x in cells))
    return "\r\n".join(lines) + "\r\n", columns


@pytest.mark.parametrize(
    ("separator", "encoding", "note"),
    [
        (";", "utf-8", ""),
        (",", "utf-8", ""),
        (";", "utf-8-sig", ""),
        (";", "cp1252", "is not UTF-8, read as Windows text (cp1252)"),
        ("\t", "utf-16", ""),
        ("\t", "utf-16-le with a mark", ""),
        ("\t", "utf-16-be with a mark", ""),
    ],
)
@pytest.mark.parametrize("separator_line", ["", '"sep={}"\r\n'])
def test_german_excel_export(separator, encoding, note, separator_line, tmp_path):
    text, columns = german_csv(separator)
    text = separator_line.format(separator) + text
    if encoding.endswith(" with a mark"):
        encoding, text = encoding.partition(" ")[0], "\N{BYTE ORDER MARK}" + text
    path = tmp_path / "log.csv"
    path.write_bytes(text.encode(encoding))
    recording, notes = read_text(path)
    assert note in notes
    assert bool(note) == ("cp1252" in notes)
    assert_same(recording, columns, atol=1e-8)
    assert recording.dt == pytest.approx(DT)
    np.testing.assert_allclose(recording.signals["Öl [°C]"], np.linspace(20, 40, N))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        # Byte undefined in the code page.
        (b"t,q1\x81\n", "can't decode byte 0x81"),
        # A corrupt byte in a UTF-8 file, not at its start.
        (b"t,q1\n" + 9 * b"0.1,0.2\n" + b"\x00\xff\n", "is binary"),
        ("t,q1\n".encode("utf-16")[:-1], "truncated data"),
    ],
)
def test_undecodable_text_is_refused(content, message, tmp_path):
    path = tmp_path / "log.csv"
    path.write_bytes(content)
    message_text = str(refusal(path))
    assert message in message_text
    assert message_text.endswith("save it as CSV in UTF-8.")
