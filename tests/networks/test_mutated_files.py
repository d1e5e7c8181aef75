"""Documents with parts that are removed, repeated, moved and changed: read, or refused in words."""

import random
import xml.etree.ElementTree as ET

import numpy as np
import pytest

pytest.importorskip("sbmlode")

from sbml_text import document, event, function, reaction

import multicell as mc
from multicell.errors import SceneError
from multicell.networks.sbml import network_from_sbml

pytestmark = [pytest.mark.harness, pytest.mark.filterwarnings("ignore::RuntimeWarning")]

BASE = document(
    species={"A": "2", "B": 'initialAmount="3" hasOnlySubstanceUnits="true"', "C": "1"},
    sizes={"cell": "2"}, parameters={"k": "0.3", "m": "0", "x": "1", "w": "0"},
    functions=function("hill", "s, n", "s^n / (1 + s^n)") + function("half", "s", "hill(s, 1)"),
    initial={"m": "3 * k"}, assigned={"w": "piecewise(half(A), A > 1, m) + rateOf(cell)"},
    rates={"x": "w - x", "cell": "0.01 * cell"},
    reactions=reaction("r", "A 2B", "C", "k * A * w") + reaction("s", "C", "", "hill(C, 2)"),
    events=event("e", "A < 1 && x > 0", {"k": "k / 2", "C": "C + 1"}),
)  # fmt: skip
VALUES = ("NaN", "INF", "-1", "0", "", "A", "k", "1e308", "cell", "true", "none", "r", "e", "3.5")


def mutated(rng):
    """Return the document with one to four changes."""
    root = ET.fromstring(BASE.split("\n", 1)[1])
    for _ in range(rng.randint(1, 4)):
        above = rng.choice([one for one in root.iter() if len(one)] or [root])
        if not len(above):
            break  # nothing is left
        place = rng.randrange(len(above))
        other = rng.choice(list(root.iter()))
        copied = ET.fromstring(ET.tostring(other))
        change = rng.randrange(6)
        if change == 0:
            del above[place]
        elif change == 1:
            above.insert(place, copied)
        elif change == 2:
            above[place] = copied
        elif change == 3 and other.attrib:
            other.set(rng.choice(list(other.attrib)), rng.choice(VALUES))
        elif change == 4 and other.attrib:
            del other.attrib[rng.choice(list(other.attrib))]
        elif other.text:
            other.text = rng.choice(VALUES)
    return ET.tostring(root, encoding="unicode")


def test_the_document_itself_is_read():
    network = network_from_sbml(BASE, "own.xml")
    assert network.states == ("cell", "A", "B", "C", "x")


@pytest.mark.slow
def test_a_changed_document_is_read_or_refused_in_words(request):
    first = request.config.getoption("--first-seed")
    outcomes = set()
    for seed in range(first, first + 20 * request.config.getoption("--draws")):
        text = mutated(random.Random(seed))
        try:
            network = network_from_sbml(text, "own.xml")
        except SceneError as error:
            words = str(error)
        else:
            words = ""
        outcomes.add(words[:7])
        if words:
            continue
        y, u, p = (np.array(part) for part in (network.start, network.defaults, network.values))
        out = np.empty(len(y))
        network.rates(np.float64(1.0), y, u, p, out)
        for one in network.events:
            one.assign(np.float64(1.0), y.copy(), u, p.copy(), y, p)
    assert outcomes == {"own.xml", ""}


def test_a_changed_document_in_a_scene_runs_or_is_refused_in_words(request, tmp_path):
    outcomes, file = set(), tmp_path / "own.xml"
    first = request.config.getoption("--first-seed")
    for seed in range(first, first + request.config.getoption("--draws")):
        text = BASE if seed == first else mutated(random.Random(seed))
        file.write_text(text, encoding="utf-8")
        own = {"file": str(file), "divide": {"B": "share"}, "fluxes": {"oxygen": "uptake: r"}}
        try:
            scene = mc.load_scene("spheroid").with_changes({
                "duration": "20 min", "initial.count": 3, "networks": {"own": own},
                "responses.slow": {"behaviour": "growth rate", "signal": "own.A", "half": 1.0},
            })  # fmt: skip
            simulation = mc.Simulation(scene, threads=1)
            while not simulation.finished:
                simulation.step()
        except mc.MulticellError as error:
            outcomes.add(type(error).__name__)
            assert len(str(error)) < 2000  # noqa: PT017
        else:
            outcomes.add("ran")
            assert np.isfinite(simulation.cells.position).all()
    assert {"ran", "SceneError"} <= outcomes
