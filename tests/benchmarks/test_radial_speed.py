"""A steady solve on shells against one on cubes of the same spacing, on one thread."""

import numpy as np
import pytest

from multicell.nutrient.field import NutrientField
from multicell.nutrient.parameters import FieldParameters
from multicell.scene.nutrient import Nutrient

pytestmark = pytest.mark.benchmark


@pytest.mark.parametrize("geometry", ["radial", "box"])
def test_warm_started_solve_of_a_spheroid(benchmark, geometry):
    rng = np.random.default_rng(1)
    n = int(0.64 * (270.0 / 5.0) ** 3)
    direction = rng.normal(size=(n, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    position = direction * 270.0 * rng.random((n, 1)) ** (1 / 3)
    nutrient = Nutrient(geometry=geometry)
    field = NutrientField("oxygen", FieldParameters(nutrient, 10.0, 10.0, "steady", dimensions=3))
    capacity, radius = np.full(n, 20.0), np.full(n, 5.0)
    field.solve(position, capacity, radius=radius)
    layout = field.layout
    operator = layout.operator(2000.0, layout.conditions(field.parameters.sides(0.0)), None)
    sink = layout.scatter(position, capacity)
    start = field.field().values.reshape(sink.shape)
    again = benchmark(operator.solve, 1.01 * sink, 0.005, start)
    benchmark.extra_info["nodes"] = sink.size
    assert again[1].inflow == pytest.approx(again[1].uptake, rel=1e-8)
