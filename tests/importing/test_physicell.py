"""PhysiCell's settings as scenes: each element once, and numbers by closed forms."""

import math
import re
from collections import Counter

import numpy as np
import pytest
from physicell_project import MM_HG, ON
from scipy.integrate import solve_ivp
from scipy.stats import expon

import multicell as mc
from multicell.biology.draws import quantile
from multicell.importing.files import read_xml
from multicell.importing.imported import Fate
from multicell.importing.physicell.reader import _SETTINGS
from multicell.scene.pairs import pair_of
from multicell.scene.scene import Scene
from multicell.schema import specs

GROWING = (1.0 - 540.0 / 2494.0) / 0.005 + 540.0 / 2494.0 / 0.0055 + 0.75 / (0.25 * 0.05)
"""Mean time in which the volume of the settings follows its target, min."""


def fates(made):
    return {entry.path: entry.fate for entry in made.entries}


def test_each_element_has_one_entry(project):
    path = project()
    made = mc.import_physicell(path)
    counts = Counter((e.path, e.line) for e in made.entries if e.line is not None)
    leaves = [(leaf.path, leaf.line) for leaf in read_xml(path).leaves()]
    assert len(leaves) == 96
    assert [leaf for leaf in leaves if counts[leaf] != 1] == []
    assert set(counts.values()) == {1}
    assert sum(made.counts().values()) == len(made.entries)
    assert [e.path for e in made.entries if "not known" in e.note] == []


def test_space_time_and_options(project):
    scene = mc.import_physicell(project()).scene
    assert scene.dimensions == 3
    assert (scene.domain.x, scene.domain.y, scene.domain.z) == ((-100, 100), (-80, 80), (-60, 60))
    assert (scene.duration, scene.output.every, scene.seed) == (3600.0, 1800.0, 7)
    # cells that move by themselves take a new direction after 5 min on average
    assert scene.coupling_step == 300.0


def test_substances_in_our_units(project):
    made = mc.import_physicell(project())
    oxygen, factor = made.scene.nutrients["oxygen"], made.scene.nutrients["growth_factor"]
    assert oxygen.diffusion == 2000.0
    assert oxygen.decay == pytest.approx(0.01)
    assert oxygen.boundary == pytest.approx(38.0 * MM_HG, rel=1e-3)
    assert oxygen.sides["x-"].value == pytest.approx(20.0 * MM_HG, rel=1e-3)
    assert oxygen.sides["y+"].value == pytest.approx(38.0 * MM_HG, rel=1e-3)
    assert oxygen.sides["z+"].type == "derivative"
    assert (factor.boundary, factor.sides["*"].type, factor.spacing) == (0.0, "derivative", 20.0)
    # PhysiCell: U V c for any c, here up to the largest that there is
    for c in (0.1, 5.0, 38.0):
        level = c * oxygen.boundary / 38.0
        ours = oxygen.largest_uptake(2494.0) * level / (oxygen.half_saturation + level)
        assert ours == pytest.approx(10.0 / 60.0 * 2494.0 * level, rel=1.1e-3)
    # and S (T - c) V: S T V given off, S c V taken up
    assert factor.secretion == pytest.approx(2.0 * 0.5 * 2494.0 / 60.0)
    ours = factor.largest_uptake(2494.0) * 0.25 / (factor.half_saturation + 0.25)
    assert ours == pytest.approx(2.0 / 60.0 * 2494.0 * 0.25, rel=1.1e-3)
    hunter = made.scene.types["hunter"]
    assert dict(hunter.uptake_of) == {"oxygen": 0.0, "growth_factor": 0.0}
    assert dict(hunter.secretion_of) == {"growth_factor": 0.0}


def test_pairs_adhere_by_their_affinities(project):
    scene = mc.import_physicell(project()).scene
    own = np.sqrt(0.4 * 0.5 * 0.9 * 1.0)
    # the second type takes its affinities from the first one
    for i, j, adhesion in ((0, 0, 0.4), (0, 1, own), (1, 1, 0.9 * 0.5)):
        pair = pair_of(scene, i, j, 8.0, 8.0)
        for d in (6.0, 15.0, 18.0):
            push = 10.0 * max(1.0 - d / 16.0, 0.0) ** 2 - adhesion * (1.0 - d / 20.0) ** 2
            moved = 60.0 * float(pair.force(16.0 - d)) / (6.0 * np.pi * scene.drag.viscosity * 8.0)
            assert moved == pytest.approx(push, rel=1e-12)


