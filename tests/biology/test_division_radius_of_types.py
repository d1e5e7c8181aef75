"""Types that divide at a radius of their own, by closed forms and by scenes of that radius."""

import numpy as np
import pytest
from running import finished, refused

import multicell as mc
from multicell.biology.division import change_types, divide
from multicell.biology.exposure import Exposure
from multicell.biology.initial import initial_cells
from multicell.biology.plan import biology_plan
from multicell.biology.step import divide_and_remove
from multicell.cells import SPHERE, State
from multicell.errors import DataError
from multicell.report.explain.scene import explain
from multicell.scene.pairs import explicit_limit, pair_of, type_pairs
from multicell.scene.scene import Scene
from multicell.scene.sizes import birth_radius, typical_radius
from multicell.scene.start_checks import deep_overlaps

HOUR = 3600.0
BIRTH = 0.5 * SPHERE * 5.0**3
PHASES = {
    p: {"duration": h * HOUR} for p, h in zip(("G1", "S", "G2", "M"), (4, 3, 2, 1), strict=True)
}
CYCLES = {
    "linear": {"cycle_time": "10 h"},
    "exponential": {"cycle_time": "10 h", "law": "exponential"},
    "phases": {"phases": PHASES, "hypertrophy": False},
    "relaxation": {
        "law": "relaxation", "parameters": {"target": 1.2},
        "phases": {**PHASES, "S": {"duration": "3 h", "target_scale": 1.1}},
    },
}  # fmt: skip


def scene(types, cycle="linear", **rest):
    """Return cells that grow and do not act on each other."""
    entries = {
        "duration": "12 h", "coupling_step": "10 min", "initial": {"count": 4},
        "cells": {"young_variation": 0.0}, "contact": {"law": "none"},
        "growth": {"cycle_variation": 0.0, **CYCLES[cycle]}, "types": types, **rest,
    }  # fmt: skip
    return Scene.from_dict(entries)


def both(scale):
    return {"a": {"fraction": 1}, "b": {"fraction": 1, "division_radius_scale": scale}}


@pytest.mark.parametrize("cycle", CYCLES)
def test_cells_of_a_scaled_type_are_those_of_a_scene_of_that_radius(cycle):
    """A factor of two is exact in binary numbers: so is everything that follows from it."""
    rest = {
        "duration": "4 h", "initial": {"count": 12, "stage": "asynchronous", "jitter": 0.1},
        "growth": {**CYCLES[cycle], "critical_pressure": "0.5 kPa"},
        "contact": {"law": "jkr", "surface_energy": 0.1}, "seed": 3,
        "death": {"apoptosis_rate": "0.05 1/h", "apoptosis_time": "1 h", "removal_fraction": 0.5},
        "motility": {"force": 0.2, "diffusion": 1e-3},
        "domain": {axis: [-45.0, 45.0] for axis in "xyz"},
        "nutrients": {"oxygen": {"quiescence": 0.05, "uptake": 200.0}},
    }  # fmt: skip
    given = [scene({"a": {"division_radius_scale": s}}, cells={"division_radius": r}, **rest)
             for s, r in ((2.0, 5.0), (1.0, 10.0))]  # fmt: skip
    runs = [finished(described) for described in given]
    assert runs[0].divisions > 0
    for (name, mine), (_, theirs) in zip(*(run.cells.columns() for run in runs), strict=True):
        np.testing.assert_array_equal(mine, theirs, err_msg=name)
    assert str(explain(given[0])["numbers"]) == str(explain(given[1])["numbers"])


@pytest.mark.parametrize("law", ["linear", "exponential"])
def test_two_types_double_their_own_volumes_in_one_cycle(law):
    described = scene(both(1.6), law, output={"every": "2 h"})
    result = mc.run(described, report=False)
    for frame in result.frames:
        cells, share = frame.cells, frame.time / (10 * HOUR)
        assert len(cells) == (4 if share < 1.0 else 8)
        share %= 1.0
        grown = 1.0 + share if law == "linear" else 2.0**share
        expected = BIRTH * np.array([1.0, 1.6**3])[cells.kind] * grown
        np.testing.assert_allclose(cells.volume, expected, rtol=1e-9)
        assert (cells.kind == 1).mean() == 0.5


def changed(described, kind, cells):
    """Return cells after a step at the end of which they have become another type."""
    response = {"behaviour": f"change to {kind}", "law": "constant", "largest": 1.0}
    plan = biology_plan(described.with_changes({"responses": [response]}))
    return change_types(plan, cells, Exposure(cells, {}, 1e6))


