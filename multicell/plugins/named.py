"""Objects of the user's own, named as ``file.py:Name``: a pair law, an integrator.

A file is loaded only where the user names it, as an argument or on the command line. What a scene
file or a result folder names is text, which is never executed.
"""

from __future__ import annotations

import builtins
import difflib
import hashlib
import linecache
import os
import re
import sys
import sysconfig
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dis import get_instructions
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from token import NAME
from tokenize import generate_tokens
from traceback import walk_tb
from types import ModuleType
from typing import Any

from multicell.errors import MulticellError, SceneError
from multicell.host.files import read_regular
from multicell.schema import near_miss

_MAX_BYTES = 10_000_000  # bytes of a file of the user's own
OWN_OBJECT = r"^.+\.py:[A-Za-z_].*$"
"""Pattern of how a scene names an object of the user's own, for editors."""
_NAMED = re.compile(r"(?P<file>.+):(?P<name>[^\W\d]\w*(\.[^\W\d]\w*)*)")
_COMPILED = re.compile(r'File "([^"]+)", line (\d+)')  # how numba names a line of what it compiles
_MISSING = re.compile(r"(?:name|attribute) '(\w+)'")
_RECORDED = re.compile(_NAMED.pattern + r"(\(.*\))?")


def is_recorded_object(text: str) -> bool:
    """Return whether a text has the form of a record, ``file.py:Name`` or ``file.py:Name(…)``."""
    return bool(_RECORDED.fullmatch(text)) and text.isprintable()


def load_object(spec: str, what: str) -> Any:
    """Return the object that ``file.py:Name`` names.

    The file runs once; a file that has changed since runs again. Its module has a name that
    depends on the path alone, so that numba finds its compiled functions in another process.

    - ``spec``: path of a Python file, a colon and the name of something in it
    - ``what``: what it is for, as the path of errors: ``"integrator"``, ``"law"``
    """
    match = _NAMED.fullmatch(spec)
    if match is None:
        raise SceneError(what, f"is {spec!r}, must have the form 'file.py:Name'")
    file, name = Path(match["file"]).expanduser(), match["name"]
    found: Any = _module(file, what)
    known = [key for key in vars(found) if not key.startswith("_")]
    for part in name.split("."):
        if not hasattr(found, part):
            problem = f"'{file}' has nothing called {name!r}"
            raise SceneError(what, problem, near_miss(name, known))
        found = getattr(found, part)
    return found


def origin(kind: type[Any] | Callable[..., Any]) -> str:
    """Return where a class or function comes from, as ``/path/to/file.py:Name``.

    One that was typed in at a prompt comes from ``__main__:Name``.
    """
    module = sys.modules.get(kind.__module__)
    file = getattr(module, "__file__", None)
    return f"{Path(file).resolve() if file else kind.__module__}:{kind.__qualname__}"


def _module(file: Path, what: str) -> ModuleType:
    """Return the module of a file, loaded unless it is there already with the same text."""
    if file.suffix != ".py":
        raise SceneError(what, f"'{file}' is no Python file: its name must end in .py")
    try:
        source = read_regular(file, _MAX_BYTES)
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
    folder = str(path.parent)
    sys.path.insert(0, folder)  # the file may import those beside it
    try:
        exec(compile(source, str(path), "exec"), module.__dict__)
    except (Exception, SystemExit) as error:
        sys.modules.pop(name, None)
        fault = own_fault(error, lambda seen: seen == str(path))
        problem = f"'{file}' raises {type(error).__name__}: {error}"
        raise SceneError(what, fault or problem) from error
    finally:
        sys.path.remove(folder)
    return module


def own_fault(
    error: BaseException,
    own: Callable[[str], bool] | None = None,
    function: Callable[..., Any] | None = None,
) -> str | None:
    """Return in words where code of the user's has failed; None if it has no part in an error.

    - ``error``: raised by that code, or by numba where it cannot be compiled
    - ``own``: whether a file is the user's, by default those that :func:`load_object` has loaded,
      and what they import from their folders
    - ``function``: what was compiled: numba does not always say in which line a name is missing
    """
    own = _is_loaded if own is None else own
    known: BaseException | None = error
    while known is not None:
        for file, line in reversed(list(_lines(known))):
            if not _is_installed(file) and own(file):
                return f"'{file}', line {line}, {_message(known, file)}"
        known = known.__cause__ or known.__context__
    if function is None:
        return None
    code = function.__code__
    uses = (part for part in get_instructions(code) if part.argval == _missing_name(error))
    at = next((part.positions.lineno for part in uses if part.positions), code.co_firstlineno)
    return f"'{code.co_filename}', line {at}, {_message(error, code.co_filename)}"


@contextmanager
def own_code(path: str, function: Callable[..., Any] | None = None) -> Iterator[None]:
    """Raise ``SceneError`` where code that is not ours fails in the block, with file and line.

    ``function`` is what the block compiles, if it does nothing else.
    """
    try:
        yield
    except MulticellError:
        raise
    except Exception as error:
        fault = own_fault(error, lambda file: True, function)
        if fault is None:
            raise
        raise SceneError(path, fault) from error


def _lines(error: BaseException) -> Iterator[tuple[str, int]]:
    """Yield file and line of each frame of an error, the last one innermost; numba's ones first."""
    if type(error).__module__.startswith("numba."):
        for file, line in _COMPILED.findall(str(error)):
            yield os.path.realpath(file), int(line)
    else:
        for frame, number in walk_tb(error.__traceback__):
            yield frame.f_code.co_filename, number


def _is_installed(file: str) -> bool:
    """Return whether a file belongs to this package, to Python or to another package."""
    places = [Path(__file__).parents[1], *map(Path, sysconfig.get_paths().values())]
    path = os.path.realpath(file)
    return file.startswith("<frozen") or any(Path(path).is_relative_to(p.resolve()) for p in places)


def _is_loaded(file: str) -> bool:
    known = [
        module for module in list(sys.modules.values()) if hasattr(module, "_multicell_source")
    ]
    folders = [Path(str(module.__file__)).parent for module in known]
    return any(Path(os.path.realpath(file)).is_relative_to(folder) for folder in folders)


def _message(error: BaseException, file: str) -> str:
    """Return the message of an error in one line, with the name that was likely meant."""
    missing = _missing_name(error)
    kind, *declared = type(getattr(error, "obj", None)).__name__.split("__")
    if isinstance(error, AttributeError) and kind.startswith("Constants_"):
        # a class of ours, named after the parameters of the law
        close = difflib.get_close_matches(missing, declared, 1, 0.4)
        meant = f" (did you mean '{close[0]}'?)" if close else ""
        known = ", ".join(declared) or "none"
        return (
            f"asks for the parameter '{missing}', which is not declared{meant}; declared: {known}"
        )
    lines_said = [line.strip() for line in str(error).splitlines()]
    lines_said = [line for line in lines_said if line and not line.startswith("Failed in")]
    text = next((x for x in lines_said if f"'{missing}'" in x), next(iter(lines_said), ""))
    lines = iter(linecache.getlines(file))
    names = {part.string for part in generate_tokens(lines.__next__) if part.type == NAME}
    names |= {*dir(getattr(error, "obj", None)), *dir(builtins)}
    near = difflib.get_close_matches(missing, names - {missing}, 1, 0.7)
    hint = f" (did you mean '{near[0]}'?)" if near else ""
    return f"raises {type(error).__name__}: {text}".rstrip(": ") + hint


def _missing_name(error: BaseException) -> str:
    """Return the name that an error says does not exist, or nothing."""
    return str(getattr(error, "name", None) or "".join(_MISSING.findall(str(error))[:1]))
