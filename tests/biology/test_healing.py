"""Damage that heals, and rates that act in a phase: closed forms."""

import itertools

import numpy as np
import pytest
from scipy import integrate

import multicell as mc
from multicell import Scene, SceneError, Simulation

HOUR = 3600.0


def starving(death, *, count=60, dt="1 h", media=None, **more):
    """Return cells at rest in a field below their threshold."""
    field = {"boundary": 0.01, "uptake": 0.0, "necrosis": 0.02}
    if media:
        field["media"] = media
    return Scene.from_dict(
        {"contact": {"law": "hertz"}, "duration": "40 h", "coupling_step": dt, "seed": 4,
         "output": {"every": "40 h"}, "initial": {"count": count, "spacing": 3.0},
         "nutrients": {"oxygen": field}, "death": {"lysis_time": "100 d", **death}, **more}
    )  # fmt: skip


def death_times(scene):
    times = mc.run(scene, threads=1, report=False).lineage["death_time"] / HOUR
    return np.where(np.isnan(times), np.inf, times)


@pytest.mark.parametrize("dt", ["10 min", "1 h", "7 h"])
def test_two_rates_kill_after_a_known_time(dt):
    """D = k/ρ (1 - exp(-ρ t)) is 1 at t = -ln(1 - ρ/k)/ρ, whatever the step."""
    found = death_times(starving({"damage_time": "6 h", "repair_rate": "0.1 1/h"}, dt=dt))
    np.testing.assert_allclose(found, -np.log(1.0 - 0.6) / 0.1, rtol=1e-9)


def test_who_heals_faster_than_damage_is_done_lives():
    scene = starving({"damage_time": "6 h", "repair_rate": "0.2 1/h"})
    simulation = Simulation(scene, threads=1)
    while simulation.time < scene.duration:
        simulation.step()
    assert not simulation.cells.dead.any()
    expected = (1.0 - np.exp(-0.2 * 40.0)) / (6.0 * 0.2)
    np.testing.assert_allclose(simulation.cells.damage, expected, rtol=1e-12)


def test_damage_and_healing_are_the_solution_of_their_equation():
    """A medium that comes and goes within steps, and tolerances of the cells' own."""
    death = {"damage_time": "8 h", "damage_variation": 0.4, "repair_rate": "0.07 1/h"}
    media = [["3.3 h", 0.2], ["9.05 h", 0.01], ["13 h", 0.2]]
    scene = starving(death, media=media)
    early, simulation = (Simulation(scene, threads=1) for _ in range(2))
    early.step()
    # D after an hour is (1 - exp(-ρ)) / (8 ρ θ)
    tolerance = (1.0 - np.exp(-0.07)) / (0.07 * 8.0 * early.cells.damage)
    while simulation.time < 16.0 * HOUR:
        simulation.step()
    assert (simulation.cells.id == early.cells.id).all()
    compared = 0
    for k in np.flatnonzero(~simulation.cells.dead):

        def rate(t, damage, k=k):
            starved = t < 3.3 or 9.05 <= t < 13.0
            return starved / (8.0 * tolerance[k]) - 0.07 * damage

        ends, damage = (0.0, 3.3, 9.05, 13.0, 16.0), np.zeros(1)
        for begin, end in itertools.pairwise(ends):
            found = integrate.solve_ivp(rate, (begin, end - 1e-12), damage, rtol=1e-10, atol=1e-12)
            damage = found.y[:, -1]
        assert simulation.cells.damage[k] == pytest.approx(damage[0], rel=1e-5)
        compared += 1
    assert compared > 10


def test_without_repair_nothing_changes():
    death = {"damage_time": "6 h", "damage_variation": 0.3}
    usual = death_times(starving(death))
    slow = death_times(starving({**death, "repair_rate": "1e-9 1/h"}))
    np.testing.assert_allclose(slow, usual, rtol=1e-6)


PHASES = {"G1": {"duration": "9 h"}, "S": {"duration": "8 h"}, "G2": {"duration": "4 h"},
          "M": {"duration": "1 h"}}  # fmt: skip
IN_S = {"behaviour": "apoptosis rate", "signal": "phase S", "law": "threshold", "half": 0.5,
        "largest": "0.4 1/h"}  # fmt: skip


def cycling(**changes):
    scene = Scene.from_dict(
        {"duration": "3 h", "coupling_step": "15 min", "seed": 3, "contact": {"law": "hertz"},
         "initial": {"count": 4000, "spacing": 3.0, "stage": "asynchronous"},
         "growth": {"phases": PHASES, "cycle_variation": 0.0}, "death": {"lysis_time": "100 d"},
         "responses": {"kill": IN_S}}
    )  # fmt: skip
    return scene.with_changes(changes)


def killed_in_s(hours, rate=0.4):
    """Return the part of an asynchronous population that a rate in S kills in some hours.

    Ages are distributed as 2 ln 2 / T exp(-ln 2 a / T). A cell of age a is in S from 9 to 17 h for
    a time u, and dies with 1 - exp(-k u); daughters of those that divide are in G1.
    """
    ages = (np.arange(200_000) + 0.5) / 200_000 * 22.0
    weight = np.exp(-np.log(2.0) * ages / 22.0)
    exposed = np.clip(np.minimum(ages + hours, 17.0) - np.maximum(ages, 9.0), 0.0, None)
    return float((weight * (1.0 - np.exp(-rate * exposed))).sum() / weight.sum())


def test_a_drug_that_kills_in_s_kills_an_asynchronous_population_by_its_ages():
    history = mc.run(cycling(), threads=1, report=False).history
    part = killed_in_s(3.0)
    allowed = 4.0 * np.sqrt(part * (1.0 - part) / 4000)
    assert history["apoptotic"][-1] / 4000 == pytest.approx(part, abs=allowed)


def test_a_dose_and_a_phase_together():
    """The least of two rates: the drug kills in S where there is some, and else nobody."""
    drug = {"boundary": 0.01, "uptake": 0.0, "media": [["1 h", 0.0]]}
    dose = {**IN_S, "signal": "drug", "half": "0.005 mM", "combine": "minimum"}
    changes = {"responses.kill.combine": "minimum", "responses.dose": dose,
               "nutrients": {"drug": drug}}  # fmt: skip
    history = mc.run(cycling(**changes), threads=1, report=False).history
    part = killed_in_s(1.0)
    allowed = 4.0 * np.sqrt(part * (1.0 - part) / 4000)
    assert history["apoptotic"][-1] / 4000 == pytest.approx(part, abs=allowed)


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"responses.kill.signal": "phase T"}, "'T' is no phase"),
     ({"growth.phases": None}, "have no phases")],
)  # fmt: skip
def test_phases_that_are_not_there_are_refused(changes, words):
    with pytest.raises(SceneError, match=f"responses.kill.signal.*{words}"):
        cycling(**changes)
