"""Which characters the bytes of a text are: UTF-8, what a mark says, or Windows'.

Nothing is guessed from how frequent letters are. A mark at the beginning (Excel's
"Unicode text" has one) settles it; text without one is UTF-8 if all of it is. What is
left may be a CSV file that Excel saved in Western Europe, with single bytes for
degrees, micro and umlauts: code page 1252.
"""

import codecs

from sklearn_vbjfa.recording._table import Source

# Of marks that begin alike the longer one counts.
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
WINDOWS = "cp1252"
# What that code page has a character for, control characters left out.
_CHARACTERS = bytes(
    k
    for k in range(256)
    if k in b"\t\n\r\f" or (k >= 32 and k not in b"\x7f\x81\x8d\x8f\x90\x9d")
)
_CHUNK = 1 << 20


def encoding_of(path: Source) -> str:
    """Return the encoding of a text file; refuse what is no text in any of them."""
    with path.file.open("rb") as file:
        begin = file.read(4)
    marked = [name for mark, name in _MARKS if begin.startswith(mark)]
    encoding = marked[0] if marked else "utf-8"
    wrong = _wrong(path, encoding)
    if not wrong:
        return encoding
    if not marked and _is_windows(path):
        return WINDOWS
    name = encoding.removesuffix("-sig").upper()
    raise ValueError(f"{path}: is no {name} text ({wrong}); save it as CSV in UTF-8.")


def _wrong(path, encoding):
    """Say which byte is no part of a text in an encoding, "" if all are."""
    decoder, done = codecs.getincrementaldecoder(encoding)(), 0
    for chunk in _chunks(path):
        held = len(decoder.getstate()[0])
        try:
            decoder.decode(chunk, final=not chunk)
        except UnicodeDecodeError as error:
            return f"{error.reason} at byte {done - held + error.start}"
        done += len(chunk)
    return ""


def _is_windows(path):
    """Whether bytes that are not UTF-8 are text in the code page of Windows."""
    # A file with some characters in UTF-8 is damaged, not in another encoding: by
    # chance two letters of the code page make no such character.
    decoder = codecs.getincrementaldecoder("utf-8")("ignore")
    for chunk in _chunks(path):
        if chunk.translate(None, _CHARACTERS):
            return False
        if not decoder.decode(chunk, final=not chunk).isascii():
            return False
    return True


def _chunks(path):
    """Yield the bytes of a file in pieces, at last an empty one."""
    with path.file.open("rb") as file:
        while chunk := file.read(_CHUNK):
            yield chunk
    yield b""
