"""The file ``frames.h5``: written once, as a whole, and checked before it is read.

HDF5 never meets a disk that can refuse it: it writes through a
:class:`~multicell.results.hdf5.Sink` that notes a refusal and reports success to HDF5,
and the file is thrown away afterwards. All of the file's own structure and all data carry checksums
of HDF5, and each frame one of ours over all that it holds. Nothing that leads out of the file
(links, external storage, virtual data sets) is followed.
"""

from __future__ import annotations

import errno
import io
import math
import os
import struct
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any, Final, final

import h5py
import numpy as np
from numpy.typing import NDArray

from multicell.errors import OutputError
from multicell.results.folder import Check, file_errors, package_version, replace_file
from multicell.results.journal import array_digest
from multicell.results.layout import (
    FORMAT_WITHOUT_TABLES,
    FRAMES_FORMAT,
    DatasetKind,
    Places,
    column_places,
    fits_table,
    frame_rows,
    layout,
    of_rows,
    read_frame,
    stored_sets,
)
from multicell.results.lineage import LINEAGE_COLUMNS
from multicell.results.quantities import known_unit
from multicell.results.records import INSIDE, SPARSE, Arrays


@final
class Sink(io.RawIOBase):
    """A file for HDF5 whose writes never fail: the first refusal is kept for :meth:`check`.

    HDF5 keeps a file open that it cannot write, complains at the end of the process, and may
    crash there. So the answer is that all went well. It writes a small file in hundreds of pieces,
    which are collected in memory up to :data:`_BATCH` bytes.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._target = file
        self._file: IO[bytes] = io.BytesIO()
        self._place = self._end = 0
        self._trouble: BaseException | None = None

    def check(self) -> None:
        """Raise the error of a refused write."""
        if self._trouble is not None:
            raise self._trouble

    def finish(self) -> None:
        """Hand all that is still in memory to the file; raise what a write was refused with."""
        self._try(self._unload)
        # what Python flushes when it deletes this is no trouble: that would hold the whole run
        self._file = io.BytesIO()
        self.check()

    def seek(self, place: int, whence: int = os.SEEK_SET) -> int:
        """Go to a place."""
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._place, os.SEEK_END: self._end}[whence]
        self._place = base + place
        return self._place

    def write(self, data: Any) -> int:
        """Write, or note why that is refused."""
        if self._place > _BATCH:
            self._try(self._unload)
        length = self._at_place(self._file.write, data)
        self._end = max(self._end, self._place)
        return length

    def _unload(self) -> None:
        """Write to the file itself from now on."""
        if isinstance(self._file, io.BytesIO):
            self._target.write(self._file.getbuffer())
            self._target.truncate(self._end)
            self._file = self._target

    def readinto(self, target: Any) -> int:
        """Read back what was written; after a refusal there may be nothing."""
        return self._at_place(self._file.readinto, memoryview(target).cast("B"))  # type: ignore[attr-defined]

    def truncate(self, size: int | None = None) -> int:
        """Set the length."""
        self._end = self._place if size is None else size
        self._try(self._file.truncate, self._end)
        return self._end

    def flush(self) -> None:
        """Hand everything to the system."""
        self._try(self._file.flush)

    def _at_place(self, action: Callable[[Any], Any], data: Any) -> int:
        """Read or write at the place, and go on behind it whatever became of it."""
        length = memoryview(data).nbytes
        self._try(self._file.seek, self._place)
        self._try(action, data)
        self._place += length
        return length

    def _try(self, action: Callable[..., Any], *given: Any) -> None:
        if self._trouble is None:
            try:
                action(*given)
            except BaseException as error:  # raised again by check()
                self._trouble = error


FRAMES_FILE: Final = "frames.h5"

_LIBVER: Final = ("v110", "v110")  # the first in which all of a file's structure has checksums
_BATCH: Final = 1 << 23  # bytes that are collected before they are written
_AHEAD: Final = 1 << 19  # bytes of a data set that are read back at once
_LEVEL: Final = 4  # of gzip; 1 would take 15 % less time and 1 % more room
_COMPACT: Final = 1024  # bytes of a data set that are part of its header


def write_hdf5(path: Path, *content: Any) -> None:
    """Write a file in the place of ``path``; until it has been read back the old one stays.

    - ``content``: as of :func:`_write`
    """
    read_back: list[File] = []

    def check(part: Path) -> None:
        written = File(part, own=True)
        if (written.identity, written.digests.tolist()) != made:
            raise _damage(part, "it is not what was written")
        read_back.append(written)

    with whole_file(path, check) as sink:
        made = _write(sink, *content)
    _note_read_back(path, read_back[0])


def image(*content: Any) -> bytes:
    """Return the bytes of a file as :func:`write_hdf5` writes it."""
    file = io.BytesIO()
    with _filled(file) as sink:
        _write(sink, *content)
    return file.getvalue()


_READ_BACK: dict[tuple[Any, ...], File] = {}  # the small file that was written last
_FRAMES: dict[str, tuple[tuple[Any, ...], list[Arrays]]] = {}
"""Identity of that file -> its stamp, and its frames as they were read back."""
_SMALL: Final = 1 << 20  # bytes


def _stamp(path: Path) -> tuple[Any, ...]:
    about = os.stat(path)
    return path.absolute(), about.st_ino, about.st_size, about.st_mtime_ns


def _note_read_back(path: Path, file: File) -> None:
    """Keep what was found when a small file was read back, for whoever opens it next.

    Its frames too, until the next file is written: a page and a picture ask for them again.
    """
    file.path, frames = path, file.take_frames()
    stamp = _stamp(path)
    _READ_BACK.clear()
    _FRAMES.clear()
    if stamp[2] <= _SMALL:
        _READ_BACK[stamp] = file
        if frames:
            _FRAMES[file.identity] = stamp, frames


def _frames_of(file: File) -> list[Arrays]:
    """Return the frames of the file that was written last, if it still is as it was."""
    stamp, frames = _FRAMES.get(file.identity, (None, []))
    try:
        return frames if frames and stamp == _stamp(file.path) else []
    except OSError:  # it is gone: whoever opens it says so
        return []


def opened(path: Path) -> File:
    """Return a file that exists, checked; one that has just been written was checked then."""
    return _READ_BACK.pop(_stamp(path), None) or File(path)


@contextmanager
def whole_file(path: Path, check: Check, beside: str = "part") -> Iterator[Sink]:
    """Give what HDF5 may write a file to that takes the place of ``path`` when it is complete.

    - ``check``, ``beside``: as of :func:`multicell.results.folder.replace_by_name`
    """
    with replace_file(path, check, beside) as file, _filled(file) as sink:
        yield sink


@contextmanager
def _filled(file: Any) -> Iterator[Sink]:
    """Give what HDF5 may write to an open file."""
    sink = Sink(file)
    try:
        yield sink
    except OutputError:
        raise
    except Exception:
        sink.check()  # what HDF5 says after a refused write means nothing
        raise
    sink.finish()


def _write(
    sink: Sink,
    scene: str,
    nutrients: Sequence[str],
    frames: Iterable[tuple[Arrays, int, Arrays]],
    history: Mapping[str, NDArray[np.float64]],
    absorbed: str,
) -> tuple[str, list[int]]:
    """Write a file; return its identity, and the checksums of its frames.

    - ``scene``: text of ``scene.toml``
    - ``frames``: arrays, checksum and new rows of the lineage of each frame, one after another
    - ``history``, column -> (m,) float64
    - ``absorbed``: identity of the journal that is part of the file now: 32 letters
    """
    identity = uuid.uuid4().hex
    with h5py.File(sink, "w", libver=_LIBVER) as target:
        log = _Log(target, nutrients, sink)
        h5py.h5g.create(target.id, b"fields")
        text = np.frombuffer(scene.encode(), "|u1")
        _create(target, "scene", of_rows("|u1"), text)
        for frame in frames:
            log.add(*frame)
        log.flush(last=True)
        names = sorted(history)
        rows = {f"history/{name}": np.asarray(history[name], "<f8") for name in names}
        units = {f"history/{name}": of_rows("<f8", known_unit(name)) for name in names}
        if not fits_table(names):
            h5py.h5g.create(target.id, b"history")
        for made in _tables(units, rows, column_places(rows, history=fits_table(names))):
            _create(target, *made)
        digest = np.uint32(array_digest({name: history[name] for name in names}))
        _attach(h5py.h5o.open(target.id, b"history"), "digest", digest)
        shared = {path: np.concatenate(pieces) for path, pieces in log.shared.items()}
        _describe(
            target,
            identity=np.bytes_(identity),
            absorbed=np.bytes_(absorbed),
            format=np.int64(FRAMES_FORMAT),
            multicell=np.array(package_version(), _TEXT),
            frames=np.int64(len(log.digests)),
            digest=np.uint32(array_digest({"scene": text, **shared})),
        )
    return identity, log.digests


@lru_cache(maxsize=256)
def _storage(chunks: tuple[int, ...]) -> Any:
    """Return how data sets are stored; h5py takes longer to find that than to write a small one.

    Those without chunks are part of their headers, whose checksum covers them.
    """
    settings = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    settings.set_obj_track_times(False)
    if not chunks:
        settings.set_layout(h5py.h5d.COMPACT)
        return settings
    settings.set_chunk(chunks)
    settings.set_shuffle()
    settings.set_deflate(_LEVEL)
    settings.set_fletcher32()
    return settings


_type = cache(h5py.h5t.py_create)
_TEXT, _SCALAR = h5py.string_dtype(), h5py.h5s.create(h5py.h5s.SCALAR)
_PARENTS: Final = h5py.h5p.create(h5py.h5p.LINK_CREATE)
_PARENTS.set_create_intermediate_group(True)
_space = lru_cache(maxsize=256)(h5py.h5s.create_simple)
_unit = cache(partial(np.array, dtype=_TEXT))


def _tables(
    sets: Mapping[str, DatasetKind], columns: Mapping[str, NDArray[Any]], places: Places
) -> Iterator[tuple[str, DatasetKind, NDArray[Any]]]:
    """Yield path, kind and rows of the data sets that hold columns."""
    stored = stored_sets({path: sets[path] for path in columns}, places)
    tables = {path: np.empty(0, kind.dtype) for path, kind in stored.items() if path not in columns}
    for path, rows in columns.items():
        if path in places:
            table, field = places[path]
            if len(tables[table]) != len(rows):
                tables[table] = np.empty(len(rows), stored[table].dtype)
            tables[table][field] = rows
    for path, kind in stored.items():
        yield path, kind, columns[path] if path in columns else tables[path]


def _create(
    target: Any, path: str, kind: DatasetKind, rows: NDArray[Any], *, grows: bool = False
) -> Any:
    """Create a data set with its rows, the first ones where it ``grows``, and its unit."""
    chunks: tuple[int, ...] = (kind.chunk, *rows.shape[1:])
    longest = (h5py.h5s.UNLIMITED, *rows.shape[1:])
    if not grows and len(rows) <= kind.chunk:  # room for more would take time and disk
        chunks, longest = () if rows.nbytes <= _COMPACT else rows.shape, rows.shape
    made = _type(rows.dtype), _space(rows.shape, longest), _storage(chunks), _PARENTS
    column = h5py.h5d.create(target.id, path.encode(), *made)
    if len(rows):
        whole = h5py.h5s.ALL
        column.write(whole, whole, np.ascontiguousarray(rows), _type(rows.dtype))
    _attach(column, "unit", _unit(kind.unit))
    return column


def _attach(owner: Any, name: str, value: Any) -> None:
    """Give one of h5py's inner objects an attribute, a number or a row of them."""
    space = _space(value.shape) if value.ndim else _SCALAR
    made = h5py.h5a.create(owner, name.encode(), _type(value.dtype, logical=True), space)
    made.write(np.asarray(value), _type(value.dtype))


