"""Read files and TOML of any origin at a bounded cost."""

from __future__ import annotations

import errno
import json
import os
import re
import stat
from pathlib import Path
from typing import Any, Final

from multicell.errors import SceneError

DEEPEST: Final = 20  # parts of a dotted key of TOML; those of a scene have at most seven

_NAME: Final = (
    r"""(?:"{3}(?:[^"\\]|\\.|"(?!""))*+(?:"{3})?"""
    r"""|'{3}(?:[^']|'(?!''))*+(?:'{3})?"""
    r"""|"(?:[^"\\\n]|\\.)*+"?|'[^'\n]*+'?|[A-Za-z0-9_-]++)"""
)
_DEEP: Final = re.compile(
    rf"(?P<deep>{_NAME}(?:[ \t]*+\.[ \t]*+{_NAME}){{{DEEPEST}}})|{_NAME}|\#[^\n]*+", re.DOTALL
)
"""Finds keys, texts and remarks one after another, each once; too many parts as ``deep``."""


def read_regular(path: Path, largest: int) -> bytes:
    """Return the content of a regular file.

    - ``path``: the file. A link to one is one; a pipe or a device, which may never end, is none.
    - ``largest``: number of bytes that it may have
    """
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    descriptor = os.open(path, flags)
    with os.fdopen(descriptor, "rb") as file:
        about = os.fstat(descriptor)
        if stat.S_ISDIR(about.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(about.st_mode):
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
        size = about.st_size
        # one byte more than it has: memory for as many as it may have would be asked for at once
        content = file.read(size + 1) if size <= largest else b""
    if max(size, len(content)) > largest:
        most = f"{largest // 10**6:,} MB" if largest >= 10**6 else f"{largest:,} bytes"
        raise OSError(errno.EFBIG, f"it is larger than {most}", str(path))
    return content


OTHER_FILE: Final = "is not the file that the scene was made with"


def other_file(path: str) -> SceneError:
    """Return an error: the digest of a file is not the one that the scene states."""
    return SceneError("file", f"'{path}' {OTHER_FILE}", "Leave sha256 out to take it as it is now.")


def name_beside(file: str, folder: Path) -> str:
    """Return how a file in a folder names another one: by its name alone if it is there too."""
    place, name = os.path.split(file)
    return name if place == os.path.abspath(folder) else file


def read_text(path: Path, largest: int) -> str:
    r"""Return the text of a regular file, its lines ending in ``\n``, as :func:`read_regular`."""
    text = read_regular(path, largest).decode("utf-8-sig")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_text_of_others(path: Path, largest: int) -> str:
    """Return the text of a file as :func:`read_text`; SceneError with its name where it cannot."""
    name = str(path)
    try:
        return read_text(path, largest)
    except FileNotFoundError:
        raise SceneError("", f"there is no file '{name}'") from None
    except UnicodeDecodeError as error:
        raise SceneError("", f"'{name}' is not UTF-8 text (byte {error.start})") from None
    except OSError as error:
        raise SceneError("", f"'{name}' cannot be read: {error.strerror}") from None


def parse_json(text: bytes | str) -> Any:
    """Return the value that JSON describes; ValueError or RecursionError where there is none."""
    value = json.loads(text.decode() if isinstance(text, bytes) else text)
    json.dumps(value, ensure_ascii=False).encode()  # fails for halves of letters
    return value


def parse_toml(text: str) -> dict[str, Any]:
    """Return the table that a TOML text describes."""
    import tomllib

    for found in _DEEP.finditer(text):
        if found["deep"]:
            line = text.count("\n", 0, found.start()) + 1
            raise ValueError(f"a key has more than {DEEPEST} parts (at line {line})")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
