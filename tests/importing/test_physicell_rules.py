"""Rules of PhysiCell and what types do: values in a run beside PhysiCell's published formulas."""

import itertools

import numpy as np
import pytest
from physicell_project import MM_HG, ON

import multicell as mc
from multicell.behaviours.catalogue import FULL_CROWDING
from multicell.biology.plan import biology_plan
from multicell.biology.responding import other_signals, rate_of_harm, value_of
from multicell.cells import contact_rows
from multicell.importing.imported import Fate


def hill(base, up=(), down=()):
    """Return PhysiCell's value: (end, half, power, signal) of rules that raise it, and lower it."""

    def share(parts):
        total = sum((s / half) ** power for _, half, power, s in parts)
        return total / (1.0 + total)

    top = max([base, *(part[0] for part in up)])
    least = min([base, *(part[0] for part in down)])
    raised = base + (top - base) * share(up)
    return raised + (least - raised) * share(down)


def imported(project, *rows, changes=(), version="3.0"):
    rules = "".join(f"{row}\n" for row in rows)
    said = ('version="3.0"', f'version="{version}"')
    return mc.import_physicell(project(ON, said, *changes, rules=rules))


def fate(made, line):
    return next(e for e in made.entries if e.path == f"rules.csv, line {line}")


OXYGEN = np.array([2.0, 20.0, 38.0, 10.0])
FACTOR = np.array([0.1, 0.0, 0.3, 0.2])


def values(made, behaviour, own, **others):
    """Return a behaviour of the four cells of the project: three of the tumour, then a hunter."""
    cells = mc.Simulation(made.scene).cells
    # a run has its own order of cells
    x, y = (made.cells[f"position_{axis}_um"] for axis in "xy")
    row = [
        int(np.argmin(np.hypot(*(cells.position[:, :2] - at).T))) for at in zip(x, y, strict=True)
    ]
    found = {}
    for name, level in {"oxygen": OXYGEN * MM_HG, "growth_factor": FACTOR, **others}.items():
        found[name] = np.empty(4)
        found[name][row] = level
    plan = biology_plan(made.scene)
    if behaviour == "necrosis rate":
        return rate_of_harm(plan, "necrosis rate", found, cells)[row]
    return value_of(plan, behaviour, own, found, cells)[row]


def test_death_rates_of_each_type(project):
    made = imported(
        project,
        "tumour cell,oxygen,decreases,necrosis,0,3.75,8,0",
        "tumour cell,growth factor,increases,apoptosis,0.01,0.2,4,0",
        "tumour cell,oxygen,decreases,apoptosis,1e-6,15,2,0",
        "hunter,oxygen,increases,apoptosis,0.5,9,40,0",
    )
    expected = [hill(0.003, down=[(0.0, 3.75, 8, o)]) / 60 for o in OXYGEN[:3]]
    expected.append(0.003 / 60)  # the hunter dies as its parent does
    found = values(made, "necrosis rate", 0.0)
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-18)
    expected = [
        hill(6e-5, up=[(0.01, 0.2, 4, f)], down=[(1e-6, 15.0, 2, o)]) / 60
        for o, f in zip(OXYGEN[:3], FACTOR[:3], strict=True)
    ] + [hill(6e-5, up=[(0.5, 9.0, 32, OXYGEN[3])]) / 60]
    own = made.scene.death.apoptosis_rate
    np.testing.assert_allclose(values(made, "apoptosis rate", own), expected, rtol=3e-3)
    assert [fate(made, n).fate for n in (1, 2, 3)] == [Fate.MAPPED] * 3
    assert "power 32" in fate(made, 4).note


def test_necrosis_at_the_rate_of_the_settings_without_rules(project):
    made = mc.import_physicell(project())
    np.testing.assert_allclose(values(made, "necrosis rate", 0.0), [5e-5] * 4, rtol=1e-9)