def test_a_distance_at_rest_sets_the_adhesion(project):
    changes = ('set_relative_equilibrium_distance enabled="false"',
               'set_relative_equilibrium_distance enabled="true"')  # fmt: skip
    made = mc.import_physicell(project(changes))
    pair = pair_of(made.scene, 0, 0, 8.0, 8.0)
    assert pair.distance() == pytest.approx(1.8 * 8.0, rel=1e-9)
    strength = "cell_definitions/cell_definition[tumour cell]/phenotype/mechanics/"
    assert fates(made)[f"{strength}cell_cell_adhesion_strength"] is Fate.OFF


def test_waiting_times_of_phases_are_those_of_physicell(project):
    scene = mc.import_physicell(project()).scene
    u = np.array([0.02, 0.3, 0.5, 0.9, 0.999])
    phases = scene.growth.phases
    np.testing.assert_allclose(quantile(phases["G1"], u), 60 * expon.ppf(u, scale=300), rtol=1e-9)
    for name, minutes in (("S", 480), ("G2", 240), ("M", 60)):
        np.testing.assert_allclose(quantile(phases[name], u), 60.0 * minutes)
    # the target of volume doubles on entry into S
    assert [phases[p].target_scale for p in ("G1", "S", "G2", "M")] == [0.5, 1.0, 1.0, 1.0]
    assert scene.types["hunter"].cycle_scale * scene.growth.mean_cycle > 1e5 * scene.duration


def test_cells_divide_at_the_volume_that_they_reach_in_physicell(project):
    scene = mc.import_physicell(project()).scene
    # from V0 to 2 V0 in the mean time of cytoplasm, nucleus and water, for 780 min of S, G2 and M
    volume = 4.0 / 3.0 * np.pi * scene.cells.division_radius**3
    assert volume == pytest.approx(2494.0 * (2.0 - np.exp(-780.0 / GROWING)))
    assert scene.growth.law == "relaxation"
    assert scene.growth.parameters["target"] * volume == pytest.approx(2.0 * 2494.0)


def test_two_stages_in_one_phase_are_a_shifted_exponential(project):
    cycle = """<cycle code="0" name="Ki67 (advanced)"><phase_durations units="min">
      <duration index="0" fixed_duration="false">200</duration>
      <duration index="2" fixed_duration="true">150</duration></phase_durations></cycle><old>"""
    path = project(('<cycle code="6" name="Flow cytometry model (separated)">', cycle))
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("</cycle>", "</old>", 2).replace("</old><old>", "</cycle><old>"))
    phase = mc.import_physicell(path).scene.growth.phases
    u = np.array([0.1, 0.5, 0.99])
    expected = 60.0 * (150.0 + expon.ppf(u, scale=200.0))
    np.testing.assert_allclose(quantile(phase["G1"], u), expected, rtol=1e-9)
    assert phase["S"].duration == pytest.approx(13.0 * 3600.0)


def test_live_cells_double_after_division(project):
    path = project(
        (
            '<cycle code="6" name="Flow cytometry model (separated)">',
            '<cycle code="5" name="live">',
        ),
        ('<duration index="1" fixed_duration="true">480</duration>', ""),
        ('<duration index="2" fixed_duration="true">240</duration>', ""),
        ('<duration index="3" fixed_duration="true">60</duration>', ""),
    )
    scene = mc.import_physicell(path).scene
    # the volume from whose half cells come back to it in 300 min, on the way to V0
    volume, target = 4.0 / 3.0 * np.pi * scene.cells.division_radius**3, 2494.0
    rate = 1.0 / GROWING
    back = target - (target - 0.5 * volume) * np.exp(-rate * 300.0)
    assert volume == pytest.approx(back, rel=1e-4)
    assert scene.growth.parameters["target"] * volume == pytest.approx(target)
    assert scene.growth.mean_cycle == pytest.approx(300.0 * 60.0 + 3.0)


