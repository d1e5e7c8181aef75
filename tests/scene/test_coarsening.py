"""Scenes of fewer, larger cells: laws against similarity, and what has no law is refused."""

import numpy as np
import pytest
from click.testing import CliRunner

import multicell as mc
from multicell.cli.main import main
from multicell.contact.registry import CONTACT_LAWS as CONTACT
from multicell.report.explain.scene import explain
from multicell.scene.coarsening import SCALING_EXPONENTS
from multicell.scene.pairs import type_pairs
from multicell.scene.scene import Scene
from multicell.schema import specs

BALL = mc.load_scene("settle").with_changes({"duration": "2 min", "seed": 3})


def keys(part, path=""):
    """Yield every key that a scene may have, with stars for names, and its unit."""
    for name, spec in specs(part).items():
        key = f"{path}{name}"
        inner = [spec.table] if spec.table else list((spec.parts or {}).values())
        stop = isinstance(SCALING_EXPONENTS.get(key), str)
        for one in [] if stop else inner:
            yield from keys(one, f"{key}.*." if spec.kind == "tables" else f"{key}.")
        if stop or not inner:
            yield key, spec.unit


def test_every_key_with_a_length_a_force_or_an_amount_has_a_law():
    known = dict(keys(Scene))
    sized = {key for key, unit in known.items() if any(x in unit for x in ("um", "nN", "amol"))}
    assert len(sized) > 25
    assert sized <= set(SCALING_EXPONENTS) <= set(known)


@pytest.mark.parametrize("factor", [1.5, 2.0, 4.0])
@pytest.mark.parametrize("law", CONTACT)
def test_stress_of_a_contact_is_the_same(law, factor):
    """F(f h, f r) = f² F(h, r), so that force over area is a function of h / r alone."""
    scene = BALL.with_changes({"contact": {"law": law}, "initial.count": 1000})
    if "smoothing" in specs(CONTACT[law]):
        scene = scene.with_changes({"contact.smoothing": "0.5 um"})
    (_, fine), (_, coarse) = (next(type_pairs(s, s.cells.division_radius)) for s in (
        scene, mc.coarsen(scene, factor)))  # fmt: skip
    overlap = np.linspace(-0.5, 4.0, 10)
    assert coarse.force(factor * overlap) == pytest.approx(factor**2 * fine.force(overlap))


def end(scene):
    return mc.run(scene, report=False).frames[-1].cells


def coarse_of_as_many(scene, factor):
    """Return the coarse scene with as many cells as the fine one: the same arrangement, wider."""
    return mc.coarsen(scene, factor).with_changes({"initial.count": scene.initial.count})


def test_contacts_relax_as_drag_per_volume_says():
    """Forces grow as f², drag per volume stays: x(f² t) of wide cells is f x(t)."""
    long = coarse_of_as_many(BALL, 2).with_changes({"duration": "8 min", "coupling_step": "8 min"})
    fine, coarse = end(BALL.with_changes({"coupling_step": "2 min"})), end(long)
    moved = np.abs(fine.position - end(BALL.with_changes({"duration": 1e-3})).position).max()
    assert moved > 0.5
    assert coarse.position == pytest.approx(2.0 * fine.position, abs=0.02 * moved)
    assert coarse.young == pytest.approx(fine.young)


def test_viscosity_of_tissue_is_the_same():
    """With friction between cells alone, x(t) of wide cells is f x(t): the same strain rates."""
    rubbing = BALL.with_changes(
        {"friction": {"normal": 2.0, "tangential": 1.0}, "drag.viscosity": 1e-4,
         "coupling_step": "2 min"}
    )  # fmt: skip
    fine, coarse = end(rubbing), end(coarse_of_as_many(rubbing, 2))
    moved = np.abs(fine.position - end(rubbing.with_changes({"duration": 1e-3})).position).max()
    assert moved > 0.5
    assert coarse.position == pytest.approx(2.0 * fine.position, abs=0.03 * moved)


FREE = Scene.from_dict(
    {"duration": "1 h", "initial": {"count": 27, "spacing": 50.0}, "contact": {"law": "hertz"},
     "motility": {"force": 0.2, "bias": 0.5, "direction": [1, 0, 0]}}
)  # fmt: skip


def test_free_cells_drift_and_diffuse_alike():
    """Speed = force / drag and persistence stay: single cells go the same ways."""
    ways = [
        end(s).position - mc.Simulation(s).cells.position
        for s in (FREE, coarse_of_as_many(FREE, 3))
    ]
    assert ways[1] == pytest.approx(ways[0], rel=1e-6)
    assert np.abs(ways[0]).max() > 1.0


def test_uptake_and_secretion_of_the_tissue_are_the_same():
    fine = mc.load_scene("treatment").with_changes(
        {"initial.count": 800, "nutrients.oxygen.secretion": 2}
    )
    coarse = mc.coarsen(fine, 2)
    for key in ("uptake", "secretion"):
        amounts = [s.initial.count * getattr(s.nutrients["oxygen"], key) for s in (fine, coarse)]
        assert amounts[1] == pytest.approx(amounts[0])
    volumes = [s.initial.count * s.cells.division_radius**3 for s in (fine, coarse)]
    assert volumes[1] == pytest.approx(volumes[0])