def test_exit_from_phases(project):
    made = imported(
        project,
        "tumour cell,oxygen,increases,cycle entry,0.02,21.5,4,0",
        "tumour cell,pressure,decreases,cycle entry,0,1,3,0",
        "tumour cell,volume,increases,exit from cycle phase 1,0.01,2400,2,0",
        "hunter,oxygen,increases,exit from cycle phase 0,0.004,12,2,0",
        "hunter,oxygen,increases,exit from cycle phase 1,0.004,12,2,0",
    )
    crowding = np.array([0.5, 1.0, 2.0, 0.0])
    pace = values(made, "entry into S", 1.0, crowding=crowding)
    phases, types = made.scene.growth.phases, made.scene.types
    scale = np.array([types["tumour_cell"].cycle_scale] * 3 + [types["hunter"].cycle_scale])
    rates = pace / (phases["G1"].duration / 60.0 * scale)
    expected = [
        hill(1 / 300, up=[(0.02, 21.5, 4, o)], down=[(0.0, 1.0, 3, p)])
        for o, p in zip(OXYGEN[:3], crowding[:3], strict=True)
    ] + [hill(0.0, up=[(0.004, 12.0, 2, OXYGEN[3])])]
    np.testing.assert_allclose(rates, expected, rtol=2e-3)
    # S takes 480 min; cells are 2494 um³
    pace = values(made, "entry into G2", 1.0)
    expected = hill(1 / 480, up=[(0.01, 2400.0, 2, 2494.0)])
    np.testing.assert_allclose(pace[:3] / 480.0, [expected] * 3, rtol=1e-9)
    assert [fate(made, n).fate for n in (1, 2, 4)] == [Fate.MAPPED] * 3
    assert fate(made, 3).fate is Fate.APPROXIMATED
    assert "of this type has no counterpart" in fate(made, 5).note


def test_a_type_with_phases_of_its_own(project):
    other = '<rate start_index="0" end_index="0" fixed_duration="false">0</rate>'
    changes = (other, other.replace(">0<", ">0.002<"))
    made = imported(project, changes=[changes])
    phases, hunter = made.scene.growth.phases, made.scene.types["hunter"]
    own = [values(made, f"entry into {after}", 1.0) for after in ("S", "G2", "M", "G1")]
    lasts = [
        phases[name].duration * hunter.cycle_scale / pace[3]
        for name, pace in zip(("G1", "S", "G2", "M"), own, strict=True)
    ]
    assert lasts[0] == pytest.approx(500.0 * 60.0, rel=1e-6)
    assert max(lasts[1:]) < 30.0


def test_motion(project):
    made = imported(
        project,
        "hunter,oxygen,decreases,migration speed,0.5,15,3,0",
        "hunter,growth factor,increases,migration speed,6,0.1,2,0",
        "hunter,oxygen,increases,migration bias,1,8,2,0",
        "hunter,oxygen,increases,migration persistence time,1,8,2,0",
    )
    scene = made.scene
    radius = (3.0 * 1200.0 / (4.0 * np.pi)) ** (1.0 / 3.0)
    drag = 6.0 * np.pi * scene.drag.viscosity * radius
    share = values(made, "speed", 1.0)[3] * scene.types["hunter"].motility_scale
    speed = hill(2.0, up=[(6.0, 0.1, 2, 0.2)], down=[(0.5, 15.0, 3, 10.0)])
    assert share * scene.motility.force / drag * 60.0 == pytest.approx(speed, rel=2e-3)
    bias = values(made, "bias", scene.motility.bias)[3]
    assert bias == pytest.approx(hill(0.25, up=[(1.0, 8.0, 2, 10.0)]), rel=2e-3)
    assert fate(made, 4).fate is Fate.LEFT_OUT
    assert "persistence" in fate(made, 4).note


def test_exchange_with_fields(project):
    made = imported(
        project,
        "tumour cell,growth factor,decreases,oxygen uptake,2,0.2,2,0",
        "tumour cell,volume,increases,growth factor secretion,5,2000,3,0",
        "tumour cell,oxygen,increases,oxygen uptake,20,5,2,0",
        "tumour cell,oxygen,increases,growth factor export,3,5,2,0",
        "tumour cell,apoptotic,increases,growth factor secretion,3,0.5,10,1",
    )
    oxygen, factor = made.scene.nutrients["oxygen"], made.scene.nutrients["growth_factor"]
    own = made.scene.types["tumour_cell"].uptake_of or {}
    uptake = oxygen.uptake_per_volume / oxygen.half_saturation * 60.0 * own.get("oxygen", 1.0)
    expected = [hill(10.0, down=[(2.0, 0.2, 2, f)]) for f in FACTOR[:3]]
    np.testing.assert_allclose(values(made, "uptake of oxygen", 1.0)[:3] * uptake, expected)
    # S (T - c) V: S T V given off, S V c taken up
    rate = hill(2.0, up=[(5.0, 2000.0, 3, 2494.0)])
    given = factor.secretion * 60.0 * values(made, "secretion of growth_factor", 1.0)[0]
    assert given == pytest.approx(rate * 0.5 * 2494.0)
    taken = factor.uptake_per_volume / factor.half_saturation * 60.0
    assert taken * values(made, "uptake of growth_factor", 1.0)[0] == pytest.approx(rate)
    assert [fate(made, n).fate for n in (1, 2)] == [Fate.MAPPED] * 2
    # a field cannot respond to itself, nor two to each other
    assert "do not depend on them" in fate(made, 3).note
    assert "do not depend on them" in fate(made, 4).note
    assert fate(made, 5).note == "the signal 'apoptotic' has no counterpart here"