def _describe(owner: Any, **values: Any) -> None:
    """Give a group scalar attributes, in a fifth of the time that h5py's take."""
    for name, value in values.items():
        _attach(owner.id, name, value)


@final
class _Log:
    """Rows on their way into a file: HDF5 is quick with few large writes, slow with many.

    - ``shared``, path -> pieces: what belongs to no single frame
    """

    def __init__(self, target: Any, nutrients: Sequence[str], sink: Sink) -> None:
        sets = layout(nutrients)
        self._target = target
        self._nutrients = nutrients
        self._sets = {path: kind for path, kind in sets.items() if path not in SPARSE}
        self._sparse = {path: sets[path] for path in SPARSE}
        self._sink = sink
        self._pieces = {p: [_zeros(kind, int(kind.pool == "ends"))] for p, kind in sets.items()}
        self._ends = {path: 0 for path, kind in sets.items() if kind.pool == "ends"}
        self._lengths: dict[str, int] = {}
        self._made: set[str] = set()
        self._size = 0
        self.digests: list[int] = []  # of the frames so far
        self.shared: dict[str, list[NDArray[Any]]] = {path: [] for path in _shared(sets)}

    def add(self, arrays: Arrays, check: int, log: Arrays) -> None:
        """Add a frame."""
        rows = frame_rows(arrays, self._nutrients)
        rows |= {f"lineage/{path}": a for path, a in log.items()}
        rows["frames/digest"] = np.array(check)
        for path, kind in self._sparse.items():
            if path in rows and path not in self._sets:  # a frame is the first to have it
                kind = kind._replace(width=(*kind.shape(rows[path]), None)[0])
                self._sets[path] = kind
                self._pieces[path] = [_zeros(kind, self._ends[kind.pool])]
            if path != INSIDE:
                rows.setdefault(path, np.zeros(len(rows["cells/id"]), kind.dtype))
        for path, kind in self._sets.items():
            if kind.pool == "frames":
                self._put(path, np.asarray(rows[path], kind.dtype)[None])
            elif kind.pool != "ends":
                self._put(path, np.asarray(rows[path], kind.dtype))
                self._lengths[kind.pool] = len(rows[path])
        for pool, length in self._lengths.items():
            self._ends[pool] += length
            self._put(pool, np.array([self._ends[pool]], "<i8"))
        self.digests.append(check)
        if self._size > _BATCH:
            self.flush()

    def _put(self, path: str, rows: NDArray[Any]) -> None:
        self._pieces[path].append(rows)
        self._size += rows.nbytes

    def flush(self, *, last: bool = False) -> None:
        """Hand what was collected to HDF5; behind the ``last`` of it comes no more."""
        begun = [path for path in self._sets if self._pieces[path]]
        columns = {path: np.concatenate(self._pieces[path]) for path in begun}
        for path, kind, rows in _tables(self._sets, columns, column_places(columns)):
            if path in self._made:
                column = self._target[path]
                column.resize(len(column) + len(rows), axis=0)
                column[len(column) - len(rows) :] = rows
            else:
                _create(self._target, path, kind, rows, grows=not last)
                self._made.add(path)
        for path, rows in columns.items():
            if path in self.shared:
                self.shared[path].append(rows)
            self._pieces[path].clear()
        self._size = 0
        self._sink.check()


