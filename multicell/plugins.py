"""Objects of the user's own, named as ``file.py:Name``: a pair law, an integrator.

A file is loaded only where the user names it, as an argument or on the command line. What a scene
file or a result folder names is text, which is never executed.
"""

from __future__ import annotations

import hashlib
import re
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from multicell.errors import SceneError
from multicell.files import read_regular
from multicell.schema import near_miss

_LARGEST = 10_000_000
"""Bytes of a file of the user's own."""
OWN_OBJECT = r"^.+\.py:[A-Za-z_].*$"
"""Pattern of how a scene names an object of the user's own, for editors."""
_NAMED = re.compile(r"(?P<file>.+):(?P<name>[^\W\d]\w*(\.[^\W\d]\w*)*)")
_RECORDED = re.compile(_NAMED.pattern + r"(\(.*\))?")


def recorded_object(text: str) -> bool:
    """Return whether a text has the form of a record, ``file.py:Name`` or ``file.py:Name(…)``."""
    return bool(_RECORDED.fullmatch(text)) and text.isprintable()


def load_object(spec: str, what: str) -> Any:
    """Return the object that ``file.py:Name`` names.

    The file runs once; a file that has changed since runs again. Its module has a name that
    depends on the path alone, so that numba finds its compiled functions in another process.

    Parameters
    ----------
    spec
        Path of a Python file, a colon and the name of something in it.
    what
        What it is for, as the path of errors: ``"integrator"``, ``"law"``.

    Raises
    ------
    SceneError
        If the text has another form, there is no such file or no such name in it, or the file
        raises an exception.
    """
    match = _NAMED.fullmatch(spec)
    if match is None:
        raise SceneError(what, f"is {spec!r}, must be the form 'file.py:Name'")
    file, name = Path(match["file"]).expanduser(), match["name"]
    found: Any = _module(file, what)
    known = [key for key in vars(found) if not key.startswith("_")]
    for part in name.split("."):
        if not hasattr(found, part):
            problem = f"'{file}' has nothing called {name!r}"
            raise SceneError(what, problem, near_miss(name, known))
        found = getattr(found, part)
    return found


def origin(kind: type[Any]) -> str:
    """Return where a class comes from, as ``/path/to/file.py:Name``.

    A class that was typed in at a prompt comes from ``__main__:Name``.
    """
    module = sys.modules.get(kind.__module__)
    file = getattr(module, "__file__", None)
    return f"{Path(file).resolve() if file else kind.__module__}:{kind.__qualname__}"


def _module(file: Path, what: str) -> ModuleType:
    """Return the module of a file, loaded unless it is there already with the same text."""
    if file.suffix != ".py":
        raise SceneError(what, f"'{file}' is no Python file: its name must end in .py")
    try:
        source = read_regular(file, _LARGEST)
    except FileNotFoundError:
        hint = f"It is looked for in '{Path.cwd()}'." if not file.is_absolute() else ""
        raise SceneError(what, f"there is no file '{file}'", hint) from None
    except OSError as error:
        raise SceneError(what, f"'{file}' cannot be read: {error.strerror}") from None
    path = file.resolve()
    name = f"{file.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    known = sys.modules.get(name)
    if known is not None and getattr(known, "_multicell_source", None) == source:
        return known
    spec = spec_from_file_location(name, path)
    assert spec is not None
    module = module_from_spec(spec)
    module.__dict__["_multicell_source"] = source
    # dataclasses and numba look their module up by its name
    sys.modules[name] = module
    try:
        _execute(module, source, path)
    except (Exception, SystemExit) as error:
        sys.modules.pop(name, None)
        problem = f"'{file}' raises {type(error).__name__}{_line(error, path)}: {error}"
        raise SceneError(what, problem) from error
    return module


def _execute(module: ModuleType, source: bytes, path: Path) -> None:
    """Run a file, which may import the files beside it."""
    folder = str(path.parent)
    sys.path.insert(0, folder)
    try:
        exec(compile(source, str(path), "exec"), module.__dict__)
    finally:
        sys.path.remove(folder)


def _line(error: BaseException, path: Path) -> str:
    """Return the line of a file where an exception came from, in words."""
    if isinstance(error, SyntaxError):
        return f" in line {error.lineno}"
    line, trace = None, error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            line = trace.tb_lineno
        trace = trace.tb_next
    return "" if line is None else f" in line {line}"
