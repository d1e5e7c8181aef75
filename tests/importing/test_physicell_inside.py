"""Networks inside cells of PhysiCell: what maps become, and what they do to cells."""

import re

import numpy as np
import pytest

pytest.importorskip("sbmlode")

from physicell_project import MM_HG
from sbml_text import document, event, reaction

import multicell as mc
from multicell.biology.plan import biology_plan
from multicell.biology.responding import rate_of_harm, value_of
from multicell.errors import SceneError
from multicell.importing.imported import Fate

MODEL = document(
    species={"O2": "1", "Fuel": "3"},
    parameters={"dying": "0", "moving": "2", "leaving": "0.01", "giving": "1", "still": "0"},
    reactions=reaction("burn", "O2 Fuel", "", "0.1 * O2 * Fuel"),
    events=event("weak", "Fuel < 1", {"dying": "0.6", "moving": "4"})
    + event("strong", "Fuel > 5", {"leaving": "0.02", "giving": "2"}),
)


def maps(*pairs):
    return "".join(f'<map {what} sbml_species="{species}"/>' for what, species in pairs)


def inside(*pairs, sort="roadrunner", file="./config/model.xml"):
    """Return the change of the settings that puts a network into the tumour's cells."""
    text = (
        f'<intracellular type="{sort}"><sbml_filename>{file}</sbml_filename>'
        f"<intracellular_dt>0.01</intracellular_dt>{maps(*pairs)}</intracellular>"
    )
    old = "</cell_interactions>\n      </phenotype>\n      <custom_data>"
    return old, old.replace("\n      </phenotype>", f"{text}\n      </phenotype>", 1)


@pytest.fixture
def imported(project, tmp_path):
    def make(*pairs, changes=(), model=MODEL, **about):
        path = project(inside(*pairs, **about), *changes)
        path.with_name("model.xml").write_text(model)
        return mc.import_physicell(path)

    return make


def entry(made, value):
    return next(e for e in made.entries if e.value == value)


def test_a_network_and_its_maps_become_a_network_with_inputs_and_responses(imported):
    made = imported(('PC_substrate="oxygen"', "O2"), ('PC_phenotype="da"', "dying"))
    own = made.scene.networks["tumour_cell_network"]
    assert own.inputs == {"O2": "oxygen"}
    assert own.scales["O2"] == pytest.approx(1.0 / MM_HG, rel=1e-3)  # PhysiCell hands over mmHg
    assert (own.cells, own.time_unit, own.dilution) == ("tumour_cell", 60.0, False)
    assert own.model.inputs == ("O2",)
    found = entry(made, "O2")
    assert (found.fate, found.key) == (
        Fate.APPROXIMATED, "networks.tumour_cell_network.inputs.O2"
    )  # fmt: skip
    assert entry(made, "dying: da").key.startswith("responses.apoptosis_rate_of_tumour_cell")
    assert entry(made, "./config/model.xml").fate is Fate.MAPPED


def test_a_type_without_a_model_of_its_own_has_that_of_its_parent(imported):
    made = imported(('PC_phenotype="mms"', "moving"))
    assert sorted(made.scene.networks) == ["hunter_network", "tumour_cell_network"]
    assert len([e for e in made.entries if e.value == "moving: mms"]) == 1


def values(made, behaviour, own, **found):
    """Return a behaviour of the cells of the project at signals, (n,), and their types."""
    cells = mc.Simulation(made.scene).cells
    signals = {name: np.full(len(cells), level) for name, level in found.items()}
    signals |= {"oxygen": np.ones(len(cells)), "growth_factor": np.ones(len(cells))}
    plan = biology_plan(made.scene)
    if behaviour.endswith(" rate"):
        return rate_of_harm(plan, behaviour, signals, cells), cells.kind
    return value_of(plan, behaviour, own, signals, cells), cells.kind


@pytest.mark.parametrize("level", [0.0, 0.15, 0.3, 0.6])
def test_a_rate_of_death_is_the_value_of_its_species_per_minute(imported, level):
    made = imported(('PC_phenotype="da"', "dying"))
    signals = {"tumour_cell_network.dying": level, "hunter_network.dying": 0.0}
    rates, kinds = values(made, "apoptosis rate", 0.0, **signals)
    assert rates[kinds == 0] == pytest.approx(level / 60.0, abs=1e-15)


@pytest.mark.parametrize("level", [0.0, 1.0, 3.0])
def test_a_speed_is_the_value_of_its_species(imported, level):
    made = imported(('PC_phenotype="mms"', "moving"))
    signals = {"hunter_network.moving": level, "tumour_cell_network.moving": 0.0}
    factors, kinds = values(made, "speed", 1.0, **signals)
    # 4 um/min, the most that the network gives, are what the force of the scene gives
    assert factors[kinds == 1] == pytest.approx(level / 4.0)


