"""A scene in a line, and as a small table for notebooks."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multicell.scene.scene import Scene


def key_facts(scene: Scene) -> dict[str, str]:
    """Return what one would ask first of a scene, in words."""
    hours = scene.duration / 3600.0
    facts = {
        "cells at the start": f"{scene.initial.count:,}",
        "duration": f"{hours / 24.0:g} d" if hours >= 72.0 else f"{hours:g} h",
        "types": ", ".join(scene.types),
        "fields": ", ".join(scene.nutrients),
        "integrator": scene.integrator.method,
        "seed": str(scene.seed),
    }
    return {name: text for name, text in facts.items() if text}


def in_a_line(scene: Scene) -> str:
    """Return a scene in a line."""
    facts = ", ".join(f"{name}: {text}" for name, text in key_facts(scene).items())
    return f"<Scene {scene.title!r}, {facts}>"


def as_html(scene: Scene) -> str:
    """Return a scene as HTML: key facts, and all keys where one opens them."""
    rows = "".join(
        f"<tr><th style='text-align:left'>{name}</th><td style='text-align:left'>"
        f"{escape(text)}</td></tr>"
        for name, text in key_facts(scene).items()
    )
    return (
        f"<div><b>{escape(scene.title or 'Untitled scene')}</b><table>{rows}</table>"
        f"<details><summary>All keys</summary><pre>{escape(scene.to_toml())}</pre></details></div>"
    )
