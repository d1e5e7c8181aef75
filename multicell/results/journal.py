"""The journal of a running simulation: records appended to one file.

HDF5 leaves an unreadable file behind when the disk is full or the process is killed in the middle
of a write. So during a run its results go here, by plain writes to the end of the file, and
only what is complete counts. The file is a sequence of records

    tag (4 bytes), length of header, length of body, checksums of header, of body, and of these 24
    bytes with the same checksum of the record before
    header: JSON, with the kind of the record, and names, types and shapes of the arrays
    body: the arrays one after another, little-endian, in C order

So no record can be missing, or be in the place of another. A record that the file ends in the
middle of is one that was being written: it does not count, and the next one is written over it.
"""

from __future__ import annotations

import json
import math
import os
import re
import struct
import time as clock
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from multicell.errors import OutputError
from multicell.host.files import parse_json
from multicell.results.folder import file_errors, new_file, put_in_place

Arrays = Mapping[str, NDArray[Any]]

JOURNAL_FILE: Final = "frames.journal"

_TAG: Final = b"mcj3"
PREFIX: Final = struct.Struct("<4sIQIII")  # tag, lengths and checksums of a record: 28 bytes

_SYNC_EVERY: Final = 1.0  # s


def array_headers(arrays: Arrays) -> list[list[Any]]:
    """Return name, type and shape of each array."""
    return [[name, a.dtype.str, list(a.shape)] for name, a in arrays.items()]


def flat(array: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the bytes of an array in C order, without a copy where they lie so already."""
    return np.ascontiguousarray(array).reshape(-1).view(np.uint8)


def array_digest(arrays: Arrays) -> int:
    """Return a checksum of names, types, shapes and values of arrays."""
    value = zlib.crc32(json.dumps(array_headers(arrays)).encode())
    for array in arrays.values():
        value = zlib.crc32(flat(array).data, value)
    return value


@final
@dataclass(frozen=True)
class Record:
    """A complete record: its header, and the places of its arrays."""

    header: Mapping[str, Any]
    begin: int
    length: int
    digest: int


@final
class Journal:
    """The writer of a journal and the owner of its open file.

    All methods raise :class:`~multicell.errors.OutputError` when the system refuses to write.
    What was appended before is then still there, and nothing of what was refused.
    """

    def __init__(self, path: Path, descriptor: int, end: int = 0, chain: int = 0) -> None:
        self._path = path
        self._descriptor = descriptor
        self._end = end
        self._chain = chain
        self._torn = False  # whether there may be a part of a record behind the end
        self._synced = clock.monotonic()

    @classmethod
    def create(cls, folder: Path, header: Mapping[str, Any]) -> Journal:
        """Begin a journal; it is in its place only when its first record is on disk."""
        path = folder / JOURNAL_FILE
        part = path.with_name(f"{JOURNAL_FILE}.part")
        with file_errors("write", path):
            journal = cls(path, new_file(part))
            try:
                journal.append([(header, {})])
                journal.sync()
                put_in_place(part, path)
            except BaseException:
                journal.close()
                part.unlink(missing_ok=True)
                raise
        return journal

    @classmethod
    def reopen(cls, reader: Reader) -> Journal:
        """Continue a journal behind its complete records."""
        path, end = reader.path, reader.end
        with file_errors("write", path):
            flags = os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
            descriptor = os.open(path, flags)
            journal = cls(path, descriptor, end, reader.chain)
            try:
                os.ftruncate(descriptor, end)
            except BaseException:
                journal.close()
                raise
        return journal

    def append(self, records: Sequence[tuple[Mapping[str, Any], Arrays]]) -> None:
        """Write records; a call that does not come to its end leaves none of them.

        They survive the end of the process at once, and a loss of power unless others came in the
        second before.
        """
        chain, parts = self._chain, []
        for header, arrays in records:
            chain, pieces = _parts(header, arrays, chain)
            parts += pieces
        with file_errors("write", self._path):
            if self._torn:
                os.ftruncate(self._descriptor, self._end)
            self._torn = True
            try:
                place = self._write(b"".join(parts))
                if clock.monotonic() - self._synced > _SYNC_EVERY:
                    self._sync()
            except OSError as error:
                try:  # give back the room that the refused records have taken
                    os.ftruncate(self._descriptor, self._end)
                except OSError as second:
                    # an incomplete record at the end does no harm: readers do not count it
                    error.add_note(f"and it could not be taken back: {second}")
                raise
            self._end, self._chain, self._torn = place, chain, False

    def _write(self, data: bytes) -> int:
        place = self._end
        os.lseek(self._descriptor, place, os.SEEK_SET)
        view = memoryview(data)
        while view:
            done = os.write(self._descriptor, view)
            view, place = view[done:], place + done
        return place

    def _sync(self) -> None:
        os.fsync(self._descriptor)
        self._synced = clock.monotonic()

    def sync(self) -> None:
        """Wait until everything is on the disk itself: then it survives a loss of power."""
        with file_errors("write", self._path):
            self._sync()

    def close(self) -> None:
        """Close the file; closing twice does no harm."""
        if self._descriptor >= 0:
            descriptor, self._descriptor = self._descriptor, -1
            with file_errors("write", self._path):
                os.close(descriptor)


def _parts(header: Mapping[str, Any], arrays: Arrays, chain: int) -> tuple[int, list[Any]]:
    """Return the checksum of a record's head, and the pieces of the record."""
    text = json.dumps({**header, "arrays": array_headers(arrays)} if arrays else header).encode()
    pieces = [flat(array) for array in arrays.values()]
    length = sum(len(piece) for piece in pieces)
    head = PREFIX.pack(_TAG, len(text), length, zlib.crc32(text), array_digest(arrays), 0)[:-4]
    chain = zlib.crc32(head, chain)
    return chain, [head, chain.to_bytes(4, "little"), text, *pieces]


_ENTRIES: Final[Mapping[str, Mapping[str, Any]]] = {
    "open": {
        "identity": str,
        "base": str,
        "frames": int,
        "rows": int,
        "scene": str,
        "nutrients": list,
    },
    "back": {"scene": str, "frames": int, "rows": int},
    "rows": {"start": int, "columns": list},
    "lineage": {"number": int},
    "frame": {"number": int, "time": float, "step": int},
}
"""Entries of the header of each kind of record; numbers are at least zero, lists are of names."""

_TYPE: Final = re.compile(r"[<|][biuf][1248]")  # of arrays
_MOST_AXES: Final = 3  # fields have three, all other arrays fewer
_WIDEST: Final = 8  # axis of an array without entries, beside the one of length zero


def _header(text: bytes, length: int, *, first: bool) -> dict[str, Any] | None:
    """Return the header of a record of ``length`` bytes of arrays; None if it cannot be one.

    A checksum only shows that a record is as somebody wrote it.
    """
    try:
        header = parse_json(text)
        kind, arrays = header.get("kind"), header.get("arrays", [])
        entries = [(header[key], wanted) for key, wanted in _ENTRIES[kind].items()]
        right = (kind == "open") == first and all(_is_right(*entry) for entry in entries)
        shapes = {name: shape for name, _, shape in arrays}
        right = right and len(shapes) == len(arrays)  # a name twice would hide an array
        names = *shapes, *header.get("columns", ()), *header.get("nutrients", ())
        right = right and "".join(names).isprintable()
        if kind == "frame":
            right = right and shapes["time"] == shapes["step"] == []
        size = sum(_size(*entry) for entry in arrays)
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError):
        return None
    return header if right and size == length else None


