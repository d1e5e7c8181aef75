"""Fields of tissue in a layer of medium with a shape, and round tissue to lay them round."""

from __future__ import annotations

import numpy as np

from multicell.nutrient.field import NutrientField
from multicell.nutrient.parameters import FieldParameters
from multicell.scene.nutrient import Nutrient

D, MARGIN, LEVEL = 2000.0, 50.0, 0.05  # µm²/s, µm, mM


def field(spacing, half, **changes):
    usual = {"diffusion": D, "margin": MARGIN, "boundary": LEVEL, "margin_shape": "tissue"}
    nutrient = Nutrient(half_saturation=half, **usual | changes.pop("of", {}))
    given = {"spacing": spacing, "height": 10.0, "regime": "steady", "dimensions": 3} | changes
    return NutrientField("a", FieldParameters(nutrient, **given))


def packed(radius, apart=14.0, axes=3):
    """Return places on a lattice in a ball or disc, shaken by up to a quarter."""
    random, n = np.random.default_rng(3), int(radius / apart) + 1
    along = apart * np.arange(-n, n + 1)
    places = np.stack(np.meshgrid(*[along] * axes, indexing="ij"), axis=-1).reshape(-1, axes)
    places = places + random.uniform(-0.25, 0.25, places.shape) * apart
    places = places[(places**2).sum(axis=1) < radius**2]
    return np.pad(places, ((0, 0), (0, 3 - axes))), apart**axes


def directions(position, radius):
    """Return which cells at the surface lie along axes and which along diagonals."""
    away = np.sqrt((position**2).sum(axis=1))
    unit = np.abs(position / np.maximum(away, 1.0)[:, None])
    outer = (away > radius - 20.0) & (away < radius - 4.0)
    return outer & (unit.max(axis=1) > 0.96), outer & (np.sort(unit, axis=1)[:, 1] > 0.5)
