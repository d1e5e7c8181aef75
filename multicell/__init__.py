"""Centre-based simulation of multicellular tissue.

>>> import multicell as mc
>>> scene = mc.load_scene("spheroid").with_changes({"duration": "2 d"})
>>> result = mc.run(scene)                                      # doctest: +SKIP
"""

import os
import sys

# "python -m multicell" looks for modules in the working folder first, also for Python's own ones
# that are not loaded yet; where multicell itself is there it stays
if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:
    _here = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if os.path.abspath(sys.path[0]) != _here:
        del sys.path[0]

from importlib import import_module
from typing import Any

from multicell.host.surroundings import ignore_settings_of_working_folder

ignore_settings_of_working_folder()

__version__ = "0.1.0"

with open(os.path.join(os.path.dirname(__file__), "__init__.pyi"), encoding="utf-8") as _stub:
    _LINES = [line.split() for line in _stub if line.startswith("from ")]
_MODULES = {words[3]: words[1] for words in _LINES}
__all__ = sorted(_MODULES)
_ELSEWHERE = {
    "explain": "it is a command, multicell explain SCENE",
    "play": "it is a command, multicell play SCENE",
    "plot": "a result has the pictures, result.plot.section()",
    "view": "a notebook shows a result, and multicell view FOLDER opens one",
    "workprecision": "use multicell.compare",
}


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for: numba and SUNDIALS take their time."""
    if name == "testing":
        return import_module("multicell.testing")
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    said = f"module 'multicell' has no attribute {name!r}"
    if name in _ELSEWHERE:
        said += f": {_ELSEWHERE[name]}"
    # with name and module Python adds the likely name where nobody catches this
    raise AttributeError(said, name=name, obj=sys.modules[__name__])


def __dir__() -> list[str]:
    return __all__