@pytest.mark.parametrize("level", [0.0, 0.005, 0.02])
def test_a_transition_is_the_value_of_its_species_per_minute(imported, level):
    made = imported(('PC_phenotype="ctr_0_1"', "leaving"))
    signals = {"tumour_cell_network.leaving": level, "hunter_network.leaving": 0.0}
    factors, kinds = values(made, "entry into S", 1.0, **signals)
    length = made.scene.growth.phases["G1"].duration / 60.0
    assert factors[kinds == 0] == pytest.approx(level * length, rel=1e-6)


@pytest.mark.parametrize(
    ("code", "species", "note"),
    [
        ("vff", "moving", "the code 'vff' has no counterpart here: a cell has one volume"),
        ("vtsc", "moving", "a solid part of the cytoplasm"),
        ("vtsn", "moving", "without a nucleus"),
        ("mpt", "moving", "keeps its direction"),
        ("ccdr", "moving", "it is none of PhysiCell's"),
        ("da", "still", "the largest value that it can have is not known"),
        ("ctr_7_8", "leaving", "'exit from cycle phase 7' of this type has no counterpart"),
    ],
)
def test_codes_without_a_counterpart_are_left_out_by_name(imported, code, species, note):
    made = imported((f'PC_phenotype="{code}"', species))
    found = entry(made, f"{species}: {code}")
    assert found.fate is Fate.LEFT_OUT
    assert note in found.note


@pytest.mark.parametrize(
    ("code", "what", "field"),
    [
        ("ssr_growth factor", "secretion", "growth_factor"),
        ("ssd_growth factor", "secretion", "growth_factor"),
        ("ser_growth factor", "secretion", "growth_factor"),
        ("sur_oxygen", "uptake", "oxygen"),
    ],
)
def test_what_a_network_makes_of_fields_is_in_proportion_to_its_species(
    imported, code, what, field
):
    made = imported((f'PC_phenotype="{code}"', "giving"))
    found = entry(made, f"giving: {code}")
    assert found.fate is Fate.APPROXIMATED, found.note
    assert f"{what}_of_{field}" in found.key
    behaviour, shares = f"{what} of {field}", []
    for level in (0.0, 1.0, 2.0):
        signals = {f"{kind}_network.giving": level for kind in ("tumour_cell", "hunter")}
        factors, kinds = values(made, behaviour, 1.0, **signals)
        shares.append(factors[kinds == 0].max())
    assert shares[2] > shares[1] > shares[0] - 1e-12
    if what == "uptake":
        assert "second substance" in found.note
        assert shares[1] - shares[0] == pytest.approx(shares[2] - shares[1])
    simulation = mc.Simulation(made.scene.with_changes({"duration": "10 min"}), threads=1)
    while not simulation.finished:
        simulation.step()
    assert np.isfinite(simulation.concentrations[field]).all()


@pytest.mark.parametrize(
    ("sort", "name"),
    [("maboss", r"a Boolean network \(MaBoSS\)"), ("dfba", "flux balance"), ("x", "the type 'x'")],
)
def test_models_of_other_kinds_are_left_out_by_name(imported, sort, name):
    made = imported(sort=sort)
    assert not made.scene.networks
    found = entry(made, "./config/model.xml")
    assert found.fate is Fate.LEFT_OUT
    assert re.search(name, found.note)


@pytest.mark.parametrize(
    ("pairs", "about", "problem"),
    [
        ([('PC_phenotype="da"', "none")], {}, "maps 'none', which the network does not have"),
        ([('PC_substrate="gold"', "O2")], {}, "is of 'gold', which is no substance"),
        ([('PC_substrate="oxygen"', "None")], {}, "has no 'None' that could be an input"),
        ([], {"file": "./config/none.xml"}, "there is no such file"),
        ([], {"file": "/etc/passwd"}, "there is no such file"),
        ([], {"model": "<html/>"}, "is no SBML"),
    ],
)
def test_what_does_not_fit_is_refused_with_its_place(imported, pairs, about, problem):
    with pytest.raises(SceneError, match=problem) as caught:
        imported(*pairs, **about)
    assert caught.value.path.startswith("settings.xml, line ")


def test_a_written_import_has_its_network_beside_it(imported, tmp_path):
    made = imported(('PC_substrate="oxygen"', "O2"), ('PC_phenotype="da"', "dying"))
    paths = made.write(tmp_path / "out")
    assert [path.name for path in paths[3:]] == ["tumour_cell_network.xml", "hunter_network.xml"]
    again = mc.load_scene(tmp_path / "out" / "scene.toml")
    own = again.networks["tumour_cell_network"]
    assert own.file == str(tmp_path / "out" / "tumour_cell_network.xml")
    assert own.model.source == made.scene.networks["tumour_cell_network"].model.source
    with pytest.raises(mc.OutputError, match="exists already"):
        made.write(tmp_path / "out")
