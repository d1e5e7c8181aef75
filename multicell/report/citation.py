"""Methods section of a run: model, values, numerics, seed and versions, with citations."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from multicell.integrators.registry import METHODS
from multicell.results.folder import package_version
from multicell.results.quantities import entry
from multicell.scene.scene import Scene
from multicell.scene.steps import longest_coupling_step
from multicell.schema import leaves
from multicell.units import shown, time_text

if TYPE_CHECKING:
    from multicell.report.result import Result

_CONTACTS: Final = {
    "hertz": ("hertz1882",),
    "jkr": ("johnson1971", "schaller2005"),
    "exact-jkr": ("johnson1971",),
}
_NOT_OF_MODEL: Final = ("integrator", "output")
_UNSAID: Final = ("title", "seed", "duration", "coupling_step", "output", "integrator")
"""Keys that say nothing of the model, or stand in the text already."""


@final
@dataclass(frozen=True)
class Citation:
    """Methods section of a run, and the entries that it cites.

    - ``text``: paragraphs with keys of BibTeX in square brackets
    - ``bibtex``: the entries of these keys
    """

    text: str
    bibtex: str


def cite(result: Result) -> Citation:
    """Return a methods section of a run: all of it follows from scene and summary."""
    paragraphs = [_model(result), _values(result.scene), _numerics(result), _origin(result)]
    text = "\n\n".join(filter(None, paragraphs))
    keys = {key for found in re.findall(r"\[([a-z0-9, ]*)\]", text) for key in found.split(", ")}
    version = str((result.summary_dict.get("versions") or {}).get("multicell", package_version()))
    source = files("multicell.report").joinpath("templates/citations.bib")
    known = source.read_text(encoding="utf-8").replace("VERSION", version).split("\n\n")
    used = [one.strip() for one in known if one.split("{", 1)[1].split(",")[0] in keys]
    return Citation(text, "\n\n".join(used) + "\n")


def _model(result: Result) -> str:
    from multicell.report.explain.scene import explain

    scene = result.scene
    contact = scene.to_dict().get("contact") or {}
    laws = _CONTACTS.get(contact.get("law", "jkr"), ())
    cited = f" [{', '.join(laws)}]" if laws else ""
    parts = [
        f"{part['part']}: {part['what']}{cited if part['part'] == 'contact' else ''}"
        for part in explain(scene)["parts"]
        if part["used"] and part["part"] not in _NOT_OF_MODEL
    ]
    fields = " Fields were solved on grids of py-pde [zwicker2020]." if scene.nutrients else ""
    space = "three" if scene.dimensions == 3 else "two"
    return (
        f"Cells were simulated as spheres in {space} dimensions by their centres with multicell "
        f"[multicell]. The model consists of: {'; '.join(parts)}.{fields}"
    )


def _values(scene: Scene) -> str:
    """Return the values of a scene that one without any keys does not have."""
    plain = dict(_flat(Scene.from_dict({"duration": scene.duration}).to_dict()))
    units = {".".join(path): spec.units for path, _, spec in leaves(scene)}
    said = [
        f"{key} = {_word(Path(value).name if key.endswith('.file') else value)} "
        f"{units.get(key) or ''}".rstrip()
        for key, value in _flat(scene.to_dict())
        if plain.get(key) != value and key.partition(".")[0] not in _UNSAID
    ]
    if not said:
        return "All values are the defaults of this version."
    return (
        f"Values: {'; '.join(said)}; all others are the defaults of this version, whose sources "
        "are in its documentation (Parameters)."
    )


def _word(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else shown(value).strip("'")


def _flat(entries: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in entries.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{path}{name}.")
        else:
            yield f"{path}{name}", value


def _numerics(result: Result) -> str:
    scene, summary = result.scene, result.summary_dict
    work: Mapping[str, Any] = summary.get("integrator") or {}
    method = work.get("method", scene.integrator.method)
    taken = [name for name in METHODS if work.get(f"steps_{name.replace('-', '_')}")]
    infos = [METHODS[name] for name in (method, *taken) if name in METHODS]
    keys = dict.fromkeys(info.source for info in infos if info.source)
    cited = f" [{', '.join(keys)}]" if keys else ""
    steps = f" in {summary['steps']:,} coupling steps" if "steps" in summary else ""
    up_to = "up to " if scene.coupling_tolerance else ""
    longest = time_text(longest_coupling_step(scene))
    text = (
        f"{time_text(float(summary.get('time', scene.duration)))} were simulated{steps} of "
        f"{up_to}{longest}, positions by the method '{method}'{cited}"
    )
    tolerance = getattr(scene.integrator, "tolerance", None)
    text += f" with a tolerance of {tolerance:g} µm." if tolerance else "."
    errors = [f"{words} {value:.2g}" for words, value in _errors(summary)]
    return f"{text} Estimated errors: {'; '.join(errors)}." if errors else text


def _errors(summary: Mapping[str, Any]) -> list[tuple[str, float]]:
    """Return the estimates of error that a summary has, with what they are of."""
    known = {
        "volume of the tissue by coupling, relative": "splitting.relative_volume_error",
        "volume of the worst cell by coupling, relative": "splitting.worst_cell_error",
        "volume by coupling, of first order": "splitting.first_order_error",
        "balance of molecules, relative": "ledger.relative_remainder",
    }
    found = [(words, entry(summary, name)) for words, name in known.items()]
    return [(w, float(x)) for w, x in found if isinstance(x, int | float) and math.isfinite(x)]


def _origin(result: Result) -> str:
    summary = result.summary_dict
    seed = summary.get("seed", result.scene.seed)
    versions = summary.get("versions") or {"multicell": package_version()}
    listed = ", ".join(f"{name} {version}" for name, version in versions.items())
    digest = summary.get("scene_digest")
    mark = f" The scene has the digest {digest}." if digest else ""
    return (
        f"Random numbers are counter-based [salmon2011], of the seed {seed}. "
        f"Versions: {listed}.{mark}"
    )
