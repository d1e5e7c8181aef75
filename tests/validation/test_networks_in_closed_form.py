"""Networks in cells whose course is known."""

import math

import pytest

import multicell as mc

SUBJECT, SOURCE = "networks", "closed form"


def test_a_switched_medium_is_followed_as_an_exponential(compare):
    # HIF is made at a constant rate and lost at one that oxygen raises
    made, slow, fast = 2e-4, 1e-4, 2e-2

    @mc.network(states={"HIF": 0.0}, inputs={"oxygen": 0.0}, amounts=("HIF",))
    def hif(t, y, u, p, out):
        out[0] = 2e-4 - (1e-4 + 2e-2 * u[0]) * y[0]

    part = {"network": hif, "inputs": {"oxygen": "oxygen"}, "start": "steady", "tolerance": 1e-8}
    scene = mc.load_scene("growth").with_changes({
        "duration": "4 h", "initial.count": 1, "growth": None, "coupling_step": "7 min",
        "networks": {"hif": part},
        "nutrients": {"oxygen": {"boundary": 0.2, "uptake": 0.0, "spacing": 20.0,
                                 "media": [["1 h", 0.01]]}},
    })  # fmt: skip
    simulation = mc.Simulation(scene, threads=1)
    normal, low = slow + fast * 0.2, slow + fast * 0.01
    assert simulation.cells.inside[0, 0] == pytest.approx(made / normal, rel=1e-3)
    off = 0.0
    while not simulation.finished:
        simulation.step()
        since = max(0.0, simulation.time - 3600.0)
        want = made / low + (made / normal - made / low) * math.exp(-low * since)
        off = max(off, abs(simulation.cells.inside[0, 0] / want - 1.0))
    what = "HIF after oxygen falls from 20 to 1 %, relative"
    compare.deviation(what, "an exponential in time", off, 2e-3)
