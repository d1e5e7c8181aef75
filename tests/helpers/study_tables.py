"""Tables of studies made by hand: what a study of spheroids would give, without running any."""

import numpy as np
import xarray as xr

UNITS = {"cells": "", "diameter": "um", "viable_rim": "um", "necrotic_radius": "um"}
AXES = {
    "oxygen.boundary": ([0.07, 0.14, 0.28], "mM"),
    "glucose.boundary": ([0.8, 1.8, 5.5, 16.5], "mM"),
    "cycle_time": ([28800.0, 54000.0], "s"),
    "law": (["jkr", "hertz", "spring"], ""),
}
DAY = 86400.0
TIMES = np.linspace(0.0, 10.0 * DAY, 41)


def columns(oxygen, glucose, cycle, law, noise):
    """Return the course of each observable: growth that slows down, a core once it is large."""
    rate = {"jkr": 1.0, "hertz": 1.1, "spring": 0.9}[law] * (54000.0 / cycle) ** 0.5
    rim = 60.0 + 500.0 * oxygen * glucose / (glucose + 1.0) + 4.0 * noise[0]
    last = (250.0 + 12.0 * rim**0.7 + 10.0 * noise[1]) * rate
    diameter = 100.0 + (last - 100.0) * (1.0 - np.exp(-TIMES / (4.0 * DAY)))
    core = np.maximum(0.5 * diameter - rim, 0.0)
    return {
        "cells": np.round((diameter / 8.0) ** 3 * 0.7),
        "diameter": diameter,
        "viable_rim": np.where(core > 0.0, rim, np.nan),
        "necrotic_radius": core,
    }


def _filled(points, seeds, shape):
    """Return the data of all points, each a mapping of axis to value, and its shape."""
    usual = {"oxygen.boundary": 0.14, "glucose.boundary": 5.5, "cycle_time": 54000.0, "law": "jkr"}
    rng = np.random.default_rng(5)
    shaken = rng.standard_normal((len(points), seeds, 2))
    found = {name: np.empty((len(points), seeds, len(TIMES))) for name in UNITS}
    for k, point in enumerate(points):
        for s in range(seeds):
            one = columns(*(usual | point).values(), shaken[k, s])
            for name in UNITS:
                found[name][k, s] = one[name]
    return {name: values.reshape((*shape, seeds, len(TIMES))) for name, values in found.items()}


def grid(*names, seeds=5):
    """Return the table of a full grid over some of `AXES`."""
    values = [AXES[name][0] for name in names]
    mesh = np.meshgrid(*(np.arange(len(entry)) for entry in values), indexing="ij")
    places = np.stack([entry.ravel() for entry in mesh], axis=-1)
    points = [{n: v[k] for n, v, k in zip(names, values, row, strict=True)} for row in places]
    data = _filled(points, seeds, [len(entry) for entry in values])
    coordinates = {name: (name, AXES[name][0], {"units": AXES[name][1]}) for name in names}
    return _table((*names, "seed", "time"), data, coordinates, seeds)


def sampled(*names, count=24, seeds=3):
    """Return the table of a sample over some of `AXES`."""
    rng = np.random.default_rng(2)
    drawn = {}
    for name in names:
        values = AXES[name][0]
        words = isinstance(values[0], str)
        drawn[name] = (
            rng.choice(values, count) if words else rng.uniform(*values[:: len(values) - 1], count)
        )
    points = [{name: drawn[name][k] for name in names} for k in range(count)]
    points = [{n: str(v) if isinstance(v, str) else float(v) for n, v in p.items()} for p in points]
    coordinates = {name: ("point", drawn[name], {"units": AXES[name][1]}) for name in names}
    coordinates["point"] = np.arange(count)
    return _table(("point", "seed", "time"), _filled(points, seeds, [count]), coordinates, seeds)


def _table(dimensions, data, coordinates, seeds):
    variables = {name: (dimensions, data[name], {"units": UNITS[name]}) for name in UNITS}
    variables["state"] = (dimensions[:-1], np.full(data["cells"].shape[:-1], "done", dtype="U7"))
    coordinates |= {"seed": np.arange(seeds), "time": ("time", TIMES, {"units": "s"})}
    return xr.Dataset(variables, coordinates)


def with_states(table, failed=(), waiting=()):
    """Return a table in which some runs, given by their places, have failed or have not run."""
    first = table["cells"].isel(time=0, drop=True)
    state = first.copy(data=np.full(first.shape, "done", dtype="U7"))
    state.attrs.clear()
    gone = first.copy(data=np.zeros(first.shape, bool))
    for words, places in (("failed", failed), ("waiting", waiting)):
        for place in places:
            state.values[place] = words
            gone.values[place] = True
    return table.where(~gone).assign(state=state)
