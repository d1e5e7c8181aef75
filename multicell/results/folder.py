"""The output folder of a run and the small files in it."""

from __future__ import annotations

import errno
import glob
import json
import math
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from filelock import FileLock, Timeout

from multicell import __version__
from multicell.errors import OutputError
from multicell.host.interrupts import UNCUT
from multicell.scene.own_files import COPIED_FIELD, COPIED_NETWORK, files_copied
from multicell.scene.scene import Scene
from multicell.scene.start_table import COPIES

RUN_FILES: Final = (
    "scene.toml",
    *COPIES,
    "frames.h5",
    "summary.json",
    "report.html",
    "growth.png",
    "section.png",
    "fields.png",
    "profiles.png",
    "contacts.png",
    "pull.png",
)
"""What a run leaves in its output folder; overwriting removes it, and copies of files that a
scene names."""

PASSING: Final = ("frames.journal", "scene.toml.next")
"""Files that are there only during a run, or after it was killed or met a full disk."""

LIVE: Final = ("live.png", "live.html")
"""Picture of the tissue during a run, and the page that shows it: no results, and gone at its end.
"""

LOCK: Final = ".multicell.lock"
"""A file that is locked while a run writes into its folder; it is not there at other times."""

_PACKAGES: Final = ("numpy", "scipy", "numba", "scikit-sundae", "py-pde", "h5py")


@cache
def package_version(package: str = "multicell") -> str:
    """Return the version of a package, or ``"not installed"``."""
    if package == "multicell":
        return __version__
    name = f"{package.replace('-', '_')}-*.dist-info"
    found = [
        place for folder in sys.path for place in glob.glob(os.path.join(glob.escape(folder), name))
    ]
    if len(found) == 1:  # as nearly always, and Python's own search takes 0.02 s to be loaded
        with suppress(OSError):
            text = Path(found[0], "METADATA").read_text("utf-8", "replace")
            if said := re.search(r"^Version: *(\S+)", text, re.MULTILINE):
                return said[1]
    from importlib import metadata

    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


def versions() -> dict[str, str]:
    """Return the versions of multicell and of the packages that decide its numbers."""
    return {name: package_version(name) for name in ("multicell", *_PACKAGES)}


@contextmanager
def file_errors(action: str, path: Path) -> Iterator[None]:
    """Turn the system's refusal of a file into an error with words."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        if isinstance(error, FileNotFoundError) and not path.parent.exists():
            reason = f"there is no folder '{path.parent}'"
        raise OutputError(f"cannot {action} '{path}': {reason}") from error


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Keep other runs out of a folder; the lock of a process that is killed is gone with it."""
    path = folder / LOCK
    lock = FileLock(path, timeout=0, thread_local=False)
    with file_errors("use the output folder", folder):
        if path.is_symlink():  # a lock is a file of its own, never one that a link names
            path.unlink()
        try:
            lock.acquire()
        except Timeout:
            raise OutputError(
                f"another run uses '{folder}': wait for its end or choose another folder",
                in_use=True,
            ) from None
    try:
        yield
    finally:
        # removed while it is held: who waits for it sees that it has no name any more
        with suppress(OSError):
            path.unlink()
        lock.release()


def in_use(folder: Path) -> bool:
    """Return whether a run uses a folder; the folder stays as it is."""
    path = folder / LOCK
    try:
        if not path.is_file() or path.is_symlink():
            return False
        lock = FileLock(path, timeout=0, thread_local=False)
        lock.acquire()
    except Timeout:
        return True
    except OSError:
        return False  # whoever is going to write there will say what is wrong
    lock.release()
    return False


def refuse_results(folder: Path, *, overwrite: bool) -> list[str]:
    """Return the names in an output folder; refuse any if they may not be overwritten."""
    with file_errors("use the output folder", folder):
        entries = folder.iterdir() if folder.is_dir() else ()
        held = sorted(entry.name for entry in entries if entry.name != LOCK)
    if held and not overwrite:
        raise OutputError(
            f"output folder '{folder}' is not empty (it holds {held[0]}"
            f"{f' and {len(held) - 1} more' if len(held) > 1 else ''}). "
            "Choose another folder, or allow overwriting (--overwrite, overwrite=True)"
        )
    return held


def make_folder(folder: str | Path, *, overwrite: bool = False, synced: bool = True) -> Path:
    """Make an output folder, or refuse one that holds something and may not be overwritten.

    - ``synced``: whether its name is on the disk itself when this returns
    """
    folder = Path(folder)
    with file_errors("use the output folder", folder):
        if not folder.is_dir():
            if folder.exists():
                raise OutputError(f"output '{folder}' is a file, not a folder")
            if folder.is_symlink():
                raise OutputError(
                    f"output '{folder}' is a link to '{folder.readlink()}' that is missing"
                )
            new = [place for place in (folder, *folder.parents) if not place.exists()]
            folder.mkdir(parents=True, exist_ok=True)
            for place in new if synced else ():
                sync_folder(place.parent)
    held = refuse_results(folder, overwrite=overwrite)
    if held and folder.is_symlink():
        raise OutputError(
            f"output '{folder}' is a link to '{folder.readlink()}': to overwrite what is there, "
            "name that folder itself"
        )
    return folder


def begun_files(folder: str | Path) -> set[str]:
    """Return the names of files in a folder, without those that are there only during a run."""
    with suppress(OSError):
        held = {entry.name for entry in Path(folder).iterdir()}
        return held - {LOCK, *LIVE} - {f"{name}.part" for name in LIVE}
    return set()


