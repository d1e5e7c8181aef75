"""A run as an RO-Crate: its files, with a description that repositories and workflows read."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from multicell.errors import OutputError
from multicell.report.tables import Frames
from multicell.report.wording import measures

if TYPE_CHECKING:
    from multicell.report.result import Result

NAME: Final = "ro-crate-metadata.json"
_SCENE: Final = "scene.toml"
_KINDS: Final = {
    ".toml": ("application/toml", "The scene as run: all parameters with their units"),
    ".h5": ("application/x-hdf5", "All saved frames, and the history of each coupling step"),
    ".json": ("application/json", "Key figures of the run, with the versions of all packages"),
    ".html": ("text/html", "The report: pictures, values and the view of the cells"),
    ".png": ("image/png", "A picture of the run"),
    ".csv": ("text/csv", "The cells at the start"),
    ".parquet": ("application/vnd.apache.parquet", "The cells at the start"),
}
"""Media type and description of the files of a run."""


def write(run: Result, frames: Frames, folder: Path, tables: Sequence[str]) -> list[str]:
    """Copy the files of a run and describe them; return all names.

    Raises OutputError for a run that has no folder, or is not at its end.
    """
    if run.folder is None:
        raise OutputError("the run has no output folder: only files can be described")
    if not (run.folder / "frames.h5").is_file():
        raise OutputError(f"the run in '{run.folder}' is not at its end: resume it first")
    files = sorted(p for p in run.folder.iterdir() if p.is_file() and p.suffix in _KINDS)
    files = [path for path in files if path.name != NAME]
    for path in files:
        shutil.copyfile(path, folder / path.name)
    text = json.dumps(_described(run, files), indent=2, ensure_ascii=False)
    (folder / NAME).write_text(text + "\n", "utf-8")
    return [NAME, *(path.name for path in files)]


def _described(run: Result, files: Sequence[Path]) -> dict[str, Any]:
    summary = run.summary()
    ended = datetime.fromtimestamp(max(p.stat().st_mtime for p in files), UTC)
    when = ended.isoformat(timespec="seconds")
    figures = [
        {"@id": f"#figure-{k}", "@type": "PropertyValue", "name": name, "value": value}
        for k, (name, value) in enumerate(measures(summary))
    ]
    software = [
        {"@id": f"#{name}", "@type": "SoftwareApplication", "name": name, "softwareVersion": number}
        for name, number in summary["versions"].items()
    ]
    title = run.scene.title or "Untitled run"
    parts = [{"@id": path.name} for path in files]
    described = {
        "@id": NAME, "@type": "CreativeWork", "about": {"@id": "./"},
        "conformsTo": {"@id": "https://w3id.org/ro/crate/1.1"},
    }  # fmt: skip
    root = {
        "@id": "./", "@type": "Dataset", "name": title, "datePublished": when,
        "description": f"Cell-based simulation of tissue with multicell: {title}",
        "license": "No licence is stated; ask the authors of the run.",
        "hasPart": parts, "mentions": {"@id": "#run"},
        "variableMeasured": [{"@id": entry["@id"]} for entry in figures],
    }  # fmt: skip
    action = {
        "@id": "#run", "@type": "CreateAction", "endTime": when,
        "name": f"Run of the scene with seed {run.scene.seed}",
        "instrument": [{"@id": entry["@id"]} for entry in software],
        "object": {"@id": _SCENE}, "result": [part for part in parts if part["@id"] != _SCENE],
    }  # fmt: skip
    graph = [described, root, action, *map(_file, files), *software, *figures]
    return {"@context": "https://w3id.org/ro/crate/1.1/context", "@graph": graph}


def _file(path: Path) -> dict[str, Any]:
    kind, words = _KINDS[path.suffix]
    content = path.read_bytes()
    return {
        "@id": path.name, "@type": "File", "name": path.name, "description": words,
        "encodingFormat": kind, "contentSize": str(len(content)),
        "sha256": hashlib.sha256(content).hexdigest(),
    }  # fmt: skip