def test_becoming_another_type(project):
    changes = (
        "<cell_interactions>\n          <attack_damage_rate",
        '<cell_transformations><transformation_rates><transformation_rate name="hunter">0.001'
        "</transformation_rate></transformation_rates></cell_transformations><cell_interactions>"
        "\n          <attack_damage_rate",
    )
    path = project(ON, rules="tumour cell,contact with hunter,increases,transition to hunter,"
                             "0.1,2,3,0\n")  # fmt: skip
    text = path.read_text(encoding="utf-8").replace(*changes, 1)
    path.write_text(text, encoding="utf-8")
    made = mc.import_physicell(path)
    count = np.array([0.0, 2.0, 5.0, 1.0])
    found = values(made, "change to hunter", 0.0, **{"contacts with hunter": count})
    expected = [hill(0.001, up=[(0.1, 2.0, 3, n)]) / 60 for n in count[:3]]
    np.testing.assert_allclose(found, [*expected, 0.0])
    entry = fate(made, 1)
    assert (entry.fate, "range of adhesion" in entry.note) == (Fate.APPROXIMATED, True)


def test_chances_of_daughters(project):
    cycle = "</cycle>\n        <death>"
    division = (
        '<standard_asymmetric_division enabled="true"><asymmetric_division_probability '
        'name="hunter">0.3</asymmetric_division_probability></standard_asymmetric_division>'
    )
    rule = "tumour cell,time,increases,asymmetric division to hunter,0.9,60,2,0"
    made = imported(project, rule, changes=[(cycle, division + cycle)])
    found = values(made, "asymmetric division to hunter", 0.0, time=np.full(4, 7200.0))
    expected = hill(0.3, up=[(0.9, 60.0, 2, 120.0)])
    np.testing.assert_allclose(found, [*[expected] * 3, 0.0])


def test_repulsion(project):
    made = imported(project, "hunter,oxygen,increases,cell-cell repulsion,40,12,2,0")
    found = values(made, "Young's modulus", 1.0)
    expected = hill(10.0, up=[(40.0, 12.0, 2, 10.0)]) / 10.0
    np.testing.assert_allclose(found, [1.0, 1.0, 1.0, expected], rtol=2e-3)


def test_adhesion(project):
    made = imported(project, "hunter,oxygen,decreases,cell-cell adhesion,0.1,12,2,0")
    found = values(made, "surface energy", 1.0)
    expected = hill(0.9, down=[(0.1, 12.0, 2, 10.0)]) / 0.9
    np.testing.assert_allclose(found, [1.0, 1.0, 1.0, expected], rtol=2e-3)
    assert 0.3 < expected < 0.9


def test_crowding_is_the_simple_pressure_of_physicell(project):
    assert pytest.approx(12.0 * (1.0 - (np.pi / (2.0 * 3.0**0.5)) ** 0.5) ** 2) == FULL_CROWDING
    cells = "".join(f"{x},{y},0,0\n" for x, y in itertools.product((0, 13), (0, 14)))
    made = mc.import_physicell(
        project(ON, rules="tumour cell,pressure,decreases,cycle entry,0,1,4,0\n", cells=cells)
    )
    sim = mc.Simulation(made.scene)
    found = other_signals(sim.plan, sim.cells, sim.contacts, 0.0)["crowding"]
    assert len(contact_rows(sim.cells, sim.contacts)) >= 4
    place, radius = sim.cells.position, sim.cells.radius
    for i in range(4):
        total = sum(
            max(1.0 - np.linalg.norm(place[i] - place[j]) / (radius[i] + radius[j]), 0.0) ** 2
            for j in range(4)
            if j != i
        )
        assert found[i] == pytest.approx(total / 0.027288820670331)


@pytest.mark.parametrize(
    ("version", "row"),
    [
        ("1.0", "tumour cell,oxygen,decreases,apoptosis,6e-5,1e-6,15,2,0"),
        ("2.0", "tumour cell,oxygen,decreases,apoptosis,1e-6,15,2,0"),
        ("3.0", "tumour cell,oxygen,decreases,apoptosis,1e-6,15,2,0"),
        ("3.0", "tumour cell\toxygen\tdecreases\tapoptosis\t1e-6\t15\t2\t0"),
        ("", "tumour cell,oxygen,decreases,apoptosis,6e-5,1e-6,15,2,0"),
    ],
)
def test_versions_of_the_grammar(project, version, row):
    made = imported(project, row, version=version)
    found = values(made, "apoptosis rate", made.scene.death.apoptosis_rate)
    expected = [hill(6e-5, down=[(1e-6, 15.0, 2, o)]) / 60 for o in OXYGEN[:3]]
    np.testing.assert_allclose(found[:3], expected, rtol=2e-3)


