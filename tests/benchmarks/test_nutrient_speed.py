"""Speed of the nutrient field on one thread; the numbers are recorded, none is a limit here.

Aims: a warm-started solve within 8 ms on 32³ nodes, 80 ms on 64³ and 1.2 s on 128³.
"""

import numpy as np
import pytest

from multicell.nutrient.cartesian import gather, scatter
from multicell.nutrient.field import NutrientField
from multicell.nutrient.parameters import FieldParameters
from multicell.scene.nutrient import Nutrient

pytestmark = pytest.mark.benchmark


def spheroid(radius, spacing):
    """Return a solved oxygen field with its cells (diameter 10 µm) and their uptake."""
    rng = np.random.default_rng(1)
    n = int(0.64 * (radius / 5.0) ** 3)
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    position = direction * radius * rng.random((n, 1)) ** (1 / 3)
    oxygen = FieldParameters(Nutrient(), spacing, 10.0, "steady", dimensions=3)
    field, capacity = NutrientField("oxygen", oxygen), np.full(n, 20.0)
    field.solve(position, capacity)
    return field, position, capacity


@pytest.mark.parametrize(("radius", "spacing"), [(100, 10.0), (250, 10.0), (250, 5.0)])
def test_warm_started_solve(benchmark, radius, spacing):
    field, position, capacity = spheroid(radius, spacing)
    rng = np.random.default_rng(2)

    def next_step():
        moved = position * 1.001 + rng.normal(0.0, 0.1, position.shape)
        return (moved, capacity), {}

    report = benchmark.pedantic(field.solve, setup=next_step, rounds=5, warmup_rounds=1)
    benchmark.extra_info |= {
        "nodes": field.box.shape,
        "cells": len(position),
        "newton": report.newton,
        "cg": report.cg,
    }
    assert report.inflow == pytest.approx(report.uptake, rel=1e-8)


def test_laying_a_grid(benchmark):
    field, position, capacity = spheroid(100, 10.0)

    def anew():
        return NutrientField("oxygen", field.parameters).lay(position, np.ones(len(position)))[0]

    assert benchmark(anew) == field.layout
    assert len(capacity) == len(position)


def test_scatter_of_100_000_cells(benchmark):
    position = np.random.default_rng(3).uniform(0.0, 640.0, (100_000, 3))
    amount = np.ones(len(position))
    density = benchmark(scatter, position, amount, (0.0, 0.0, 0.0), 10.0, (64, 64, 64))
    assert density.sum() * 1000.0 == pytest.approx(1e5)


def test_gather_at_100_000_cells(benchmark):
    position = np.random.default_rng(3).uniform(0.0, 640.0, (100_000, 3))
    values = benchmark(gather, position, np.ones((64, 64, 64)), (0.0, 0.0, 0.0), 10.0)
    assert len(values) == 100_000