def test_a_cell_that_becomes_larger_grows_from_its_volume_to_its_new_one():
    """From V_b at s³ V_b / T to 2 s³ V_b, for (2 s³ - 1)/s³ T = 1.704 T instead of T."""
    to_b = {"behaviour": "change to b", "law": "constant", "largest": 1.0, "cells": "a"}
    types = {"a": {"fraction": 1}, "b": {"fraction": 0, "division_radius_scale": 1.5}}
    described = scene(types, responses=[to_b], duration="18 h", output={"every": "10 min"})
    result = mc.run(described, report=False)
    first = next(frame.time for frame in result.frames if len(frame.cells) == 8)
    own = 1.5**3 * BIRTH
    # the first step, in which it changes, is one of the old type's growth
    due = 600.0 + (2.0 * own - BIRTH * (1.0 + 1.0 / 60.0)) / own * 10 * HOUR
    assert first - 600.0 < due <= first
    assert (result.frames[1].cells.kind == 1).all()
    np.testing.assert_allclose(result.frames[1].cells.volume, BIRTH * (1.0 + 1.0 / 60.0))


def test_a_cell_that_becomes_smaller_keeps_its_volume_and_divides_until_it_has_its_size():
    types = both(0.5)
    described = scene(types).with_changes({"types.b.fraction": 0.0})
    cells = initial_cells(described)
    after = changed(described, "b", cells)
    np.testing.assert_array_equal(after.volume, cells.volume)
    plan, next_id = biology_plan(described), 4
    sizes = [len(after)]
    for _ in range(4):
        after, next_id = divide(plan, after, next_id)
        sizes.append(len(after))
    # from 8 V_b(b): divided at 8, 4 and 2, not at 1
    assert sizes == [4, 8, 16, 32, 32]
    np.testing.assert_allclose(after.volume, BIRTH / 8.0, rtol=1e-12)


def test_sizes_of_cells_in_phases_come_to_those_of_their_new_type():
    """The size missing at birth is halved in each generation, with linear growth."""
    to_b = {"behaviour": "change to b", "law": "constant", "largest": 1.0, "cells": "a"}
    types = {"a": {"fraction": 1}, "b": {"fraction": 0, "division_radius_scale": 1.5}}
    described = scene(types, "phases", responses=[to_b], duration="51 h",
                      growth={"phases": PHASES}, initial={"count": 1})  # fmt: skip
    cells = finished(described).cells
    own = 1.5**3 * BIRTH
    assert len(cells) == 32
    # the first sixtieth of a cycle was one of the old type
    missing = (own - BIRTH) * (1.0 + 1.0 / 60.0)
    newborn = own - missing / 32.0
    np.testing.assert_allclose(cells.volume, newborn + 0.1 * own, rtol=1e-9)


@pytest.mark.parametrize("cycle", ["linear", "exponential", "relaxation"])
def test_what_is_to_be_made_good_stays_the_same_volume(cycle):
    described = scene(both(1.5), cycle).with_changes({"types.b.fraction": 0.0})
    cells = initial_cells(described.with_changes({"initial.stage": "uniform"}))
    cells.lag = np.linspace(-60.0, 60.0, 4)
    after = changed(described, "b", cells)
    law, scales = described.growth.growth_law, described.growth.target_scales
    scale = 1.0 if scales is None else scales[cells.phase]
    owed = [
        scale * law.rate(some.volume / scale, birth) * some.lag
        for some, birth in ((cells, BIRTH), (after, 1.5**3 * BIRTH))
    ]
    np.testing.assert_allclose(owed[1], owed[0], rtol=1e-12)
    again = changed(described, "a", after)
    np.testing.assert_allclose(again.lag, cells.lag, rtol=1e-12)


def test_daughters_of_another_size_are_half_of_their_mother():
    response = {"behaviour": "mutation to b", "law": "constant", "largest": 1.0}
    described = scene(both(2.0), responses=[response]).with_changes({"types.b.fraction": 0.0})
    mothers = initial_cells(described)
    mothers.radius = np.full(4, 5.0)
    daughters, _ = divide(biology_plan(described), mothers, 4)
    assert (daughters.kind == 1).all()
    np.testing.assert_allclose(daughters.volume, BIRTH, rtol=1e-12)