def _zeros(kind: DatasetKind, rows: int) -> NDArray[Any]:
    return np.zeros((rows, *kind.shape(np.empty((0, 0)))), kind.dtype)


def _shared(sets: Mapping[str, DatasetKind]) -> list[str]:
    """Return the data sets of what belongs to no single frame: offsets, times and the lineage."""
    return [
        path
        for path, kind in sets.items()
        if path.startswith(("frames/", "lineage/")) or kind.pool == "ends"
    ]


_SUPERBLOCK: Final = 48  # bytes: a signature of 8, the version, ..., marks at 11, ..., a checksum


def _unmarked(path: Path) -> bytes | None:
    """Return the bytes of a file that HDF5 takes for one that is being written, without its marks.

    A program that has the file open for writing, or was killed then, leaves them; HDF5 refuses such
    a file, whole as it may be. Checksums show whether it is. None where there are no marks.
    """
    with file_errors("read", path), path.open("rb") as file:
        head = file.read(_SUPERBLOCK)
        begins = head.startswith(b"\x89HDF\r\n\x1a\n\x03") and len(head) == _SUPERBLOCK
        if not begins or not head[11]:
            return None
        plain = head[:11] + b"\0" + head[12:-4]
        right = _lookup3(plain).to_bytes(4, "little")
        if head[-4:] not in (right, _lookup3(head[:-4]).to_bytes(4, "little")):
            return None  # HDF5 will say what is wrong with it
        return plain + right + file.read()


