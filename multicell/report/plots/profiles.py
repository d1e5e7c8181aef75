"""Profiles: concentrations or pressure, and states or types, against the radius."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from multicell.report.plots import style
from multicell.results.frame import Frame
from multicell.results.observables import (
    RadialProfile,
    centre,
    distances,
    field_profile,
    means,
    radial_profile,
    uniform_radius,
)
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
    draw = _field_panels if len(profile.concentrations) > 1 else _two_panels
    draw(figure, frame, profile, scene)
    return figure


def _two_panels(figure: Figure, frame: Frame, profile: RadialProfile, scene: Scene) -> None:
    place = {"left": 0.115, "right": 0.77, "top": 0.82, "bottom": 0.11, "hspace": 0.32}
    upper, lower = figure.subplots(2, sharex=True, gridspec_kw=place)
    upper.tick_params(labelbottom=True)
    for name in profile.concentrations:
        words = f"{name}\nfield", f"{name}\nat the cells", "below {:.3g} mM:\ncells {}"
        _draw_field(upper, frame, profile, name, scene, words)
        upper.set(title="Concentration", ylabel="concentration (mM)")
    if not profile.concentrations:
        pressure = 1000.0 * profile.pressure
        upper.plot(profile.middles, pressure, "o-", color=style.BLUE, lw=2, label="mean pressure")
        upper.set(title="Pressure", ylabel="pressure (Pa)")
    _draw_parts(lower, frame, profile, scene)
    for axes in (upper, lower):
        handles, labels = axes.get_legend_handles_labels()
        axes.legend(handles[::-1], labels[::-1], loc="upper left", bbox_to_anchor=(1.01, 1.03))


def _field_panels(figure: Figure, frame: Frame, profile: RadialProfile, scene: Scene) -> None:
    names = list(profile.concentrations)
    rows = (len(names) + 2) // 2
    grid = figure.add_gridspec(
        rows, 2, left=0.1, right=0.97, top=0.82, bottom=0.1, wspace=0.24, hspace=0.5
    )
    for k, name in enumerate(names):
        axes = figure.add_subplot(grid[k // 2, k % 2])
        words = "field", "at the cells", "below: cells {1}"
        _draw_field(axes, frame, profile, name, scene, words)
        axes.set(title=style.type_label(name).capitalize(), ylabel="mM")
        axes.set_xlim(0.0, float(profile.edges[-1]))
        axes.legend(loc="best", fontsize=9)
    axes = figure.add_subplot(grid[len(names) // 2, len(names) % 2])
    _draw_parts(axes, frame, profile, scene)
    axes.set_ylim(0, 125)  # room for the legend above the bars
    axes.set_yticks([0, 25, 50, 75, 100])
    axes.legend(loc="upper left", fontsize=9, ncols=3)
    for axes in figure.axes[-2:]:
        axes.set_xlabel("distance from the centre (µm)")


def _draw_field(
    axes: Axes,
    frame: Frame,
    profile: RadialProfile,
    name: str,
    scene: Scene,
    words: Sequence[str],
) -> None:
    """Draw one field against the radius: line the field, points the cells, and thresholds.

    ``words``: of the three in the legend, the last a format of its value and meaning.
    """
    values = profile.concentrations[name]
    top = float(np.nanmax(values))
    if name in frame.fields:
        there = frame.fields[name]
        edges = np.arange(0.0, profile.edges[-1] + there.spacing, there.spacing)
        found = field_profile(there, centre(frame.cells, scene.dimensions), edges)
        filled = np.isfinite(found)
        middles = 0.5 * (edges[1:] + edges[:-1])
        axes.plot(middles[filled], found[filled], color=style.BLUE, lw=2, alpha=0.6, label=words[0])
        top = max(top, float(found[filled].max(initial=0.0)))
    axes.plot(profile.middles, values, "o", color=style.BLUE, ms=6, label=words[1], zorder=4)
    field = scene.nutrients[name]
    for meaning, level, dashes in ("rest", field.quiescence, "-"), ("die", field.necrosis, "--"):
        if level is not None and 0.0 < level < 1.1 * top:  # within the axis
            label = words[2].format(level, meaning)
            axes.axhline(level, color=style.RED, lw=1.4, ls=dashes, label=label)
    axes.set_ylim(0.0, 1.1 * top if top > 0.0 else 1.0)


def _draw_parts(axes: Axes, frame: Frame, profile: RadialProfile, scene: Scene) -> None:
    bottom, width, types = np.zeros(len(profile.counts)), np.diff(profile.edges), list(scene.types)
    parts, colours = profile.fractions, dict(style.COLOURS)
    if len(types) > 1:
        radius, kind = (
            distances(frame.cells, centre(frame.cells, scene.dimensions)),
            frame.cells.kind,
        )
        parts = {name: means(radius, profile.edges, kind == k) for k, name in enumerate(types)}
        colours |= style.type_colours(types)
    for name in [n for n in reversed(colours) if n in parts and np.nansum(parts[n]) > 0]:
        part = np.nan_to_num(100.0 * parts[name])
        look: dict[str, Any] = {"color": colours[name], "label": style.type_label(name), "lw": 0}
        axes.bar(profile.middles, part, width, bottom, **look)
        bottom += part
    title = "Cells by type" if len(types) > 1 else "Cells by state"
    axes.set(title=title, ylabel="part of the cells (%)", ylim=(0, 100))
    axes.set(xlabel="distance from the centre (µm)", xlim=(0.0, float(profile.edges[-1])))