def test_counts_are_those_of_the_tissue():
    kinds = {"a": {"young": 1}, "b": {"young": 2}}  # contacts are counted where types differ
    scene = mc.coarsen(BALL.with_changes({"initial.count": 160, "types": kinds}), 2)
    result = mc.run(scene, report=False)
    assert scene.cells.represents == 8.0
    assert len(result.frames[-1].cells) == 20
    assert result.history["cells"][-1] == 160.0
    assert result.history["contacts"][-1] == 8 * len(result.frames[-1].contacts)
    assert result.summary()["cells"] == 160
    assert result.summary()["states"]["proliferating"] == 160
    assert "8" in scene.title
    assert "each for 8" in str(explain(scene)["parts"])


def test_divisions_are_counted_for_the_tissue():
    scene = mc.load_scene("growth").with_changes({"initial.count": 8, "duration": "30 h"})
    summary = mc.run(mc.coarsen(scene, 2), report=False).summary()
    assert summary["cells"] == 8 + summary["divisions"]
    assert summary["divisions"] % 8 == 0
    assert summary["divisions"] > 0


def test_twice_is_once():
    scene = mc.load_scene("sorting").with_changes({"initial.count": 1600, "stop_cells": 80000})
    twice, once = mc.coarsen(mc.coarsen(scene, 2), 2), mc.coarsen(scene, 4)
    assert twice.with_changes({"title": ""}) == once.with_changes({"title": ""})
    assert once.stop_cells == 1250


SIZES = {
    "responses": {
        "a": {"behaviour": "growth rate", "signal": "volume", "half": 300},
        "b": {"behaviour": "apoptosis rate", "signal": "radius", "law": "table",
              "points": [[4, 0], [5, 1e-6]]},
        "c": {"behaviour": "Young's modulus", "signal": "oxygen", "half": 0.1, "base": 2},
    },
    "initial.count": 80,
}  # fmt: skip


def test_levels_of_size_grow_with_the_cell():
    coarse = mc.coarsen(mc.load_scene("spheroid").with_changes(SIZES), 2)
    assert coarse.responses["a"].half == 2400
    assert coarse.responses["b"].points == ((8, 0), (10, 1e-6))
    assert coarse.responses["c"].half == 0.1


MANY = {"initial.count": 80}


@pytest.mark.parametrize(
    ("name", "changes", "factor", "path", "said"),
    [
        ("growth", MANY, 0.5, "factor", "must be from 1 to 10"),
        ("growth", {}, 2, "initial.count", "cannot stand for"),
        ("growth", {"initial.count": 12}, 2, "initial.count", "1.5 coarse cells"),
        ("monolayer", MANY, 2, "dimensions", "thicker layer"),
        ("growth", {"initial": {"count": 80, "shape": "row"}}, 2, "initial.shape", "shorter"),
        ("growth", {"pull": {"force": 1}, **MANY}, 2, "pull", "single contacts"),
        ("growth", {"motions": {"a": {"cells": [1]}}, **MANY}, 2, "motions.*.cells",
         "type or region"),
    ],
)  # fmt: skip
def test_what_has_no_law_is_refused(name, changes, factor, path, said):
    scene = mc.load_scene(name).with_changes(changes)
    with pytest.raises(mc.SceneError, match=said) as error:
        mc.coarsen(scene, factor)
    assert error.value.path == path


@mc.pair_law(parameters={"stiffness": "nN/um"})
def soft(overlap, modulus, radius, p):
    return p.stiffness * overlap if overlap > 0.0 else 0.0


@mc.response(parameters={})
def steep(signal, p):
    return signal * 0.0


STEEP = {"behaviour": "growth rate", "law": steep.scene_name(), "signal": "volume"}


@pytest.mark.parametrize(
    ("changes", "path", "said"),
    [
        ({"contact": soft(stiffness=1.0)}, "contact.law", "law of your own"),
        ({"responses.a": STEEP}, "responses.a.law", "size of the cell"),
    ],
)
def test_laws_of_the_users_own_are_refused(changes, path, said):
    with pytest.raises(mc.SceneError, match=said) as error:
        mc.coarsen(mc.load_scene("growth").with_changes({**MANY, **changes}), 2)
    assert error.value.path == path


def test_a_table_of_cells_is_refused(tmp_path):
    (tmp_path / "cells.csv").write_text("x (um),y (um),z (um)\n0,0,0\n9,0,0\n")
    scene = BALL.with_changes({"initial.cells": str(tmp_path / "cells.csv")})
    with pytest.raises(mc.SceneError, match="places of single cells"):
        mc.coarsen(scene, 2)


def test_the_command_writes_a_scene(tmp_path):
    path = tmp_path / "coarse.toml"
    command = ["coarsen", "emt6", "-o", str(path), "--factor", "2", "--set", "stop_cells=8000"]
    done = CliRunner().invoke(main, command)
    assert "each cell stands for 8" in done.stdout
    fine = mc.load_scene("emt6").with_changes({"stop_cells": 8000})
    assert mc.load_scene(path) == mc.coarsen(fine, 2)
    again = CliRunner().invoke(main, command)
    assert again.exit_code == 2
    assert CliRunner().invoke(main, [*command, "--factor", "3", "--overwrite"]).exit_code == 0
    assert mc.load_scene(path).initial.count == 22