def _lookup3(data: bytes) -> int:
    """Return HDF5's checksum of up to a multiple of 12 bytes (B. Jenkins, 2006: ``hashlittle``)."""
    mask, size = 0xFFFFFFFF, len(data)

    def turned(x: int, by: int) -> int:
        return (x << by | x >> (32 - by)) & mask

    words: list[int] = [x for (x,) in struct.iter_unpack("<I", data + bytes(-size % 12))]
    a = b = c = (0xDEADBEEF + size) & mask
    while len(words) > 3:
        a, b, c = a + words[0] & mask, b + words[1] & mask, c + words[2] & mask
        for by in (4, 6, 8, 16, 19, 4):
            a = (a - c & mask) ^ turned(c, by)
            a, b, c = b, c + b & mask, a
        words = words[3:]
    a, b, c = a + words[0] & mask, b + words[1] & mask, c + words[2] & mask
    for by in (14, 11, 25, 16, 4, 14, 24):
        c = (c ^ b) - turned(b, by) & mask
        a, b, c = b, c, a
    return b


@contextmanager
def _open_file(path: Path, image: bytes | None = None) -> Iterator[Any]:
    """Open a file for reading and turn all that HDF5 has to say into words.

    Not in HDF5's mode for files that are being written: in that a damaged one is read again and
    again for ever. Nor with locks: a file of ours is never changed, and its checksums show changes
    by others.

    - ``image``: all bytes, in place of those on disk
    """
    try:
        with _opened(path, image) as file:
            yield file
    except Exception as error:  # h5py raises almost any kind where a file is damaged
        found = error if isinstance(error, OutputError) else _in_words(path, error)
        if image is not None and found.damaged and _is_locked(path):
            problem = f"'{path}' is open for writing in another program: close it there"
            raise OutputError(problem) from error
        if found is error:
            raise
        raise found from error