@pytest.mark.parametrize(
    ("row", "fated", "said"),
    [
        ("tumour cell,oxygen,decreases,apoptosis,1,15,2", Fate.OFF, "7 columns, not 8"),
        ("tumour cell,,decreases,apoptosis,1,15,2,0", Fate.OFF, "PhysiCell skips it"),
        ("nobody,oxygen,decreases,apoptosis,1,15,2,0", Fate.OFF, "type that there is not"),
        ("tumour cell,oxygen,decreases,apoptosis,6e-5,15,2,0", Fate.OFF, "the type's own value"),
        ("tumour cell,oxygen,decreases,apoptosis,1,0,2,0", Fate.LEFT_OUT, "no signal, or a power"),
        ("tumour cell,oxgen,decreases,apoptosis,1,1,2,0", Fate.LEFT_OUT, "signal 'oxgen' has no"),
        ("tumour cell,oxygen,increases,attack hunter,1,1,2,0", Fate.LEFT_OUT, "'attack hunter' of"),
        ("tumour cell,oxygen,increases,migration speed,1,1,2,0", Fate.LEFT_OUT, "of this type has"),
        ("tumour cell,oxygen,increases,apoptosis,9e9,1,2,1", Fate.APPROXIMATED, "at most 1 1/s"),
    ],
)
def test_rules_without_counterpart_are_named_by_line(project, row, fated, said):
    entry = fate(imported(project, "// first line", row), 2)
    assert entry.fate is fated
    assert said in entry.note


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("tumour cell,oxygen,decreases,apoptosis,x,15,2,0", "rules.csv, line 2.*is none"),
        ("tumour cell,oxygen,decreases,apoptosis,inf,15,2,0", "line 2.*not finite"),
        ("tumour cell,oxygen,alters,apoptosis,1,15,2,0", "line 2.*must be 'increases' or"),
    ],
)
def test_wrong_rows_are_refused_with_their_line(project, row, said):
    with pytest.raises(mc.SceneError, match=said):
        imported(project, "//", row)


@pytest.mark.parametrize(
    "said",
    ['version="3.0" format="xml" enabled="true"', 'version="0.5" format="csv" enabled="true"'],
)
def test_rules_in_other_formats_are_left_out(project, said):
    made = mc.import_physicell(project(('version="3.0" format="csv" enabled="false"', said)))
    left = [entry.note for entry in made.of("left out") if "ruleset" in entry.path]
    assert left == ["rules are read from tables (CSV) of versions 1, 2 and 3 only"] * 2


def test_a_model_with_rules_runs(project):
    made = imported(
        project,
        "tumour cell,oxygen,increases,cycle entry,0.02,21.5,4,0",
        "tumour cell,pressure,decreases,cycle entry,0,1,3,0",
        "tumour cell,growth factor,decreases,oxygen uptake,2,0.2,2,0",
        "hunter,contact with tumour cell,decreases,migration speed,0.01,0.1,10,0",
        "hunter,oxygen,increases,apoptosis,50,2,4,0",
        "tumour cell,time,increases,transform to hunter,50,20,8,0",
        changes=[("<dx>20</dx><dy>20</dy><dz>20</dz>", "<dx>40</dx><dy>40</dy><dz>40</dz>")],
    )
    result = mc.run(made.scene.with_changes({"duration": "40 min"}), report=False)
    last = result.frames[-1].cells
    # the hunter dies at once; half an hour later cells of the tumour become hunters and die
    assert last.dead.all()
    assert set(last.kind.tolist()) == {1}


def test_types_have_own_rates_in_the_written_scene(project, tmp_path):
    death = '<volume><total units="micron^3">1200</total>'
    own = '<death><model code="100" name="apoptosis"><death_rate>3e-4</death_rate></model></death>'
    made = mc.import_physicell(project((death, own + death)))
    made.write(tmp_path / "out")
    scene = mc.load_scene(tmp_path / "out" / "scene.toml")
    assert scene.death.apoptosis_rate == pytest.approx(1e-6)
    assert scene.responses["apoptosis_rate_of_hunter"].largest == pytest.approx(5e-6)
