"""Origins of the committed pictures: command, methods shown, and digest of each.

``figures/origins.json`` has an entry for every picture of ``figures/``. Tests compare the methods
with the registry and the digests with the files, so that a picture of methods that are gone, or one
that was changed by hand, is noticed.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path

FIGURES = Path(__file__).parents[1] / "figures"


def digest(picture: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(picture.read_bytes()).hexdigest()


def read(folder: Path = FIGURES) -> dict[str, dict[str, object]]:
    """Return the record of each picture of a folder."""
    path = folder / "origins.json"
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.exists() else {}


def record(picture: Path, command: str, methods: Iterable[str] = (), **more: object) -> None:
    """Note beside a picture that was just written what made it and which methods it shows."""
    known = read(picture.parent)
    entry: dict[str, object] = {"command": command, "digest": digest(picture)}
    if shown := sorted(set(methods)):
        entry["methods"] = shown
    known[picture.name] = entry | more
    text = json.dumps(dict(sorted(known.items())), indent=2, ensure_ascii=False)
    (picture.parent / "origins.json").write_text(text + "\n", encoding="utf-8")