def _opened(path: Path, image: bytes | None) -> Any:
    if image is None:
        return h5py.File(path, "r", libver=_LIBVER, locking=False)
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_fapl_core(backing_store=False)
    access.set_file_image(image)
    return h5py.File(h5py.h5f.open(b"image", h5py.h5f.ACC_RDONLY, access))


def _is_locked(path: Path) -> bool:
    """Return whether HDF5 of another program holds a file."""
    try:
        h5py.File(path, "r", locking=True).close()
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def _in_words(path: Path, error: Exception) -> OutputError:
    """Return HDF5's error about a file in words: damage, or a machine that cannot read it."""
    if isinstance(error, MemoryError):
        return OutputError(f"cannot read '{path}': there is not enough memory")
    number = getattr(error, "errno", None)  # of the system; HDF5 has none of its own
    if number is None or number == errno.EINVAL:  # a place in the file that cannot be
        problem = f"cannot read '{path}': it is damaged ({_short(error)})"
        return OutputError(problem, damaged=True)
    return OutputError(f"cannot read '{path}': {os.strerror(number)}")


def check_whole(path: Path) -> str:
    """Return the text of the scene in a file; other data are not read.

    Raises OutputError for a file that is missing, cut short, or not one of ours.
    """
    if not path.is_file():
        raise OutputError(f"'{path}' is missing")
    with _open_file(path, _unmarked(path)) as file:
        _check_format(path, file)
        text: str = file["scene"][()].tobytes().decode("utf-8", "replace")
    return text


