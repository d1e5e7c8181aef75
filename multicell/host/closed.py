"""The folder of compiled code, which nobody else can write to, since it is run.

A folder is closed if it, all above it and every link on the way to it belong to the user or to
root, and nobody else may write there. A sticky folder such as ``/tmp`` is closed for what lies in
it and is the user's own, but not itself. Where systems know no owners (Windows) all are closed.
"""

from __future__ import annotations

import glob
import os
import site
import stat
import sys
import warnings
from collections.abc import Iterator
from functools import cache
from typing import Any, Final

from multicell.errors import is_set

PACKAGE: Final = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
PACK: Final = "multicell_kernels"
"""Name of the folder with compiled kernels that ``python -m multicell.compiling.kernels`` packs."""
_OWNERS: Final = hasattr(os, "geteuid")
_OTHERS: Final = stat.S_IWGRP | stat.S_IWOTH


def why_open(path: str) -> str:
    """Return in words why others could write to a place, which exists; nothing if they cannot."""
    if not _OWNERS:
        return ""
    path = os.path.abspath(path)
    real = os.path.realpath(path)
    for end in dict.fromkeys((path, real)):
        parts = list(_parts(end))
        for part in parts:
            about = os.lstat(part)
            if about.st_uid not in (0, os.geteuid()):
                return f"{part} belongs to another user"
            within = part != parts[-1] and about.st_mode & stat.S_ISVTX
            if not stat.S_ISLNK(about.st_mode) and not within and _others_write(about):
                return f"others can write to {part}"
    return ""


def is_own(path: str) -> bool:
    """Return whether a file in a closed folder is the user's or root's own, also behind a link."""
    if not _OWNERS:
        return True
    both = os.lstat(path), os.stat(path)
    owned = all(about.st_uid in (0, os.geteuid()) for about in both)
    return owned and not _others_write(both[1])


def _parts(path: str) -> Iterator[str]:
    """Yield a path and all folders above it, from the top."""
    above = os.path.dirname(path)
    if above != path:
        yield from _parts(above)
    yield path


def _others_write(about: os.stat_result) -> bool:
    if about.st_mode & stat.S_IWOTH:
        return True
    return bool(about.st_mode & stat.S_IWGRP) and not _is_private(about.st_gid)


@cache
def _is_private(group: int) -> bool:
    """Return whether a group is root's, or has the user as its only member.

    Many systems give each user such a group, and let it write to the user's files.
    """
    if group == 0:
        return True
    import grp
    import pwd

    try:
        known, user = grp.getgrgid(group), pwd.getpwuid(os.geteuid())
    except KeyError:
        return False
    return known.gr_name == user.pw_name and set(known.gr_mem) <= {user.pw_name}


def choose_cache(settings: dict[str, Any]) -> None:
    """Have numba keep compiled code in a closed folder.

    A folder that others can write to is replaced by a private one, which is said once.

    - ``settings``: the names of numba's module of settings; ``CACHE_DIR`` is where it keeps all
      compiled code, empty for beside the files or, where those are not the user's to write, in the
      cache folder of the user
    """
    named = settings["CACHE_DIR"]
    if named:
        why = _why_unfit(named)
    elif os.access(PACKAGE, os.W_OK):
        why = next(filter(None, map(why_open, _beside_files())), "")
    else:
        why = _why_unfit(_of_user("numba"))
    if not why:
        return
    folder = _private()
    # for this process, and for those that it starts
    settings["CACHE_DIR"] = os.environ["NUMBA_CACHE_DIR"] = folder
    words = f"compiled code, which is run, is kept in {folder}: {why}"
    warnings.warn_explicit(words, UserWarning, "multicell", 1)


def cache_folder(settings: Any) -> str:
    """Return the folder in which numba keeps the compiled code of this package."""
    if settings.CACHE_DIR:
        return str(settings.CACHE_DIR)
    return (
        os.path.join(PACKAGE, "__pycache__") if os.access(PACKAGE, os.W_OK) else _of_user("numba")
    )


def may_be_on_disk(module: str, kernel: str) -> bool:
    """Return whether any folder that numba may use has a file of a kernel, also an old one.

    - ``module``: of this package, without its name: ``"mechanics.forces"``
    """
    *above, name = module.split(".")
    # of a serial driver the file has the name of its body: forces._forces-436.py311.nbi
    folder, file = os.path.join(PACKAGE, *above), f"{name}.*{kernel}-*.nbi"
    own = f"{os.path.basename(folder)}_*"  # numba adds a digest of the path
    named = os.environ.get("NUMBA_CACHE_DIR")
    roots = [named] if named else [_of_user("numba"), *_private_folders()]
    places = [os.path.join(glob.escape(root), own, file) for root in roots]
    if not named:
        places.append(os.path.join(glob.escape(folder), "__pycache__", file))
    if pack := pack_folder():
        places.append(os.path.join(glob.escape(pack), os.path.basename(folder), file))
    return any(next(glob.iglob(place), None) for place in places)


def pack_folder() -> str:
    """Return the folder of an installed pack of compiled kernels; nothing where there is none.

    It is looked for where packages are installed, never in the working folder: to read compiled
    code is to run it. With ``MULTICELL_NO_PACK=1`` in the environment there is none.
    """
    places = [] if is_set("MULTICELL_NO_PACK") else site.getsitepackages()
    if places and site.ENABLE_USER_SITE:
        places.append(site.getusersitepackages())
    found = (os.path.join(place, PACK) for place in places)
    return next((folder for folder in found if os.path.isfile(f"{folder}/about.json")), "")


def _beside_files() -> Iterator[str]:
    """Yield the folders of this package, and those of compiled code in them."""
    for folder, below, _ in os.walk(PACKAGE):
        if os.path.basename(folder) == "__pycache__" or "__init__.py" in os.listdir(folder):
            yield folder
        else:
            below.clear()


def _why_unfit(folder: str) -> str:
    """Return why a folder cannot keep compiled code; make it if need be."""
    try:
        os.makedirs(folder, mode=0o700, exist_ok=True)
        return why_open(folder) or ("" if os.access(folder, os.W_OK) else f"{folder} is read-only")
    except OSError as error:
        return f"{folder} cannot be used ({error.strerror})"


def _of_user(name: str) -> str:
    """Return a folder of the user's for what can be made anew, where numba looks for it too."""
    if sys.platform == "darwin":
        return os.path.join(os.path.expanduser("~/Library/Caches"), name)
    above = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return os.path.join(above, name)


def _private_folders() -> tuple[str, ...]:
    """Return the folders that take the place of one that others can write to."""
    import tempfile

    user = os.geteuid() if _OWNERS else 0
    return _of_user("multicell"), os.path.join(tempfile.gettempdir(), f"multicell-{user}")


def _private() -> str:
    """Return a closed folder: of the user's, else of temporary files, else one for this process."""
    for folder in _private_folders():
        if not _why_unfit(folder):
            return folder
    import atexit
    import shutil
    import tempfile

    folder = tempfile.mkdtemp(prefix="multicell-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