def is_begun(folder: str | Path, content: Mapping[str, bytes | str]) -> bool:
    """Return whether a folder holds nothing but what is to be written there first.

    So one looks whose disk was full, or whose process was killed, before there was any result.

    - ``content``: of those files, by name; some may be lacking, or be written in part
    """
    folder, held = Path(folder), begun_files(folder)
    with suppress(OSError):  # whoever is going to write there will say what is wrong
        known = {name: c.encode() if isinstance(c, str) else c for name, c in content.items()}
        parts = {f"{name}.part" for name in known}
        return bool(held) and all(
            name in known and (folder / name).read_bytes() == known[name] for name in held - parts
        )
    return False


def copied_files(folder: Path) -> list[str]:
    """Return the names of the copies of networks and of beginnings of fields in a folder."""
    with file_errors("read", folder):
        there = os.listdir(folder)
    return [name for name in there if Path(name).stem.endswith((COPIED_NETWORK, COPIED_FIELD))]


def remove(folder: Path, names: Iterable[str]) -> None:
    """Remove files of a run, also half-written ones; of links the links, not what they lead to."""
    with file_errors("read", folder):
        there = set(os.listdir(folder))
    for name in names:
        for file in there & {name, f"{name}.part"}:
            with file_errors("remove", folder / file):
                (folder / file).unlink(missing_ok=True)


def new_file(path: Path) -> int:
    """Create a file, in the place of a file or link of this name, and return its descriptor.

    What a link leads to is never written to.
    """
    path.unlink(missing_ok=True)
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)


Check = Callable[[Path], object]  # reads a file back; raises OutputError where that is not right


@contextmanager
def replace_by_name(
    path: Path, check: Check, beside: str = "part", *, synced: bool = True
) -> Iterator[Path]:
    """Give another name for what becomes ``path`` when it is complete, on disk and checked.

    No signal cuts the block: all of them, however often they come, wait for its end. Whatever
    happens, under ``path`` there is the old file or the new one, and nothing beside it. A process
    that is killed leaves the file with the other name.

    - ``check``: reads the new file back, with the old one still in its place
    - ``beside``: ending of the other name; one of its own where several processes may write
    - ``synced``: whether the name is on the disk, too; else the next one in this folder takes it
    """
    part = path.with_name(f"{path.name}.{beside}")
    with UNCUT, file_errors("write", path), ExitStack() as stack:
        if path.is_dir():
            raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))
        part.unlink(missing_ok=True)
        stack.callback(part.unlink, missing_ok=True)
        yield part
        sync_file(part)
        check(part)
        put_in_place(part, path) if synced else part.replace(path)
        stack.pop_all()


@contextmanager
def replace_file(
    path: Path, check: Check, beside: str = "part", *, synced: bool = True
) -> Iterator[IO[bytes]]:
    """Write a file as :func:`replace_by_name` does, by bytes that can be read and sought."""
    with (
        replace_by_name(path, check, beside, synced=synced) as part,
        os.fdopen(new_file(part), "w+b") as file,
    ):
        yield file


def put_in_place(part: Path, path: Path) -> None:
    """Move a file whose content is on disk to its name, and have that on disk too.

    After a loss of power there is then the old file or the new one.
    """
    part.replace(path)
    sync_folder(path.parent)


def sync_file(path: Path) -> None:
    """Have the content of a file on disk that another library has written."""
    # Windows flushes only what is open for writing
    descriptor = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_folder(folder: Path) -> None:
    """Have the names in a folder on disk too, where the system can do that."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def write_bytes(path: Path, data: bytes, *, synced: bool = True) -> None:
    """Write a file so that it is either the old one or complete; see :func:`replace_by_name`."""

    def check(part: Path) -> None:
        if part.read_bytes() != data:
            raise OutputError(f"cannot write '{path}': it does not read back as it was written")

    with replace_file(path, check, synced=synced) as file:
        file.write(data)


def write_text(path: Path, text: str, *, synced: bool = True) -> None:
    """Write a text file as :func:`write_bytes` does."""
    write_bytes(path, text.encode("utf-8"), synced=synced)


def plain_json(value: Any) -> Any:
    """Return a value as JSON can hold it; JSON knows no NaN or infinity, they become null."""
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, Mapping):
        return {str(key): plain_json(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain_json(value.tolist())
    if isinstance(value, list | tuple):
        return [plain_json(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, Path):
        return str(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def to_json(value: Any) -> str:
    """Return strict JSON; NumPy values become plain ones, NaN and infinity become null."""
    return json_text(plain_json(value))


def json_text(plain: Any) -> str:
    """Return a value of :func:`plain_json` as indented text."""
    return json.dumps(plain, indent=2, ensure_ascii=False, allow_nan=False)


def with_copy(scene: Scene, folder: Path) -> Scene:
    """Return a scene that names copies of its files in a folder; they are written if not there.

    Those are a table of cells, networks, and what fields begin as. A scene without them is
    returned as it is.
    """
    copied, files = copy_of(scene, folder)
    write_copies(folder, files)
    return copied


def write_copies(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files, name -> content, that are not in a folder yet."""
    for name, content in files.items():
        path = folder / name
        if not path.is_file() or path.read_bytes() != content:
            write_bytes(path, content)


def copy_of(scene: Scene, folder: Path) -> tuple[Scene, dict[str, bytes]]:
    """Do as :func:`with_copy`, and return the content of the copies by their names."""
    table, files = scene.initial.cells, {}
    if table is not None:
        name, content = table.content()
        cells = replace(table, file=str(folder / name), columns="", frame=None, time=None)
        scene = replace(scene, initial=replace(scene.initial, cells=cells))
        files[name] = content
    scene, more = files_copied(scene, folder)
    return scene, {**files, **more}
