"""Linear fields drawn at random: nothing is refused for rounding, and closed forms hold.

python -m pytest tests/nutrient/test_linear_draws.py --runs 2000 --first-seed 1000
"""

import numpy as np
import pytest

import multicell as mc
from multicell.report.explain.scene import explain
from multicell.scene.domain import finer

CASES = [  # length, cross-section, spacing (um), D (um^2/s), decay (1/s): refused once for rounding
    (750.0, 60.0, 5.0, 1000.0, 5.0),
    (1500.0, 60.0, 5.0, 1000.0, 10.0),
    (4000.0, 40.0, 20.0, 300.0, 3.0),
]


def described(
    length, across, spacing, diffusion, decay, level, secretion=0.0, regime="steady", **sides
):
    walls = {"*": {"type": "derivative", "derivative": "0 mM/um"}, **sides}
    walls["x+"] = {"value": f"{level} mM"}
    ends = {"x": length, "y": across, "z": across}
    given = {
        "diffusion": diffusion,
        "decay": decay,
        "spacing": spacing,
        "uptake": 0.0,
        "secretion": secretion,
        "sides": walls,
        "regime": regime,
    }
    return mc.Scene.from_dict(
        {
            "duration": "5 min",
            "coupling_step": "5 min",
            "initial": {"count": 1},
            "drag": {},
            "contact": {"law": "hertz"},
            "nutrients": {"a": given},
            "domain": {axis: [-0.5 * size, 0.5 * size] for axis, size in ends.items()},
        }
    )


def checked(scene, length, across, spacing, diffusion, decay, level):
    """Run a step; hold the field against the line's difference equation where nothing secretes."""
    simulation = mc.Simulation(scene, threads=1)
    simulation.step()
    field = simulation.field_system.fields["a"]
    values, account = field.values, simulation.ledger["a"]
    assert np.isfinite(values).all()
    assert values.min() >= 0.0
    assert simulation.concentrations["a"].min() >= 0.0
    scale = max(account.turnover, account.content)
    assert abs(account.remainder) <= 1e-8 * scale
    nutrient = scene.nutrients["a"]
    if nutrient.secretion == 0.0 and len(nutrient.sides) == 2 and nutrient.regime == "steady":
        n, h = values.shape[0], field.layout.spacing
        mu = np.arccosh(1.0 + 0.5 * decay * h * h / diffusion)
        # cosh(mu (i + 1/2)) / (cosh(mu n) cosh(mu / 2)), with no large numbers
        away = mu * (n - 0.5 - np.arange(n))
        exact = np.exp(-away) * (1.0 + np.exp(-2.0 * (mu * n - away)))
        exact *= level / ((1.0 + np.exp(-2.0 * mu * n)) * np.cosh(0.5 * mu))
        found = values.reshape(n, -1)
        np.testing.assert_allclose(
            found, np.broadcast_to(exact[:, None], found.shape), atol=1e-9 * level
        )
    return simulation


@pytest.mark.parametrize("case", CASES)
def test_a_field_many_decay_lengths_from_its_source_is_not_refused(case):
    checked(described(*case, 10.0), *case, 10.0)


def test_linear_fields_drawn_at_random_are_solved(request):
    first = request.config.getoption("--first-seed")
    for seed in range(first, first + request.config.getoption("--runs")):
        rng = np.random.default_rng([seed, 53])
        spacing = float(rng.choice([5.0, 8.0, 12.5, 20.0]))
        across = spacing * int(rng.integers(max(2, round(30 / spacing)), 2 + round(60 / spacing)))
        across = max(across, 2.0 * spacing, 15.0)
        along = int(np.exp(rng.uniform(np.log(5.0), np.log(200.0))))
        length = max(across, along * spacing)
        diffusion = float(np.exp(rng.uniform(np.log(10.0), np.log(3000.0))))
        decay = 0.0 if rng.random() < 0.2 else float(np.exp(rng.uniform(-10.0, 2.5)))
        level = 0.0 if rng.random() < 0.1 else float(10.0 ** rng.uniform(-6.0, 1.0))
        secretion = 0.0 if rng.random() < 0.6 else float(10.0 ** rng.uniform(-6.0, 2.0))
        regime, sides = "steady" if rng.random() < 0.7 else "transient", {}
        if rng.random() < 0.3:
            sides["y-"] = {"value": f"{level * rng.random()} mM"}
        if rng.random() < 0.2:
            slope = level * 10.0 ** rng.uniform(-6.0, -2.0)
            sides["x-"] = {"type": "derivative", "derivative": f"{slope} mM/um"}
        case = length, across, spacing, diffusion, decay, level
        try:
            checked(described(*case, secretion, regime, **sides), *case)
        except Exception as error:
            error.add_note(f"seed {seed}: {case}, {secretion}, {regime}, {sides}")
            raise


def test_a_grid_much_finer_than_asked_for_is_reported():
    case = 320.0, 65.0, 20.0, 1000.0, 0.5
    scene = described(*case, 1.0)
    assert "5 um instead of 20 um, 64 times as many nodes" in str(explain(scene))
    simulation = mc.Simulation(scene, threads=1)
    _, notes = simulation.field_system.fitness(simulation.cells, 0.0)
    assert any("spacing of 5 um instead of 20 um, 64 times" in note for note in notes)
    assert finer([320.0, 60.0, 60.0], 20.0) == ""