def _is_right(entry: Any, wanted: type) -> bool:
    """Return whether an entry of a header is of its type, and can be."""
    same: bool = type(entry) is wanted  # True is no number
    if same and wanted is list:
        return all(type(name) is str for name in entry) and len({*entry}) == len(entry)
    return same and (wanted is str or 0 <= entry < 1 << 62)


def _size(name: Any, kind: Any, shape: Any) -> int:
    """Return the bytes of an array; raises ValueError where there can be no such one."""
    entries = [type(n) is int and n >= 0 for n in shape]
    if type(name) is not str or not _TYPE.fullmatch(kind) or not all(entries):
        raise ValueError
    size: int = math.prod(shape) * int(kind[2:])
    if len(shape) > _MOST_AXES or (not size and max(shape) > _WIDEST):
        raise ValueError
    return size


@final
class Reader:
    """The complete records of a journal, as they were when it was opened.

    Raises OutputError if the file cannot be read or does not begin as a journal does.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.records: list[Record] = []
        self.end = self.chain = 0  # of the last complete record, and the checksum of its head
        self.damage: str | None = None  # what ends the records before the end of the file, in words
        with file_errors("read", path), path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            while self.end < size and self.damage is None:
                file.seek(self.end)
                if not self._next(file, size):
                    break
        if not self.records:
            problem = f"'{path}' is damaged at its beginning: nothing in it can be read"
            raise OutputError(problem, damaged=True)

    def _next(self, file: Any, size: int) -> bool:
        """Read the head of the record at the end; return whether there is a complete one."""
        head = file.read(PREFIX.size)
        if len(head) < PREFIX.size:
            return False
        tag, letters, length, of_text, of_body, of_head = PREFIX.unpack(head)
        if tag != _TAG or zlib.crc32(head[:-4], self.chain) != of_head:
            # after a loss of power the end may be there without what was written to it
            if any(head) or any(file.read(1 << 16)):
                self.damage = f"the record at byte {self.end} is damaged"
            return False
        begin = self.end + PREFIX.size + letters
        if begin + length > size:
            return False
        text = file.read(letters)
        if zlib.crc32(text) != of_text:
            self.damage = f"the record at byte {self.end} is damaged"
            return False
        header = _header(text, length, first=not self.records)
        if header is None:
            self.damage = f"the record at byte {self.end} is none of a run"
            return False
        self.records.append(Record(header, begin, length, of_body))
        self.end, self.chain = begin + length, of_head
        return True

    def arrays(self, record: Record) -> dict[str, NDArray[Any]]:
        """Return the arrays of a record; raises OutputError if they are not what was written."""
        arrays, left = {}, record.length
        with file_errors("read", self.path), self.path.open("rb") as file:
            file.seek(record.begin)
            for name, kind, shape in record.header.get("arrays", ()):
                arrays[name] = np.empty(shape, kind)
                left -= file.readinto(flat(arrays[name]).data)
        if left or array_digest(arrays) != record.digest:
            problem = f"the record at byte {record.begin} of '{self.path}' is damaged"
            raise OutputError(problem, damaged=True)
        return arrays
