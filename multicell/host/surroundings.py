"""Keep the working folder from changing the behaviour of a process.

numba and matplotlib read settings from files of the working folder: a folder that one enters could
name a cache with code of others, or other pictures. What the user sets by environment variables and
in the home folder stays.
"""

from __future__ import annotations

import errno
import os
import sys
import warnings
from importlib.machinery import ModuleSpec, PathFinder
from types import CodeType, FunctionType, ModuleType
from typing import Any, final


def _settings_file() -> str:
    """Return matplotlib's file of settings as its own function does, without the working folder.

    It runs among the names of matplotlib.
    """
    places = [get_configdir(), get_data_path()]  # type: ignore[name-defined] # noqa: F821
    named = os.environ.get("MATPLOTLIBRC")
    found = [os.path.join(place, "matplotlibrc") for place in places]
    for name in [named, os.path.join(named, "matplotlibrc"), *found] if named else found:
        if os.path.isfile(name):
            return name
    raise RuntimeError("matplotlib has no file of settings: its installation is broken")


def _without_file(code: CodeType) -> CodeType:
    """Return the code of numba's settings with no name of a file in the working folder.

    Nothing is there to be read, so that PyYAML need not be loaded.
    """
    consts = tuple("" if part == ".numba_config.yaml" else part for part in code.co_consts)
    names = tuple("_no_yaml" if name == "yaml" else name for name in code.co_names)
    return code.replace(co_consts=consts, co_names=names)


def _elsewhere(code: CodeType) -> CodeType:
    """Return the code of matplotlib with another search for its file of settings."""
    own: Any = _settings_file
    assert isinstance(own, FunctionType)
    other = own.__code__.replace(co_name="matplotlib_fname")
    parts = tuple(
        other if isinstance(part, CodeType) and part.co_name == "matplotlib_fname" else part
        for part in code.co_consts
    )
    return code.replace(co_consts=parts)


_CHANGED = {"numba.core.config": _without_file, "matplotlib": _elsewhere}


@final
class _Loader:
    """Loads a module whose code is changed before it runs."""

    def __init__(self, inner: Any) -> None:
        self._inner = inner

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """Leave that to Python."""
        return None

    def exec_module(self, module: ModuleType) -> None:
        """Run the changed code."""
        code = _CHANGED[module.__name__](self._inner.get_code(module.__name__))
        if module.__name__ == "matplotlib":
            exec(code, module.__dict__)
            return
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # of values that numba cannot read
                # a press leaves the file of a module that is being read open, which is no error
                warnings.simplefilter("ignore", ResourceWarning)
                exec(code, module.__dict__)
            if vars(module)["NUMBA_NUM_THREADS"] < 1:  # numba would say so much later
                raise ValueError("NUMBA_NUM_THREADS must be at least 1")
        except (ValueError, Warning) as error:
            said = str(error).strip().splitlines()[0]
            words = f"numba refuses its settings by environment variables ({said})"
            raise OSError(errno.EINVAL, words, "NUMBA_...") from error


@final
class _Finder:
    """Finds the modules that are changed."""

    def find_spec(self, name: str, path: Any, target: Any = None) -> ModuleSpec | None:
        """Return where a module is; None for all that are not changed."""
        if name not in _CHANGED:
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and spec.loader is not None:
            loader: Any = _Loader(spec.loader)
            spec.loader = loader
        return spec


def ignore_settings_of_working_folder() -> None:
    """Have numba and matplotlib, where they are not loaded yet, read no settings from there."""
    sys.meta_path.insert(0, _Finder())