def test_motion_has_the_speed_of_its_type(project):
    scene = mc.import_physicell(project()).scene
    radius = (3.0 * 1200.0 / (4.0 * np.pi)) ** (1.0 / 3.0)
    drag = 6.0 * np.pi * scene.drag.viscosity * radius
    assert scene.motility.force == pytest.approx(drag * 2.0 / 60.0)
    assert (scene.motility.bias, scene.motility.towards) == (0.25, "growth_factor")
    assert (scene.motility.persistence, scene.motility.renewal) == (300.0, "random")
    assert [scene.types[name].motility_scale for name in ("tumour_cell", "hunter")] == [0, 1]


RULES = """// the grammar of PhysiCell
tumour cell,oxygen,increases,cycle entry,0.005,21.5,4,0
tumour cell,oxygen,decreases,necrosis,0,3.75,8,0
"""


def test_necrotic_cells_burst_when_they_do_in_physicell(project):
    scene = mc.import_physicell(project(ON, rules=RULES)).scene
    # fluid, solids of cytoplasm and nucleus over the volume at death
    start = [0.75, 0.25 * (2494 - 540) / 2494, 0.25 * 540 / 2494]

    def burst(t, y):
        return sum(y) - 2.0

    burst.terminal = True
    found = solve_ivp(
        lambda t, y: [0.012 * (y[1] + y[2]), -1e-4 * y[1], -2e-3 * y[2]], (0, 1e4), start,
        events=burst, rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    assert scene.death.swelling == 2.0
    assert scene.death.swelling_time == pytest.approx(60.0 * found.t_events[0][0], rel=1e-6)
    assert scene.death.lysis_time == pytest.approx(60.0 / 0.001)
    assert scene.death.apoptosis_rate == pytest.approx(1e-6)


def test_apoptotic_cells_shrink_in_the_mean_time_of_their_parts(project):
    """They are removed when the phase ends, with what is left by then: by quadrature."""
    death = mc.import_physicell(project(ON, rules=RULES)).scene.death
    rates = np.array([0.05, 1.0 / 60.0, 0.35 / 60.0])  # PhysiCell's for parts without an entry
    parts = [0.75, 0.25 * (2494 - 540) / 2494, 0.25 * 540 / 2494]
    gone = solve_ivp(
        lambda t, y: [*(-rates * y[:3]), y[:3].sum()],
        (0, 1e4),
        [*parts, 0.0],
        rtol=1e-9,
        atol=1e-12,
    ).y[-1, -1]
    assert math.exp(-516.0 / gone) < 0.01 == death.removal_fraction
    assert death.apoptosis_time == pytest.approx(60.0 * 516.0 / math.log(100.0))
    slow = (
        'unlysed_fluid_change_rate units="1/min">0.05<',
        'unlysed_fluid_change_rate units="1/min">0.0056<',
    )
    death = mc.import_physicell(project(ON, slow, rules=RULES)).scene.death
    gone += 0.75 * (1.0 / 0.0056 - 1.0 / 0.05)
    assert death.removal_fraction == pytest.approx(math.exp(-516.0 / gone), rel=1e-5)
    assert death.apoptosis_time == pytest.approx(60.0 * gone, rel=1e-5)


def test_chemotaxis_along_a_substance_that_is_not_declared_is_left_out(project):
    made = mc.import_physicell(project(("<substrate>growth factor<", "<substrate>growth<")))
    assert made.scene.motility.bias == 0.0
    assert made.scene.motility.force > 0.0
    entry = next(e for e in made.entries if e.path.endswith("chemotaxis/substrate"))
    assert entry.fate is Fate.LEFT_OUT
    assert "follows no substance of the model" in entry.note


@pytest.mark.parametrize("unit", ["mmHg", "dimensionless"])
def test_oxygen_by_another_name_is_in_mmhg_too(project, unit):
    made = mc.import_physicell(
        project(("oxygen", "O2"), ('name="O2" units="mmHg"', f'name="O2" units="{unit}"'))
    )
    assert made.scene.nutrients["O2"].boundary == pytest.approx(38.0 * MM_HG, rel=1e-3)


def test_a_model_of_no_time_takes_one_step(project):
    made = mc.import_physicell(project((">60</max_time>", ">0</max_time>")))
    assert made.scene.duration == 360.0
    assert fates(made)["overall/max_time"] is Fate.APPROXIMATED


def test_adhesion_above_repulsion_lets_cells_rest_near_each_other(project):
    """PhysiCell's cells fall into one another by it; at 0.99 of it they rest at 0.025 of s."""
    strong = (
        '<cell_adhesion_affinity name="tumour cell">1<',
        '<cell_adhesion_affinity name="tumour cell">40<',
    )
    made = mc.import_physicell(project(strong))
    entry = next(e for e in made.entries if e.path.endswith("affinity[tumour cell]"))
    assert entry.fate is Fate.APPROXIMATED
    assert "0.99 of the repulsion with tumour cell" in entry.note
    pair = pair_of(made.scene, 0, 0, 8.41, 8.41)
    q = math.sqrt(0.99)
    rest = pair.rest * (1.0 - q) / (1.0 - q / 1.25)
    assert pair.force(pair.rest - rest) == pytest.approx(0.0, abs=1e-9)
    other = mc.import_physicell(project()).scene.types["hunter"].surface_energy
    assert made.scene.types["hunter"].surface_energy["hunter"] == other["hunter"]


def test_what_is_not_said_comes_from_the_parent(project):
    heir = ('<cell_definition name="hunter" ID="3">',
            '<cell_definition name="hunter" ID="3" parent_type="tumour cell">')  # fmt: skip
    alone, made = (mc.import_physicell(project(*changes)).scene for changes in ((), (heir,)))
    # PhysiCell: a parent that is named hands on uptake as well, the first type does not
    assert alone.types["hunter"].uptake_of["oxygen"] == 0.0
    assert made.types["hunter"].uptake_of is None
    assert made.types["hunter"].surface_energy == alone.types["hunter"].surface_energy


def test_a_model_without_cells_has_them_at_random(project):
    table = ('positions type="csv" enabled="true"', 'positions type="csv" enabled="false"')
    made = mc.import_physicell(project(table))
    assert len(made.cells["radius_um"]) == 10
    assert fates(made)["user_parameters/number_of_cells"] is Fate.APPROXIMATED
    alone = mc.import_physicell(project(table, (">5</number_of_cells>", ">0</number_of_cells>")))
    assert len(alone.cells["radius_um"]) == 1
    assert fates(alone)["initial_conditions"] is Fate.LEFT_OUT


def test_several_gradients_are_followed_each(project):
    simple = """<chemotaxis>
              <enabled>true</enabled>
              <substrate>growth factor</substrate>
              <direction>1</direction>
            </chemotaxis>"""
    advanced = """<advanced_chemotaxis><enabled>true</enabled>
      <normalize_each_gradient>true</normalize_each_gradient><chemotactic_sensitivities>
      <chemotactic_sensitivity substrate="growth factor">3</chemotactic_sensitivity>
      <chemotactic_sensitivity substrate="oxygen">-1</chemotactic_sensitivity>
      </chemotactic_sensitivities></advanced_chemotaxis>"""
    scene = mc.import_physicell(project((simple, advanced))).scene
    forces = {name: law.force for name, law in scene.chemotaxis.items()}
    whole = scene.motility.force / 0.75
    assert forces["growth_factor"] == pytest.approx(0.25 * 0.75 * whole)
    assert forces["oxygen"] == pytest.approx(-0.25 * 0.25 * whole)


def test_the_account_names_keys_that_scenes_have():
    text = "\n".join(setting[2] for setting in _SETTINGS)
    named = re.findall(r"\b[a-z_]+(?:\.[a-z_*]+)+|^[a-z_]+", text, re.M)
    own = ("responses", "cells.csv", "growth.parameters")  # names of the user's, and a file
    keys = {key for key in named if not key.startswith(own)}
    assert len(keys) > 15
    for key in keys:
        parts = [Scene]
        for name in key.replace(".*", "").split("."):
            found = [specs(part)[name] for part in parts if name in specs(part)]
            assert found, key
            parts = [p for s in found for p in (s.table, *(s.parts or {}).values()) if p]
