"""Tables in JSON and files of JSON lines, each with its checksum.

A checksum detects an edit, a cut and a flipped bit; files are regular ones of a bounded size, or an
error in words.
"""

from __future__ import annotations

import json
import os
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, final

from multicell.errors import OutputError
from multicell.host.files import parse_json, read_regular
from multicell.host.interrupts import UNCUT
from multicell.results.folder import file_errors, json_text, plain_json, write_text
from multicell.results.records import parse_table

_CHECKSUM: Final = "checksum"
_MAX_BYTES: Final = 1 << 26  # 64 MiB of a document, far above what is written
_MAX_LINES_BYTES: Final = 1 << 30  # 1 GiB of a log, far above what is written


def _checksum(table: Mapping[str, Any]) -> str:
    text = json.dumps(table, sort_keys=True, separators=(",", ":"))
    return f"{zlib.crc32(text.encode()):08x}"


def write_table(path: Path, table: Mapping[str, Any], *, synced: bool = True) -> None:
    """Write a table with its checksum, as :func:`multicell.results.folder.write_bytes` does."""
    plain = plain_json(table)
    text = json_text({**plain, _CHECKSUM: _checksum(plain)})
    write_text(path, text + "\n", synced=synced)


def read_document(path: Path) -> dict[str, Any] | None:
    """Return the table that was written to a file; None where there is no file."""
    with file_errors("read", path):
        try:
            text = read_regular(path, _MAX_BYTES)
        except FileNotFoundError:
            if path.is_symlink():
                raise
            return None
    try:
        table = parse_table(text)
        unchanged = table.pop(_CHECKSUM, None) == _checksum(table)
    except (OutputError, RecursionError) as error:
        raise OutputError(f"'{path}' is damaged: {error}", damaged=True) from error
    if not unchanged:
        problem = f"'{path}' is damaged: it is not what was written there"
        raise OutputError(problem, damaged=True)
    return table


@final
class Lines:
    """A file of JSON entries, one a line, each with a checksum of it and of all before it.

    No line can be missing, changed or in the place of another. A line that the file ends in the
    middle of was being written when its process was killed, and does not count.

    - ``path``: its file, which need not be there

    Raises OutputError if the file cannot be read, or is not what was written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._chain = 0
        self.entries: list[Any] = []
        with file_errors("read", path):
            try:
                data = read_regular(path, _MAX_LINES_BYTES)
            except FileNotFoundError:
                if path.is_symlink():
                    raise
                data = b""
        self._end = data.rfind(b"\n") + 1
        for number, line in enumerate(data[: self._end].split(b"\n")[:-1], start=1):
            self.entries.append(self._entry(line, number))

    def _entry(self, line: bytes, number: int) -> Any:
        chain, text = line[:8], line[9:]
        self._chain = zlib.crc32(text, self._chain)
        if chain == f"{self._chain:08x}".encode():
            try:
                return parse_json(text)
            except (ValueError, RecursionError):
                pass
        raise OutputError(
            f"'{self._path}' is damaged in line {number}: it is not what was written there. "
            "Remove it to begin anew",
            damaged=True,
        )

    def append(self, entries: Iterable[Any]) -> None:
        """Add entries at the end; raises OutputError if they cannot be written."""
        entries = list(entries)
        lines, chain = [], self._chain
        for entry in entries:
            text = json.dumps(entry, separators=(",", ":")).encode()
            chain = zlib.crc32(text, chain)
            lines.append(f"{chain:08x} ".encode() + text + b"\n")
        data = b"".join(lines)
        flags = os.O_WRONLY | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
        with UNCUT, file_errors("write", self._path):
            descriptor = os.open(self._path, flags, 0o666)
            with os.fdopen(descriptor, "wb") as file:
                file.truncate(self._end)  # what a write left that did not come to its end
                file.seek(self._end)
                file.write(data)
                file.flush()
                os.fsync(descriptor)
            self._end, self._chain = self._end + len(data), chain
            self.entries += entries
