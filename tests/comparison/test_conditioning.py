"""The worst cell as a norm, and how a random shift of all positions changes the end of a step."""

import json
import math

import numpy as np
import pytest
import two_cells
from two_cells import PAIR, RADIUS, PlantedInSteps, step_method

from multicell.comparison.norms import NORMS, apart
from multicell.comparison.result import WorkPrecision

EXACT = step_method(lambda _: PlantedInSteps(), "exact")
BOTH_EXACT = [(EXACT, 1.0), (EXACT, 1.0)]


def compared(methods, ladder, scene=PAIR, **options):
    return two_cells.compared(
        methods, ladder, scene, **{"references": BOTH_EXACT, "stepwise": True, **options}
    )


# the worst cell


def test_the_worst_cell_of_each_time_is_that_with_the_largest_displacement():
    """By hand: 3-4-5 and 6-8-10 triangles among cells that stay."""
    first, second = np.zeros((4, 3)), np.zeros((2, 3))
    moved, other = first.copy(), second.copy()
    moved[2] = (3.0, 4.0, 0.0)
    moved[3] = (0.0, 0.0, 1.0)
    other[0] = (6.0, 0.0, 8.0)
    rms, worst = apart([moved, other], [first, second])
    np.testing.assert_allclose(worst, [5.0, 10.0], rtol=1e-15)
    np.testing.assert_allclose(rms, [math.sqrt(26.0 / 4.0), math.sqrt(50.0)], rtol=1e-15)


class OneAstray:
    """The exact end of a step, but for the second cell, which lies 0.1 µm a minute further off."""

    def integrate(self, system, position):
        outcome = PlantedInSteps().integrate(system, position)
        outcome.position[1, 2] += system.motion.end / 600.0
        return outcome


def test_the_worst_cell_is_a_norm_in_radii_and_a_column_in_um():
    """Five steps end after 1 ... 5 min: the second of two cells is off by 0.1 ... 0.5 µm."""
    result = compared([step_method(lambda _: OneAstray(), "astray")], [1.0])
    (row,) = result.table
    assert row["worst_cell_um"] == pytest.approx(0.5, rel=1e-6)
    assert row["worst_cell_median_um"] == pytest.approx(0.3, rel=1e-6)
    assert row["error_worst_cell"] == pytest.approx(0.5 / RADIUS, rel=1e-6)
    assert row["error_worst_cell_median"] == pytest.approx(0.3 / RADIUS, rel=1e-6)
    # beside it the mean square over two cells
    assert row["error_position"] == pytest.approx(0.5 / RADIUS / math.sqrt(2.0), rel=1e-6)
    assert "worst_cell_um" in result.to_csv().splitlines()[0].split(",")


def test_what_an_earlier_version_wrote_is_read_without_the_norms_that_it_lacks():
    result = compared([EXACT], [1.0])
    held = json.loads(result.to_json())
    late = [name for name in held["table"][0] if "worst_cell" in name]
    assert len(late) == 4
    for name in late:
        del held["table"][0][name]
    del held["uncertainty"]["worst_cell"]
    again = WorkPrecision.from_json(json.dumps(held))
    assert math.isnan(again.table[0]["error_worst_cell"])
    assert math.isnan(again.uncertainty["worst_cell"])
    assert again.within(0.1).keys() == result.within(0.1).keys()
    assert again.within(0.1, "worst_cell") == {}
    assert len(again.norms_figure().axes) == len(NORMS)
    twice = WorkPrecision.from_json(again.to_json())
    assert math.isnan(twice.uncertainty["worst_cell"])
