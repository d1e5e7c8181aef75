"""Files that a scene names: beside its own file, and as copies in the folder of a run."""

from __future__ import annotations

import copy
import os
from pathlib import Path
from typing import Any, TypeVar

_T = TypeVar("_T")


def made_whole(given: Any, source: str | Path) -> Any:
    """Return the name of a file, or a table with one as ``file``, with the path made whole.

    It stands beside the scene's file ``source``; what is no name is returned as it is.
    """
    file = given.get("file") if isinstance(given, dict) else given
    if not isinstance(file, str) or not file:
        return given
    try:
        whole = str(Path(os.path.expanduser(source)).parent / os.path.expanduser(file))
    except (OSError, ValueError):
        return given  # whoever reads it will say what is wrong
    return {**given, "file": whole} if isinstance(given, dict) else whole


def altered(part: _T, **values: Any) -> _T:
    """Return a part of a scene with other values, unchecked.

    It is not made anew: that would read files which need not be there yet.
    """
    part = copy.copy(part)
    for name, value in values.items():
        object.__setattr__(part, name, value)
    return part
