"""Form of a table of text: encoding, separator and decimal sign, found from its beginning."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Final, NamedTuple, final

from multicell.errors import DataError
from multicell.host.extras import needs

SEPARATORS: Final = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
"""What stands between the columns of a table, and how that is called."""
SAMPLE: Final = 300  # lines that the form of a table is found from
_DOUBT: Final = 0.4  # twice what charset-normalizer allows: labels of a table are no sentences
_BLOCK: Final = 2**20  # bytes that are decoded at a time
_MARKS: Final = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
"""Byte order marks; that of UTF-32 begins like that of UTF-16."""
_SIGNS: Final = frozenset("µ²³°±·×–—Ø‰")
"""Letters beyond ASCII in the titles of people who write English."""
_COMMA: Final = re.compile(r"[+-]?(\d+),(\d+)(?:[eE][+-]?\d+)?")
_POINT: Final = re.compile(r"[+-]?(?:\d+\.\d*|\.\d+|\d+)(?:[eE][+-]?\d+)?")


@final
class Form(NamedTuple):
    """How a table of text is written.

    - ``separator``: one of :data:`SEPARATORS`
    - ``comma``: whether decimals stand behind a comma
    - ``above``: lines of other things above the titles
    """

    encoding: str = "utf-8"
    separator: str = ","
    comma: bool = False
    above: int = 0

    @property
    def plain(self) -> bool:
        """Whether it is that of multicell's own tables."""
        usual = self.encoding in ("utf-8", "utf-8-sig") and self.separator == ","
        return usual and not self.comma and not self.above

    def words(self) -> str:
        """Return the differences from multicell's own tables."""
        parts = []
        if self.encoding not in ("utf-8", "utf-8-sig"):
            parts.append(self.encoding.replace("_", "-"))
        if self.separator != ",":
            parts.append(f"columns between {SEPARATORS[self.separator]}")
        if self.comma:
            parts.append("decimal commas")
        return ", ".join(parts)


FORM: Final = Form()


def encoding_of(content: bytes, name: str) -> str:
    """Return the encoding of a text: by its mark, else UTF-8 where it is that, else the likeliest.

    - ``name``: of the file, for errors
    """
    for mark, encoding in _MARKS:
        if content.startswith(mark):
            return encoding
    place = _not_utf8(content)
    if place is None and b"\0" not in content[:_BLOCK]:
        return "utf-8"
    sample = content[: _BLOCK // 4]
    if b"\0" not in sample:
        western = sample.decode("cp1252", errors="replace")
        if all(letter in _SIGNS for letter in western if not letter.isascii()):
            return "cp1252"
        if place is not None and not any(b > 127 for b in sample):  # the odd letter is far below
            return "cp1252"
    needs("charset_normalizer")
    import charset_normalizer

    found = charset_normalizer.from_bytes(sample, threshold=_DOUBT)
    best = found.best()
    if best is None:
        raise DataError(name, f"is not UTF-8 text (byte {place or 0})", "Save it as UTF-8.")
    # the pages of western languages differ in few letters: the usual one where it may be that
    usual = any("cp1252" in match.could_be_from_charset for match in found)
    return "cp1252" if usual else str(best.encoding)


def _not_utf8(content: bytes) -> int | None:
    """Return the first byte that is no UTF-8; in blocks, so that no second text is in memory."""
    decoder = codecs.getincrementaldecoder("utf-8")()
    for start in range(0, max(len(content), 1), _BLOCK):
        block = content[start : start + _BLOCK]
        kept = len(decoder.getstate()[0])
        try:
            decoder.decode(block, final=start + _BLOCK >= len(content))
        except UnicodeDecodeError as error:
            return start - kept + error.start
    return None


def form_of(lines: Iterator[str], encoding: str, name: str) -> Form:
    """Return the form of a table.

    - ``lines``: of the text, without remarks and blank ones
    - ``name``: of the file, for errors

    The separator is the one that parts all lines (but a few above the titles) into as many fields.
    Of several it is that with the largest share of numbers, then that with most fields: a comma
    may stand in titles, or in numbers.
    """
    sample = list(islice(lines, SAMPLE))
    best: tuple[tuple[float, int, bool], Form] | None = None
    for separator in SEPARATORS:
        found = _parted(sample, separator)
        if found is None:
            continue
        above, rows = found
        fields = [field for row in rows[1:] for field in row if field]
        comma = separator != "," and any(map(_COMMA.fullmatch, fields))
        numbers = sum(bool(_POINT.fullmatch(f) or (comma and _COMMA.fullmatch(f))) for f in fields)
        rank = (numbers / max(len(fields), 1), len(rows[0]), separator != ",")
        if best is None or rank > best[0]:
            best = rank, Form(encoding, separator, comma, above)
    if best is None:  # a row is too short or too long: the titles say what parts them
        first = sample[0] if sample else ""
        return Form(encoding, max(SEPARATORS, key=first.count))
    form = best[1]
    if form.comma:
        _, rows = _parted(sample, form.separator) or (0, [])
        _refuse_unclear(rows, form, name)
    return form


def _parted(sample: Sequence[str], separator: str) -> tuple[int, list[list[str]]] | None:
    """Return the lines above the titles and the rows, or None where these are of unlike widths."""
    try:
        rows = list(csv.reader(sample, delimiter=separator, skipinitialspace=True, strict=True))
    except csv.Error:
        return None
    rows = [[field.strip() for field in row] for row in rows]
    width = len(rows[-1]) if rows else 0
    if width < 2:
        return None
    above = next((k for k, row in enumerate(rows) if len(row) == width), 0)
    if any(len(row) != width for row in rows[above:]):
        return None
    short = all(sum(map(bool, row)) <= 2 for row in rows[:above])  # no titles that lack one
    if above and (not short or any(map(_POINT.fullmatch, rows[above]))):
        return None
    return above, rows[above:]


def _refuse_unclear(rows: Sequence[Sequence[str]], form: Form, name: str) -> None:
    """Refuse commas that may be decimal ones or stand between thousands."""
    fields = [field for row in rows[1:] for field in row]
    commas = [match for match in map(_COMMA.fullmatch, fields) if match]
    points = [f for f in fields if "." in f and _POINT.fullmatch(f)]
    hint = "Write numbers without marks between thousands, all with '.' or all with ','."
    if points:
        problem = f"has decimal points and commas in numbers: '{points[0]}', '{commas[0][0]}'"
        raise DataError(name, problem, hint)
    if all(len(m[2]) == 3 and len(m[1]) <= 3 and m[1] != "0" for m in commas):
        problem = f"has numbers such as '{commas[0][0]}': thousands, or three decimals?"
        raise DataError(name, problem, hint)


def with_point(field: str, place: str) -> str:
    """Return a field of a table with decimal commas with a point in its place, if it is a number.

    - ``place``: of the field in words, for errors
    """
    if _COMMA.fullmatch(field):
        return field.replace(",", ".")
    if "." in field and _POINT.fullmatch(field):
        hint = "Write all numbers with the same decimal sign, and nothing between thousands."
        raise DataError(place, f"is '{field}' in a table with decimal commas", hint)
    return field