def test_the_dead_are_removed_at_a_part_of_the_volume_of_their_type():
    described = scene(both(3.0), death={"apoptosis_time": "1 h"})
    cells = initial_cells(described)
    cells.state[:] = State.APOPTOTIC
    plan = biology_plan(described)
    for part, left in ((0.11, 4), (0.09, 0)):
        shrunk = cells.changed(radius=cells.radius * part ** (1.0 / 3.0))
        assert len(divide_and_remove(plan, shrunk, 100, 0.0, 0.0).cells) == left


def test_pairs_and_estimates_know_the_sizes_of_types():
    described = scene(both(2.0), contact={"law": "hertz"}).with_changes({"types.a.fraction": 3.0})
    mean = ((3.0 + 8.0) / 4.0) ** (1.0 / 3.0)
    newborn = 5.0 / 2.0 ** (1.0 / 3.0)
    assert birth_radius(described) == pytest.approx(mean * newborn, rel=1e-12)
    assert typical_radius(described) == pytest.approx(mean * newborn * 2.0 ** (1 / 6), rel=1e-12)
    found = dict(type_pairs(described, birth_radius(described)))
    for label, (i, j) in {"a-a": (0, 0), "a-b": (0, 1), "b-b": (1, 1)}.items():
        sizes = [newborn * (1.0, 2.0)[kind] for kind in (i, j)]
        expected = pair_of(described, i, j, *sizes)
        assert found[label].rest == pytest.approx(expected.rest, rel=1e-12)
        assert found[label].radius == pytest.approx(expected.radius, rel=1e-12)
    # by Hertz stiffness and drag grow alike with size
    alike = explicit_limit(scene({}, contact={"law": "hertz"}))
    assert explicit_limit(described) >= 0.9 * alike
    numbers = {n["name"]: n["value"] for n in explain(described)["numbers"]}
    assert numbers["birth radius, a"] == pytest.approx(newborn, rel=1e-12)
    assert numbers["birth radius, b"] == pytest.approx(2.0 * newborn, rel=1e-12)


def test_a_coarse_scene_keeps_the_ratio_of_sizes():
    described = scene(both(1.5), contact={"law": "hertz"}, initial={"count": 800})
    coarse = mc.coarsen(described, 2)
    assert coarse.types["b"].division_radius_scale == 1.5
    assert birth_radius(coarse) == pytest.approx(2.0 * birth_radius(described), rel=1e-12)
    volumes = [initial_cells(some).volume.sum() for some in (described, coarse)]
    assert volumes[1] == pytest.approx(volumes[0], rel=1e-9)


def test_tables_are_judged_by_the_type_of_each_cell(tmp_path):
    file = tmp_path / "cells.csv"

    def start(rows):
        file.write_text("position_x_um,position_y_um,position_z_um,radius_um,type\n" + rows)
        return scene(both(2.0), contact={"law": "hertz"}, initial={"cells": str(file)})

    cells = initial_cells(start("0,0,0,4,a\n30,0,0,9,b\n"))
    np.testing.assert_array_equal(cells.radius, [4.0, 9.0])
    # the shares of growth by their own sizes: (4/5)³ and (9/10)³ of the division volume
    shares = 2.0 * np.array([0.8, 0.9]) ** 3 - 1.0
    np.testing.assert_allclose(cells.age / cells.cycle_time, shares, rtol=1e-9)
    with pytest.raises(DataError, match=r"line 3, .* is 9, beyond the radius .* cell, 5 um"):
        initial_cells(start("0,0,0,9,b\n30,0,0,9,a\n"))
    rows = "0,0,0,b\n5,0,0,b\n30,0,0,a\n35,0,0,a\n"
    file.write_text("position_x_um,position_y_um,position_z_um,type\n" + rows)
    crowded = scene(both(2.0), contact={"law": "hertz"}, initial={"cells": str(file)})
    assert deep_overlaps(crowded) == 1  # 5 um are less than a radius of b only


def test_what_does_not_fit_the_largest_or_smallest_type_is_refused():
    with refused("domain.radius", "at least 10 um"):
        scene(both(2.0), domain={"shape": "sphere", "radius": 9.0})
    with refused("contact.smoothing", "birth radius 1.98"):
        scene(both(0.5), contact={"law": "jkr", "smoothing": 2.0})
    to_b = {"behaviour": "mutation to b", "law": "constant", "largest": 1.0}
    lasting = {"phases": PHASES, "law": "exponential"}
    with refused("responses.response_1.behaviour", "never reach"):
        scene(both(0.5), growth=lasting, responses=[to_b])
    assert scene(both(1.0), growth=lasting, responses=[to_b]).responses
    assert scene(both(0.5), growth=lasting).types
