"""ATP from several fields: one may stand in for another, and lack of both kills."""

import numpy as np
import pytest
from running import refused

import multicell as mc
from multicell.biology.growth import growth_factor
from multicell.biology.plan import biology_plan
from multicell.biology.responding import wants_rest
from multicell.biology.states import update_states
from multicell.cells import State
from multicell.nutrient.uptake import uptake
from multicell.report.explain.course import expected_course
from multicell.scene.scene import Scene

FIELDS = {
    "oxygen": {
        "uptake_per_volume": 0.02, "half_saturation": 0.005, "boundary": 0.2,
        "uptake_on": {"glucose": {"effect": 3.0, "half": 0.2}}, "geometry": "radial",
    },
    "glucose": {
        "uptake_per_volume": 0.1, "half_saturation": 0.04, "boundary": 5.5, "geometry": "radial",
    },
}  # fmt: skip
ENERGY = {"yields": {"oxygen": 5.0, "glucose": 2.0}, "necrosis": 0.02, "quiescence": 0.1}


def scene(energy=None, **changes):
    entries = {
        "duration": "1 h", "contact": {"law": "hertz"}, "initial": {"count": 30},
        "growth": {}, "nutrients": FIELDS, "energy": ENERGY if energy is None else energy,
    }  # fmt: skip
    return Scene.from_dict(entries | changes)


def made(oxygen, glucose):
    """Return the ATP made, written out."""
    respired = uptake(0.02 * (1.0 + 3.0 * 0.2 / (0.2 + glucose)), oxygen, 0.005)
    return 5.0 * respired + 2.0 * uptake(0.1, glucose, 0.04)


def concentrations():
    """Return oxygen and glucose from none of both to much of both, (30,)."""
    oxygen, glucose = np.meshgrid([0.0, 1e-4, 1e-3, 0.01, 0.2], [0.0, 0.003, 0.05, 0.8, 16.5, 0.1])
    return {"oxygen": oxygen.ravel(), "glucose": glucose.ravel()}


def test_supply_is_the_sum_of_what_is_made_from_each_uptake():
    described, found = scene(), concentrations()
    supply = described.energy.supply(described.nutrients, found)
    np.testing.assert_allclose(supply, made(**found), rtol=1e-14)
    assert supply[0] == 0.0


def test_states_and_growth_follow_the_supply():
    described = scene({**ENERGY, "growth_half_saturation": 0.05})
    cells, found = mc.Simulation(described).cells, concentrations()
    supply = made(**found)
    states = update_states(biology_plan(described), cells, found)
    np.testing.assert_array_equal(states == State.NECROTIC, supply < 0.02)
    np.testing.assert_array_equal(wants_rest(biology_plan(described), cells, found), supply < 0.1)
    factor = growth_factor(biology_plan(described), found, np.zeros(len(cells)))
    np.testing.assert_allclose(factor, supply / (0.05 + supply), rtol=1e-14)
    assert len(set(states.tolist())) == 3


def test_one_field_stands_in_for_the_other_and_lack_of_both_kills():
    """Thresholds of single fields would kill in all three cases without both."""
    for oxygen, glucose, dead in ((0.2, 0.0, 0), (0.0, 16.5, 0), (0.0, 0.0, 30)):
        fields = {
            "oxygen": {**FIELDS["oxygen"], "boundary": oxygen},
            "glucose": {**FIELDS["glucose"], "boundary": glucose},
        }
        simulation = mc.Simulation(scene(nutrients=fields))
        assert int(np.count_nonzero(simulation.cells.state == State.NECROTIC)) == dead


def test_the_forecast_knows_energy():
    starving = {
        "oxygen": {**FIELDS["oxygen"], "boundary": 1e-4},
        "glucose": {**FIELDS["glucose"], "boundary": 1e-4},
    }
    fed = expected_course(scene(duration="4 d")).cells[-1]
    assert fed > 300
    assert expected_course(scene(duration="4 d", nutrients=starving)).cells[-1] < 1.01 * 30
    free = Scene.from_dict({**scene(duration="4 d").to_dict(), "nutrients": {}, "energy": None})
    assert fed < 1.2 * expected_course(free).cells[-1]


@pytest.mark.parametrize(
    ("energy", "path", "words"),
    [
        ({"necrosis": 0.1}, "energy.yields", "name no field"),
        ({"yields": {"oxygen": 0.0}, "necrosis": 0.1}, "energy.yields", "name no field"),
        ({"yields": {"oxygen": 5.0}}, "energy.necrosis", "no effect"),
        ({**ENERGY, "quiescence": 0.01}, "energy.necrosis", "wrong order"),
        ({**ENERGY, "yields": {"oxigen": 5.0}}, "energy.yields.oxigen", "not a field"),
        ({**ENERGY, "necrosis": "0.02 mM"}, "energy.necrosis", "change of concentration"),
    ],
)
def test_bad_input_is_refused_by_name(energy, path, words):
    with refused(path, words):
        scene(energy)


def test_atp_is_made_of_uptake_per_volume_only():
    fields = {**FIELDS, "oxygen": {"uptake": 20.0}}
    with refused("energy.yields.oxygen", "not of a volume"):
        scene(nutrients=fields)
