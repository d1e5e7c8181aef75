"""Plots of responses: each behaviour over its signals."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from multicell.behaviours.catalogue import behaviour_named, signal_unit
from multicell.report.plots.style import INK, headed, panel_grid, styled, type_colours
from multicell.scene.responses import Effect, effects
from multicell.scene.scene import Scene

_MAX_PANELS: Final = 9  # three rows of three
_POINTS: Final = 400  # of a curve


@styled
def response_curves(scene: Scene) -> Figure:
    """Draw a panel for each behaviour and signal, with a curve for each response."""
    panels: dict[tuple[str, str], list[Effect]] = {}
    for effect in effects(scene):
        if len(effect.signals) == 1 and effect.law.has_signal:
            panels.setdefault((effect.behaviour, effect.signals[0]), []).append(effect)
    if not panels:
        raise ValueError("nothing in this scene responds to a signal: there is nothing to draw")
    shown = list(panels.items())[:_MAX_PANELS]
    title = "Responses of cells to signals"
    if len(panels) > len(shown):
        title += f" ({len(shown)} of {len(panels)})"
    figure = headed(scene, title)
    columns = min(len(shown), 3)
    grid = panel_grid(figure, len(shown), columns, (0.06, 0.1, 0.97, 0.82), (0.24, 0.85))
    for axes, ((behaviour, signal), parts) in zip(grid, shown, strict=True):
        _draw(axes, scene, behaviour, signal, parts)
    return figure


def _draw(axes: Axes, scene: Scene, behaviour: str, signal: str, parts: list[Effect]) -> None:
    unit = signal_unit(signal, scene.nutrients, "")
    rate = behaviour_named(behaviour, "")[0].unit == "1/s"
    scale, of = (3600.0, ", 1/h") if rate else (1.0, "")
    reach = max(part.law.reach for part in parts)
    if signal in scene.nutrients:  # as far as the medium has it, if the curves then still show
        reach = max(reach, min(scene.nutrients[signal].highest, 3.0 * reach))
    at = np.linspace(0.0, reach, _POINTS)
    colours = type_colours(scene.types)
    for part in parts:
        share = np.asarray(part.law.share(at, falls=part.falls), dtype=float)
        sudden = math.isinf(part.high)
        value = share if sudden else scale * (part.low + (part.high - part.low) * share)
        name = " and ".join(part.types) or "all cells"
        axes.plot(
            at,
            value,
            color=colours.get(part.types[0], INK) if part.types else INK,
            drawstyle="steps-post" if part.law.jumps else "default",
            label=f"{name}: at once" if sudden else name,
        )
        if sudden:
            axes.set_yticks([0.0, 1.0], ["lives", "dies"])
    axes.set_xlim(0.0, reach)
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    axes.set_xlabel(f"{signal}, {unit}" if unit else signal)
    unit_shown = "" if any(math.isinf(part.high) for part in parts) else of
    axes.set_title(behaviour + unit_shown, loc="left", fontsize="medium")
    axes.locator_params(axis="x", nbins=4)
    if len(parts) > 1 or parts[0].types:
        axes.legend(frameon=False)
