"""Pages of HTML from the templates of this room; Jinja2 is loaded when a page is written.

A page holds its pictures and needs nothing else. Whatever a template is given is escaped.
"""

from __future__ import annotations

import base64
import hashlib
import math
from collections.abc import Callable, Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from multicell.errors import printable
from multicell.report.wording import clock, written
from multicell.results.folder import file_errors, package_version, write_text
from multicell.results.quantities import known_unit, title_of

if TYPE_CHECKING:
    from jinja2 import Environment
    from matplotlib.figure import Figure

    from multicell.scene.scene import Scene

Drawing = tuple[Callable[[], "Figure"], str]  # a function that draws a picture, and its caption


def write_page(
    path: Path,
    template: str,
    *,
    scene: Scene | None,
    title: str,
    subtitle: str,
    tiles: Mapping[str, str],
    pictures: Mapping[str, Drawing] | Mapping[Path, Drawing],
    **context: Any,
) -> Path:
    """Write one page with its pictures beside it, and return its path.

    - ``path``: of the page; its folder is made if it does not exist
    - ``template``: name of a file in ``templates``
    - ``scene``: its TOML makes the last card; None: no such card
    - ``title``, ``subtitle``: heading of the page
    - ``tiles``: key figures: name -> value in words
    - ``pictures``: PNG file to write, relative to the page's folder -> the function that draws it,
      and its caption. The page holds it without its title.
    - ``**context``: what else the template asks for
    """
    with file_errors("use the output folder", path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    text = rendered(
        template,
        title=title,
        subtitle=subtitle,
        tiles=dict(tiles),
        pictures=[
            _inline(path.parent / name, draw(), caption)
            for name, (draw, caption) in pictures.items()
        ],
        scene="" if scene is None else scene.to_toml(),
        **context,
    )
    write_text(path, text)
    return path


def rendered(template: str, **context: Any) -> str:
    """Return a template of this room, filled in; besides its title a page needs nothing else."""
    page = {"subtitle": "", "tiles": {}, "scene": "", "version": package_version(), **context}
    return _environment().get_template(template).render(page)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("multicell.report"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=lambda x: printable(x, lines=True) if type(x) is str else x,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "clock": clock,
        "label": _label,
        "limit": _limit,
        "present": _present,
        "setting": lambda row: (
            f"{row['setting']:.3g}{' s' if row['control'] in ('step', 'time') else ''}"
        ),
        "swatch": "background:{}".format,
        "text": _text,
    }
    return environment


def script(name: str) -> dict[str, Any]:
    """Return a script of this room for a page, and the digest by which the page allows it."""
    text = files("multicell.report").joinpath(f"templates/{name}").read_text("utf-8")
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
    # the package's own, and allowed by its digest alone: nothing in it is escaped
    return {"script": Markup(text), "policy": digest}


def _inline(path: Path, figure: Figure, caption: str) -> dict[str, Any]:
    from multicell.report.plots.style import inline_picture

    return {"caption": caption, "shown": inline_picture(figure, path)}


def _label(key: str, path: str = "") -> str:
    """Return the name of an entry; ``path`` leads to it in the summary, which knows its unit."""
    name = title_of(str(key))
    if not path:
        return name
    unit = written(known_unit(f"{path}.{key}"))
    return f"{name} ({unit})" if unit else name


def _present(entries: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the entries that are not zero: absent things need no row."""
    return {name: value for name, value in (entries or {}).items() if value != 0}


def _limit(value: float, unit: str = "", missing: str = "") -> str:
    if math.isnan(value):
        return missing
    return "no limit" if math.isinf(value) else f"{value:.3g}{unit}"


def _text(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "unknown"}[value]
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:,.0f}" if value.is_integer() and abs(value) < 1e7 else f"{value:.4g}"
    return str(value)
