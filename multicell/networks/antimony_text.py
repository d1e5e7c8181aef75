"""Antimony as SBML, by its own library in a process of its own.

The library opens files that a text names, builds modules in modules without bound, and is compiled
code that recurses: so a text that imports is refused, and what becomes of the process is not what
becomes of ours.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from typing import Final

from multicell.errors import SceneError
from multicell.networks.documents import MAX_DOCUMENT

_MAX_CHARACTERS: Final = 1_000_000  # of text that is given to the parser
_SECONDS: Final = 60.0  # of a large model: one
_MEMORY: Final = 4 * 2**30  # bytes
_IMPORTS: Final = re.compile(r"\bimport\b", re.IGNORECASE)
_CHILD: Final = f"""
import sys
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, ({_MEMORY}, {_MEMORY}))
except (ImportError, OSError, ValueError):
    print("memory is not limited", file=sys.stderr)
import antimony
text = sys.stdin.buffer.read().decode()
if antimony.loadAntimonyString(text) < 0:
    sys.stdout.buffer.write(b"-" + antimony.getLastError().encode())
else:
    made = antimony.getSBMLString(antimony.getMainModuleName())
    sys.stdout.buffer.write(b"+" + made.encode())
"""


def sbml_of(text: str, name: str) -> str:
    """Return the SBML that a text of Antimony stands for, its modules put together.

    - ``name``: of the file, for messages

    Raises SceneError for a text that is no Antimony, names other files, or is too large.
    """
    if len(text) > _MAX_CHARACTERS:
        raise SceneError(name, f"is Antimony of more than {_MAX_CHARACTERS:,} characters")
    if found := _IMPORTS.search(text):
        line = text.count("\n", 0, found.start()) + 1
        hint = "Put all modules into one file; the word may not stand in remarks either."
        raise SceneError(f"{name}, line {line}", "imports another file, which is not read", hint)
    command = [sys.executable, "-P", "-c", _CHILD]
    path = os.pathsep.join(filter(None, sys.path))
    try:
        done = subprocess.run(
            command,
            input=text.encode(),
            capture_output=True,
            timeout=_SECONDS,
            env={**os.environ, "PYTHONPATH": path},
        )
    except subprocess.TimeoutExpired:
        raise SceneError(name, f"took Antimony more than {_SECONDS:.0f} s to read") from None
    answer = done.stdout.decode("utf-8", "replace")
    if done.returncode or not answer or len(answer) > MAX_DOCUMENT:
        raise SceneError(name, "is a text of Antimony that its library cannot read")
    if answer[0] == "-":
        words = " ".join(answer[1:].split())[:300]
        raise SceneError(name, f"is no valid Antimony: {words}")
    return answer[1:]
