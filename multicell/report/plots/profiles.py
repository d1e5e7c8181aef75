"""Profiles: concentrations or pressure, and states or types, against the radius."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from multicell.population.extents import centre, distances, uniform_radius
from multicell.report.plots import style
from multicell.results.frame import Frame
from multicell.results.observables import RadialProfile, field_profile, means, radial_profile
from multicell.scene.responses import shared_threshold
from multicell.scene.scene import Scene


@style.styled
def profiles(frame: Frame, scene: Scene) -> Figure:
    """Draw concentrations, or pressure without fields, and states against the radius.

    Where there is more than one cell type the lower part shows types instead of states.
    """
    middle = centre(frame.cells, scene.dimensions)
    # shells about a cell wide, but never so few that a profile cannot be seen
    size = uniform_radius(frame.cells, middle, scene.dimensions)
    bins = int(np.clip(size / (2.0 * frame.cells.radius.mean()), 4, 40))
    profile = radial_profile(frame, scene.dimensions, bins)
    shells = "shells" if scene.dimensions == 3 else "rings"
    figure = style.headed(scene, f"{style.moment(frame)}: averages over {shells} about the centre")
    names = list(profile.concentrations)
    columns = 2 if len(names) > 1 else 1
    edges, panels = (0.1, 0.1, 0.97, 0.79), max(len(names), 1) + 1
    *upper, last = style.panel_grid(figure, panels, columns, edges, (0.24, 0.5))
    for axes, name in zip(upper, names, strict=False):
        _draw_field(axes, frame, profile, name, scene)
    if not names:
        pressure = 1000.0 * profile.pressure
        label = "mean pressure"
        upper[0].plot(profile.middles, pressure, "o-", color=style.BLUE, lw=2, label=label)
        upper[0].set(title="Pressure", ylabel="pressure (Pa)")
        upper[0].margins(y=0.3)
    _draw_parts(last, frame, profile, scene)
    for axes in figure.axes:
        axes.set_xlim(0.0, float(profile.edges[-1]))
        axes.legend(loc="upper left", fontsize=9, ncols=4 // columns)
    for axes in figure.axes[-columns:]:
        axes.set_xlabel("distance from the centre (µm)")
    return figure


def _draw_field(axes: Axes, frame: Frame, profile: RadialProfile, name: str, scene: Scene) -> None:
    """Draw one field against the radius: line the field, points the cells, and thresholds."""
    values = profile.concentrations[name]
    top = float(np.nanmax(values))
    if name in frame.fields:
        there = frame.fields[name]
        edges = np.arange(0.0, profile.edges[-1] + there.spacing, there.spacing)
        found = field_profile(there, centre(frame.cells, scene.dimensions), edges)
        filled = np.isfinite(found)
        middles = 0.5 * (edges[1:] + edges[:-1])
        axes.plot(middles[filled], found[filled], color=style.BLUE, lw=2, alpha=0.6, label="field")
        top = max(top, float(found[filled].max(initial=0.0)))
    axes.plot(profile.middles, values, "o", color=style.BLUE, ms=6, label="at the cells", zorder=4)
    for key, dashes in ("quiescence", "-"), ("necrosis", "--"):
        level = shared_threshold(scene, name, key)
        if level is not None and 0.0 < level < 1.1 * top:  # within the axis
            axes.axhline(level, color=style.RED, lw=1.4, ls=dashes, label=f"below: {key}")
    axes.set(title=style.type_label(name).capitalize(), ylabel="mM")
    axes.set_ylim(0.0, 1.4 * top if top > 0.0 else 1.0)  # room for the legend


def _draw_parts(axes: Axes, frame: Frame, profile: RadialProfile, scene: Scene) -> None:
    bottom, types = np.zeros(len(profile.counts)), list(scene.types)
    parts, colours = profile.fractions, dict(style.STATE_COLOURS)
    if len(types) > 1:
        kind = frame.cells.kind
        radius = distances(frame.cells, centre(frame.cells, scene.dimensions))
        parts = {name: means(radius, profile.edges, kind == k) for k, name in enumerate(types)}
        colours |= style.type_colours(types)
    for name in [n for n in reversed(colours) if n in parts and np.nansum(parts[n]) > 0]:
        part = np.nan_to_num(100.0 * parts[name])
        look: dict[str, Any] = {"color": colours[name], "label": style.type_label(name), "lw": 0}
        # one area, without lines between its shells where an edge is drawn round it
        axes.stairs(bottom + part, profile.edges, baseline=bottom, fill=True, **look)
        bottom = bottom + part
    title = "Cells by type" if len(types) > 1 else "Cells by state"
    # room for the legend above the bars
    axes.set(title=title, ylabel="part of the cells (%)", ylim=(0, 125), yticks=range(0, 101, 25))