def check_readable(path: Path) -> None:
    """Read all data of a file of HDF5, whatever it holds; raises OutputError if that fails."""
    with _open_file(path) as file:
        groups = [file]
        while groups:
            for entry in groups.pop().values():
                if isinstance(entry, h5py.Group):
                    groups.append(entry)
                elif isinstance(entry, h5py.Dataset) and entry.shape:
                    batch = max(1, _BATCH * len(entry) // max(entry.nbytes, 1))
                    for begin in range(0, len(entry), batch):
                        entry[begin : begin + batch]


def _check_format(path: Path, file: Any) -> bool:
    """Refuse a file of another format; return whether it has tables."""
    written = file.attrs.get("format", 0)
    for known in (FRAMES_FORMAT, FORMAT_WITHOUT_TABLES):
        if np.array_equal(written, known):
            return known == FRAMES_FORMAT
    problem = f"'{path}' has result format {written}; this multicell reads formats "
    raise OutputError(f"{problem}{FORMAT_WITHOUT_TABLES} and {FRAMES_FORMAT}")


def _check_links(path: Path, group: Any, depth: int) -> None:
    """Refuse links, groups below a depth, and data that are kept in another file."""
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            raise _damage(path, f"{name} is a link")
        entry = group[name]
        if isinstance(entry, h5py.Group):
            if not depth:
                raise _damage(path, f"{name} is a group")
            _check_links(path, entry, depth - 1)
        elif isinstance(entry, h5py.Dataset) and (
            entry.is_virtual or entry.id.get_create_plist().get_external_count()
        ):
            raise _damage(path, f"{name} keeps its data elsewhere")


def _damage(path: Path, problem: str) -> OutputError:
    return OutputError(f"'{path}' is damaged: {problem}", damaged=True)


_RATIO: Final = 1032  # of what deflate unpacks to what it unpacks it from, at most
_FILTERS: Final = {
    getattr(h5py.h5z, f"FILTER_{name}") for name in ("DEFLATE", "LZF", "SHUFFLE", "FLETCHER32")
}
"""Those that unpack to no more than that; others make much of nothing."""


def _check_sets(path: Path, file: Any, sets: Mapping[str, DatasetKind]) -> dict[str, int]:
    """Refuse data sets that are not of their kinds, before any of them is read.

    What is resized in a file takes no room there, and memory where it is read. Returns the number
    of rows by pool, where the history is one.
    """
    lengths: dict[str, int] = {}
    for name, kind in sets.items():
        column = file.get(name)
        if column is None and name in SPARSE:
            continue
        if not isinstance(column, h5py.Dataset) or column.dtype != np.dtype(kind.dtype):
            raise _damage(path, f"{name} is not what it should be")
        width = kind.shape(column)
        if column.shape[:1] + width != column.shape:
            raise _damage(path, f"{name} has the shape {column.shape}")
        storage = column.id.get_create_plist()
        filters = {storage.get_filter(k)[0] for k in range(storage.get_nfilters())}
        rows = max(len(column), column.chunks[0] if column.chunks and len(column) else 0)
        size = rows * column.dtype.itemsize * math.prod(width)
        if not filters <= _FILTERS or size > _RATIO * column.id.get_storage_size():
            raise _damage(path, f"{name} says that it is larger than it can be")
        pool = name.partition("/")[0] if kind.pool == "" else kind.pool
        if lengths.setdefault(pool, len(column)) != len(column):
            raise _damage(path, f"{name} has {len(column)} rows")
    frames = lengths["frames"]
    if lengths["ends"] != frames + 1:
        raise _damage(path, f"there are {frames} frames and {lengths['ends']} ends of them")
    return lengths


def _short(error: BaseException) -> str:
    lines = str(error).strip("'\" ").splitlines()
    return lines[0][:200] if lines else type(error).__name__


@final
class _Columns:
    """The data sets of an open file, for one who goes through their rows.

    HDF5 takes as long to find a few rows as to read many, and h5py's objects longer than either.

    - ``places``: where columns of tables are; a table is read as a whole
    - ``ahead``: bytes of a data set that are read at once
    - ``sets``: kinds of data sets by path, of which only the types are asked for
    - ``known``: columns that need not be read
    """

    def __init__(
        self,
        file: Any,
        places: Places,
        ahead: int = _AHEAD,
        sets: Mapping[str, DatasetKind] = MappingProxyType({}),
        known: Mapping[str, NDArray[Any]] = MappingProxyType({}),
    ) -> None:
        self._file, self._places, self._ahead, self._sets = file.id, places, ahead, sets
        self._known: dict[str, _Column | NDArray[Any]] = {**known}
        self._there: dict[str, bool] = {}

    def __contains__(self, path: str) -> bool:
        if path not in self._there:  # h5py's own answer goes to every group on the way
            self._there[path] = self._file.links.exists(path.encode())
        return self._there[path]

    def __getitem__(self, path: str) -> _Column | NDArray[Any]:
        found = self._known.get(path)
        if found is None and path in self._places:
            rows = self.whole(self._places[path][0])
            for column, (table, field) in self._places.items():
                if table == self._places[path][0]:
                    self._known[column] = np.ascontiguousarray(rows[field])
            found = self._known[path]
        if found is None:
            rows = h5py.h5d.open(self._file, path.encode())
            shape = rows.shape
            kind = np.dtype(self._sets[path].dtype) if path in self._sets else rows.dtype
            if kind.itemsize * math.prod(shape) <= self._ahead:
                found = np.empty(shape, kind)
                if found.size:
                    rows.read(h5py.h5s.ALL, h5py.h5s.ALL, found, _type(kind))
            else:
                found = _Column(rows, self._ahead)
            self._known[path] = found
        return found

    def whole(self, path: str) -> NDArray[Any]:
        """Return all rows of a data set."""
        found = self[path]
        return found.whole() if isinstance(found, _Column) else found


@final
class _Column:
    """A data set of which blocks of rows are kept until others are asked for."""

    def __init__(self, rows: Any, ahead: int) -> None:
        self._rows, self._shape, self._type = rows, rows.shape, rows.dtype
        self._block = max(1, ahead // (self._type.itemsize * math.prod(self._shape[1:])))
        self._begin, self._held = 0, np.empty((0, *self._shape[1:]), self._type)

    def __len__(self) -> int:
        return int(self._shape[0])

    def __getitem__(self, wanted: int | slice) -> NDArray[Any]:
        if not isinstance(wanted, slice):
            row: NDArray[Any] = self[wanted : wanted + 1][0]
            return row
        begin, end = wanted.start, wanted.stop
        if begin < self._begin or end > self._begin + len(self._held):
            self._begin, self._held = begin, self._read(begin, max(end, begin + self._block))
        found: NDArray[Any] = self._held[begin - self._begin : end - self._begin]
        return found

    def _read(self, begin: int, end: int) -> NDArray[Any]:
        """Return rows of the file, as many of these as there are."""
        rows = max(0, min(end, len(self)) - begin)
        found = np.empty((rows, *self._shape[1:]), self._type)
        if rows == len(self) and found.size:
            self._rows.read(h5py.h5s.ALL, h5py.h5s.ALL, found, _type(self._type))
        elif found.size:
            space = self._rows.get_space()
            space.select_hyperslab((begin, *(0 for _ in self._shape[1:])), found.shape)
            self._rows.read(h5py.h5s.create_simple(found.shape), space, found)
        return found

    def whole(self) -> NDArray[Any]:
        """Return all rows."""
        return self._read(0, len(self))


def _names(inner: Any) -> tuple[str, ...]:
    """Return the names in a group, or of the fields of a table's type, by h5py's inner objects."""
    if not isinstance(inner, h5py.h5g.GroupID):
        inner = map(inner.get_member_name, range(inner.get_nmembers()))
    names = tuple(name.decode() for name in inner)
    if not "".join(names).isprintable():
        raise ValueError(f"{names} are no names")
    return names


def _attribute(owner: Any, name: str) -> Any:
    """Return an attribute of one of h5py's objects, in a tenth of the time that these take."""
    found = h5py.h5a.open(owner.id, name.encode())
    value = np.empty(found.shape, found.dtype)
    found.read(value)
    return value[()]


@final
class File:
    """A result file that has been checked; frames are read, and checked, one at a time.

    - ``times`` s, ``steps``, ``digests``, (k,)
    - ``ends``, log -> (k + 1,) int64: how many rows each log of the lineage has before each frame
    - ``logs``, log/column -> array: the lineage up to the last frame
    - ``columns``, ``rows``: names of the columns and number of rows of the history

    Raises OutputError if it is no result file of this format, or damaged. Of one that this process
    has just written (``own``) only data and checksums are looked at, but all of them: it holds no
    traps.
    """

    def __init__(self, path: Path, *, own: bool = False) -> None:
        self.path, self._image = path, _unmarked(path)
        with _open_file(path, self._image) as file:
            tables = own or _check_format(path, file)
            if not own:
                _check_links(path, file, 2)
            self.nutrients = tuple(sorted(_names(h5py.h5g.open(file.id, b"fields"))))
            history = h5py.h5o.open(file.id, b"history")
            apart = isinstance(history, h5py.h5g.GroupID)
            self.columns = _names(history if apart else history.get_type())
            known = layout(self.nutrients)
            sets = {f"history/{name}": of_rows("<f8") for name in self.columns}
            sets |= {"scene": of_rows("|u1"), **known}
            self._places = column_places(sets, history=not apart) if tables else {}
            sets = stored_sets(sets, self._places)
            lengths = {} if own else _check_sets(path, file, sets)
            columns = _Columns(file, self._places, sets=sets)
            shared = {name: columns.whole(name) for name in ("scene", *_shared(known))}
            if array_digest(shared) != int(_attribute(file, "digest")):
                problem = "its scene, index or lineage is not what was written"
                raise _damage(path, f"{problem}. Nothing in it can be read")
            self.rows = len(columns[f"history/{self.columns[0]}"]) if self.columns else 0
            if not self.rows:  # nobody will ask for them
                self._history(file, columns)
            for name, ends in shared.items():
                if (
                    lengths
                    and name.endswith("/offset")
                    and (ends[0] or ends[-1] != lengths[name] or (np.diff(ends) < 0).any())
                ):
                    raise _damage(path, f"{name} does not count rows")
            self.identity, self.absorbed = (
                _attribute(file, key).decode("ascii") for key in ("identity", "absorbed")
            )
            self._offsets = {path: a for path, a in shared.items() if path.endswith("/offset")}
            self.times, self.steps = shared["frames/time"], shared["frames/step"]
            self.digests = shared["frames/digest"]
            self.scene = shared["scene"].tobytes().decode("utf-8", "replace")
            self.ends = {log: shared[f"lineage/{log}/offset"] for log in LINEAGE_COLUMNS}
            self.logs = {
                f"{log}/{name}": shared[f"lineage/{log}/{name}"]
                for log, names in LINEAGE_COLUMNS.items()
                for name in names
            }
            self._read: list[Arrays] = self._all(file, columns) if own else []

    def history(self) -> dict[str, NDArray[np.float64]]:
        """Return the history by column, (m,) each."""
        with self._again() as file:
            return self._history(file, _Columns(file, self._places))

    def _history(self, file: Any, columns: _Columns) -> dict[str, NDArray[np.float64]]:
        found = {name: columns.whole(f"history/{name}") for name in self.columns}
        if array_digest(found) != int(_attribute(file["history"], "digest")):
            problem = f"the history in '{self.path}' is not what was written"
            raise OutputError(problem, damaged=True)
        return found

    def frame(self, place: int) -> Arrays:
        """Return the arrays of a frame; raises OutputError if they are not what was written."""
        if frames := _frames_of(self):
            return {path: array.copy() for path, array in frames[place].items()}
        with self._again() as file:
            known = {"frames/time": self.times, "frames/step": self.steps}
            return self._frame(_Columns(file, self._places, ahead=0, known=known), place)

    def check(self) -> None:
        """Read all of it once; raises OutputError if something is not what was written."""
        with self._again() as file:
            self._all(file, _Columns(file, self._places))

    def take_frames(self) -> list[Arrays]:
        """Return the frames as they were read back, and forget them; none if they are many."""
        found, self._read = self._read, []
        return found

    def _all(self, file: Any, columns: _Columns) -> list[Arrays]:
        """Read all of it once; return the frames, or none if they take much memory."""
        self._history(file, columns)
        found, size = [], 0
        for place in range(len(self.digests)):
            arrays = self._frame(columns, place)
            size += sum(array.nbytes for array in arrays.values())
            found.append(arrays) if size <= _BATCH else found.clear()
        return found

    def _frame(self, columns: _Columns, place: int) -> Arrays:
        arrays = read_frame(columns, place, self.nutrients, self._offsets)
        if array_digest(arrays) != int(self.digests[place]):
            raise OutputError(f"it is not what was written to '{self.path}'", damaged=True)
        return arrays

    def log(self, place: int) -> Arrays:
        """Return the rows of the lineage that are new with a frame."""
        rows = {log: slice(*map(int, ends[place : place + 2])) for log, ends in self.ends.items()}
        return {path: column[rows[path.split("/")[0]]] for path, column in self.logs.items()}

    @contextmanager
    def _again(self) -> Iterator[Any]:
        """Open the file once more, and make sure that it still is the same one."""
        with _open_file(self.path, self._image) as file:
            if _attribute(file, "identity").decode("ascii") != self.identity:
                raise OutputError(f"'{self.path}' has been replaced since it was opened")
            yield file
