"""The report of a run: one HTML page that holds its pictures and needs nothing else."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from multicell.errors import OutputError
from multicell.report.plots.style import cell_count, save, time_unit
from multicell.results.folder import package_version, words, write_text
from multicell.results.quantities import known_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from multicell.report.result import Result
    from multicell.scene.scene import Scene


# the page may load nothing at all: pictures are part of it
_POLICY: Final = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"

_LABELS: Final = {
    "discretisation_error": "estimated error at the cells",
    "largest_local_error": "largest estimated error of a cell in a step",
}

_CSS: Final = """
:root { --ink:#22303c; --quiet:#64737f; --line:#e1e7ec; --green:#1f7f54; --page:#f4f6f8; }
* { box-sizing:border-box; }
body { margin:0; background:var(--page); color:var(--ink);
  font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif; }
header { background:#17323f; color:#fff; padding:2.4rem 1.2rem 4.6rem; }
header > div, main { max-width:68rem; margin:0 auto; }
h1 { margin:0 0 .3rem; font-size:clamp(1.5rem,4vw,2.2rem); line-height:1.2;
  overflow-wrap:anywhere; }
header p { margin:0; color:#bfd3dc; }
header .warning { display:inline-block; margin-top:.9rem; padding:.3rem .8rem; border-radius:6px;
  background:#f2b63c; color:#3a2a05; font-weight:600; }
main { padding:0 1.2rem 3rem; margin-top:-3.2rem; }
.tiles { display:grid; gap:.8rem; grid-template-columns:repeat(auto-fit,minmax(9.5rem,1fr)); }
.tile, section { background:#fff; border:1px solid var(--line); border-radius:10px;
  box-shadow:0 1px 3px rgb(20 40 60 / .07); }
.tile { padding:.9rem 1rem; }
.tile b { display:block; font-size:1.5rem; line-height:1.25; color:var(--green);
  font-variant-numeric:tabular-nums; }
.tile span { color:var(--quiet); font-size:.9rem; }
section { margin-top:1.2rem; padding:1.2rem 1.4rem; }
h2 { margin:0 0 .8rem; font-size:1.2rem; }
h3 { margin:1.1rem 0 .3rem; font-size:1rem; color:var(--green); }
figure { margin:0; }
figure img { display:block; width:100%; height:auto; }
figcaption, .note { color:var(--quiet); font-size:.95rem; }
.columns { display:grid; gap:0 1.2rem; grid-template-columns:repeat(auto-fit,minmax(19rem,1fr));
  align-items:start; }
.scroll { overflow-x:auto; }
table { border-collapse:collapse; width:100%; font-size:.95rem; }
td, th { padding:.34rem .6rem .34rem 0; border-bottom:1px solid var(--line); text-align:left;
  vertical-align:top; }
tr:last-child td, tr:last-child th { border-bottom:0; }
th { font-weight:500; }
td.number { text-align:right; white-space:nowrap; font-variant-numeric:tabular-nums; }
td.doc { color:var(--quiet); width:52%; }
.bar { display:block; height:.6rem; min-width:2px; margin-top:.45rem; border-radius:3px;
  background:#2a9d6a; }
td.track { width:40%; }
footer { margin-top:1.4rem; color:var(--quiet); font-size:.9rem; text-align:center; }
@media (max-width:34rem) { section { padding:1rem .9rem; } td.doc { display:none; }
  .tiles { grid-template-columns:repeat(2,1fr); } .tile b { font-size:1.25rem; } }
@media print { header { color:#000; background:none; padding-bottom:1rem; }
  main { margin-top:0; } section { break-inside:avoid; box-shadow:none; } }
"""

_CROWD: Final = 10  # cells, below which averages over shells say nothing
_SEPARATION, _MIXED = "separation force", "contacts between unlike cells"
_CAPTIONS: Final = {
    "growth": "The population in the course of the run.",
    "section": "Cells that a plane through the centre cuts, each drawn with the radius of its cut.",
    "fields": "A map of every field in the plane of the section, each over its own range.",
    "profiles": "Averages over spherical shells about the centre.",
    "contacts": "Contacts between cells of different types, and where each type is.",
    "pull": "Force that pulls the cells apart, beside what their contact can bear.",
}
_FLAT_CAPTIONS: Final = {
    **_CAPTIONS,
    "section": "The cells, all in one plane.",
    "fields": "A map of every field in the plane of the cells, each over its own range.",
    "profiles": "Averages over rings about the centre.",
}


def write_report(result: Result, folder: str | Path | None = None) -> Path:
    """Write ``report.html`` and its pictures beside it.

    Parameters
    ----------
    result
        The run; it may be unfinished.
    folder
        Where to write, by default the folder of the run.

    Returns
    -------
    pathlib.Path
        The page.

    Raises
    ------
    OutputError
        If there is no folder to write to, or it cannot be written to.
    """
    place = result.folder if folder is None else Path(folder)
    if place is None:
        raise OutputError("the run has no output folder: say where the report shall go")
    with words("use the output folder", place):
        place.mkdir(parents=True, exist_ok=True)
    captions = _CAPTIONS if result.scene.dimensions == 3 else _FLAT_CAPTIONS
    pictures = "".join(
        _picture(place, name, draw, captions[name]) for name, draw in _drawings(result)
    )
    path = place / "report.html"
    figures = dict(measures(result.summary())) | dict(_contact_measures(result))
    write_text(path, page(result.scene, result.summary(), pictures, figures))
    return path


def page(
    scene: Scene, summary: Mapping[str, Any], pictures: str, figures: Mapping[str, str]
) -> str:
    """Return the page; ``pictures`` is HTML, everything else is escaped here.

    ``figures`` are the key figures: name and value in words.
    """
    title = escape(scene.title or "Untitled run")
    interrupted = bool(summary.get("interrupted"))
    warning = '<p class="warning">Interrupted before its end</p>' if interrupted else ""
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}">
<title>{title}</title>
<style>{_CSS}</style>
</head>
<body>
<header><div><h1>{title}</h1><p>{_subtitle(scene, summary)}</p>{warning}</div></header>
<main>
<div class="tiles">{"".join(_tiles(figures))}</div>
{pictures}
<div class="columns">{"".join(_work(summary))}</div>
{_settings(scene)}
<footer>multicell {escape(package_version())}</footer>
</main>
</body>
</html>
"""


def clock(seconds: float) -> str:
    """Return a wall time in words, for example ``"2 min 14 s"``."""
    if seconds < 60.0:
        return f"{seconds:.2g} s" if seconds < 10.0 else f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def measures(summary: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the name and the value in words of each key figure that a summary has."""
    formats: dict[str, tuple[str, Callable[[Any], str]]] = {
        "cells": ("cells", lambda n: f"{n:,}"),
        "time": ("simulated time", lambda t: time_unit(t).text(t)),
        "diameter": ("diameter", lambda d: f"{d:.0f} µm"),
        "viable_rim": ("viable rim", lambda d: f"{d:.0f} µm"),
        "necrotic_radius": ("radius of the necrotic core", lambda d: f"{d:.0f} µm"),
        "packing_ratio": ("packing ratio", lambda ratio: f"{ratio:.2f}"),
        "held_by_pressure": ("growth halved by pressure", cell_count),
        "divisions": ("divisions", lambda n: f"{n:,}"),
        "removals": ("cells removed", lambda n: f"{n:,}"),
        "separation": (_SEPARATION, lambda s: f"{s['force']:.4g} nN"),
        "heterotypic_fraction": (_MIXED, _percent),
    }
    for key, (name, shown) in formats.items():
        value = summary.get(key)
        if value is not None and value == value:  # a rim without a core does not exist
            yield name, shown(value)
    total = (summary.get("wall") or {}).get("total")
    if total is not None:
        yield "wall time", clock(total)
    balance = (summary.get("ledger") or {}).get("relative_remainder")
    if balance is not None:
        yield "nutrient unaccounted for", f"{balance:.1e}"
    for name, field in (summary.get("fields") or {}).items():
        if "discretisation_error" in field:
            yield f"grid error of {name}", f"{field['discretisation_error']:.1e} mM"


def _percent(part: float) -> str:
    return f"{100.0 * part:.1f} %"


def _contact_measures(result: Result) -> Iterator[tuple[str, str]]:
    """Yield the key figures of contact that a summary alone does not tell."""
    from multicell.report.plots.contacts import separation_theory

    separation = result.summary().get("separation")
    if separation:
        theory = separation_theory(result.frames, result.scene, separation["time"])
        if theory is not None:
            yield _SEPARATION, f"{separation['force']:.4g} nN (theory {theory:.4g})"
    mixed = result.history.get("heterotypic_fraction", ())
    known = [float(part) for part in mixed if part == part]
    if known:
        yield _MIXED, f"{_percent(known[0])} → {_percent(known[-1])}"


def _drawings(result: Result) -> Iterator[tuple[str, Callable[[], Figure]]]:
    """Yield the pictures that this run has enough data for."""
    if len(result.history.get("time", ())):
        yield "growth", result.plot.growth
    if len(result.frames) and len(result.frames[-1].cells):
        yield "section", result.plot.section
        if len(result.frames[-1].fields) > 1:
            yield "fields", result.plot.fields
        if len(result.frames[-1].cells) >= _CROWD:
            yield "profiles", result.plot.profiles
    if len(result.frames) and len(result.history.get("heterotypic_fraction", ())):
        yield "contacts", result.plot.contacts
    if len(result.frames) and len(result.history.get("pull", ())):
        yield "pull", result.plot.pull


def _picture(place: Path, name: str, draw: Callable[[], Figure], words_below: str) -> str:
    """Save a picture and return it as HTML."""
    path = place / f"{name}.png"
    save(draw(), path)
    with words("read", path):
        data = base64.b64encode(path.read_bytes()).decode("ascii")
    caption = escape(words_below)
    return (
        f'<section><figure><img alt="{caption}" src="data:image/png;base64,{data}">'
        f"<figcaption>{caption}</figcaption></figure></section>\n"
    )


def _subtitle(scene: Scene, summary: Mapping[str, Any]) -> str:
    """Return one line: method, seed, steps."""
    method = (summary.get("integrator") or {}).get("method", scene.integrator.method)
    parts = [f"method {method}", f"seed {summary.get('seed', scene.seed)}"]
    if summary.get("steps") is not None:
        parts.append(f"{summary['steps']:,} coupling steps")
    return escape(" · ".join(parts))


def _tiles(figures: Mapping[str, str]) -> Iterator[str]:
    for name, value in figures.items():
        yield f'<div class="tile"><b>{escape(value)}</b><span>{escape(name)}</span></div>'


def _work(summary: Mapping[str, Any]) -> Iterator[str]:
    """Yield cards: cells by state, wall time, work of the integrator, ledger, versions."""
    yield _table("Cells by state", summary.get("states"), "states")
    yield _wall(summary.get("wall"))
    yield _table("Work of the integrator", summary.get("integrator"), "integrator")
    ledger = {k: v for k, v in (summary.get("ledger") or {}).items() if isinstance(v, Mapping)}
    yield _ledgers(ledger)
    for name, field in (summary.get("fields") or {}).items():
        yield _table(f"Grid of {name}", field, f"fields.{name}")
    yield _notes(summary.get("notes") or ())
    yield _table("Versions", summary.get("versions"))


def _notes(notes: Sequence[str]) -> str:
    """Return a card with remarks on the run, or nothing without any."""
    if not notes:
        return ""
    lines = "".join(f"<p>{escape(note)}</p>" for note in notes)
    return f"<section><h2>Notes</h2>{lines}</section>"


def _ledgers(ledger: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a card with a row for each entry of the account and a column for each field."""
    if not ledger:
        return ""
    head = "".join(f"<th>{escape(name)}</th>" for name in ledger)
    entries = dict.fromkeys(key for account in ledger.values() for key in account)
    rows = "".join(
        f"<tr><th>{_titled(f'ledger.*.{key}', key)}</th>"
        + "".join(
            f'<td class="number">{escape(_text(account[key])) if key in account else ""}</td>'
            for account in ledger.values()
        )
        + "</tr>"
        for key in entries
    )
    table = f'<div class="scroll"><table><tr><th></th>{head}</tr>{rows}</table></div>'
    return f"<section><h2>Where each field's molecules went</h2>{table}</section>"


def _table(title: str, entries: Mapping[str, Any] | None, path: str = "") -> str:
    """Return a card with a table of two columns, or nothing without entries.

    ``path`` leads to the entries in the summary, which gives their units.
    """
    if not entries:
        return ""
    rows = "".join(
        f"<tr><th>{_titled(f'{path}.{name}', name) if path else _name(name)}</th>"
        f'<td class="number">{escape(_text(value))}</td></tr>'
        for name, value in entries.items()
    )
    table = f'<div class="scroll"><table>{rows}</table></div>'
    return f"<section><h2>{escape(title)}</h2>{table}</section>"


def _wall(wall: Mapping[str, float] | None) -> str:
    """Return a card with the wall time by phase as bars."""
    if not wall:
        return ""
    phases = {name: value for name, value in wall.items() if name != "total"}
    longest = max(phases.values(), default=0.0) or 1.0
    rows = "".join(
        f'<tr><th>{_name(name)}</th><td class="track"><span class="bar" '
        f'style="width:{100.0 * value / longest:.1f}%"></span></td>'
        f'<td class="number">{escape(clock(value))}</td></tr>'
        for name, value in phases.items()
    )
    if "total" in wall:
        rows += (
            f'<tr><th><b>total</b></th><td></td><td class="number">{clock(wall["total"])}</td></tr>'
        )
    return f"<section><h2>Wall time</h2><table>{rows}</table></section>"


def _settings(scene: Scene) -> str:
    """Return a card with every parameter of the scene, its unit and its meaning."""
    blocks = "".join(
        f'<h3>{escape(title)}</h3><div class="scroll"><table>{"".join(rows)}</table></div>'
        for title, rows in _parts(scene, "run")
        if rows
    )
    return f"<section><h2>Scene</h2>{blocks}</section>"


def _parts(part: Any, title: str) -> Iterator[tuple[str, list[str]]]:
    """Yield the rows of a part, then those of the parts in it."""
    rows, below = [], []
    for spec in fields(part):
        value = getattr(part, spec.name)
        inner = spec.name if title == "run" else f"{title}.{spec.name}"
        if is_dataclass(value):
            kind = f" ({type(value).__name__})" if spec.name == "contact" else ""
            below.append((value, inner + kind))
        elif isinstance(value, Mapping) and all(map(is_dataclass, value.values())):
            below += [(entry, f"{inner}.{name}") for name, entry in value.items()]
        else:
            rows.append(_setting(spec.name, value, spec.metadata["parameter"]))
    yield title, rows
    for value, name in below:
        yield from _parts(value, name)


def _setting(name: str, value: Any, parameter: Any) -> str:
    """Return one row of the settings."""
    text = "not set" if value is None else f"{_text(value)} {parameter.unit}".strip()
    if parameter.unit == "s" and isinstance(value, float) and value >= 180.0:
        text += f" ({time_unit(value).text(value)})"
    return (
        f'<tr><th>{_name(name)}</th><td class="number">{escape(text)}</td>'
        f'<td class="doc">{escape(parameter.doc)}</td></tr>'
    )


def _curve(points: tuple[tuple[float, float], ...]) -> str:
    return " ".join(f"{_text(y)} at {_text(x)}" for x, y in points)


def _titled(path: str, key: str) -> str:
    """Return the name of an entry of the summary with its unit."""
    unit = escape(_unit(path))
    return f"{_name(_LABELS.get(key, key))} ({unit})" if unit else _name(_LABELS.get(key, key))


def _unit(path: str) -> str:
    """Return the unit of an entry as it is printed; a text has none."""
    return known_unit(path).replace("um", "µm").replace("^3", "³")


def _name(key: str) -> str:
    return escape(str(key).replace("_", " "))


def _text(value: Any) -> str:
    """Return a value in words: thousands separated, seven digits at most."""
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "unknown"}[value]
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:,.0f}" if value.is_integer() and abs(value) < 1e7 else f"{value:.4g}"
    if isinstance(value, Mapping):  # of numbers, or of curves over a concentration
        return ", ".join(
            f"{name} {_curve(entry) if isinstance(entry, tuple) else _text(entry)}"
            for name, entry in value.items()
        )
    if isinstance(value, tuple) and not all(isinstance(point, tuple) for point in value):
        return ", ".join(map(_text, value)) or "none"
    if isinstance(value, tuple):  # points of a course: time and value
        if not value:
            return "none"
        first = _text(value[0][1])
        points = [f"{_text(v)} at {time_unit(t).text(t)}" for t, v in value]
        return first if len(value) == 1 else ", ".join(points)
    return str(value)
