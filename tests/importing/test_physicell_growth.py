"""Growth and the cycle of imported cells: PhysiCell's rates, its first phase, and what is Ki67+."""

import re

import numpy as np
import pytest
from running import finished
from scipy.integrate import solve_ivp
from scipy.stats import gamma

import multicell as mc
from multicell.behaviours.growth_laws.laws import RelaxationGrowth
from multicell.biology.draws import quantile
from multicell.importing.imported import Fate
from multicell.simulation import Simulation

RATES = {"cytoplasm": 0.005, "nucleus": 0.0055, "water": 0.05}  # 1/min, of the settings
NUCLEUS, FLUID = 540.0 / 2494.0, 0.75  # shares of the settings
VOLUME = 2494.0
STEP = 6.0  # min, the coupling step
LIVE = """<cycle code="5" name="live"><phase_transition_rates units="1/min">
<rate start_index="0" end_index="0" fixed_duration="false">0.00072</rate>
</phase_transition_rates></cycle>"""
FLOW = """<cycle code="2" name="flow cytometry (basic)"><phase_transition_rates units="1/min">
<rate start_index="0" end_index="1" fixed_duration="false">0.00324</rate>
<rate start_index="1" end_index="2" fixed_duration="false">0.00208</rate>
<rate start_index="2" end_index="0" fixed_duration="false">0.00333</rate>
</phase_transition_rates></cycle>"""
KI67 = {
    "basic": """<cycle code="1" name="Ki67 (basic)"><phase_durations units="min">
<duration index="0" fixed_duration="false">275.4</duration>
<duration index="1" fixed_duration="true">930</duration></phase_durations></cycle>""",
    "advanced": """<cycle code="0" name="Ki67 (advanced)"><phase_durations units="min">
<duration index="0" fixed_duration="false">217.2</duration>
<duration index="1" fixed_duration="true">780</duration>
<duration index="2" fixed_duration="true">150</duration></phase_durations></cycle>""",
}
ALONE = ("<death>", '<unread enabled="false">'), ("</death>", "</unread>")


def whole_rate(cytoplasm, nucleus, water):
    """Return 1 over the mean time in which PhysiCell's volume follows a target that doubles.

    By quadrature of its equations: solids go to their targets, water after the volume.
    """
    solid = (1.0 - FLUID) * np.array([1.0 - NUCLEUS, NUCLEUS])

    def slope(t, y):
        fluid, *now, _ = y
        return [
            water * (FLUID * (fluid + sum(now)) - fluid),
            cytoplasm * (2 * solid[0] - now[0]),
            nucleus * (2 * solid[1] - now[1]),
            2.0 - fluid - sum(now),
        ]

    return 1.0 / solve_ivp(slope, (0.0, 2e4), [FLUID, *solid, 0.0], "LSODA", rtol=1e-9).y[-1, -1]


RATE = whole_rate(**RATES)


def imported(project, cycle, hours, side=7, rules=None, *changes):
    """Return the import of one type with a cycle, on a grid of ``side`` times ``side`` cells."""
    step = 30.0
    places = (step * (np.indices((side, side)).reshape(2, -1).T - (side - 1) / 2)).tolist()
    wide = [(f"<{a}_m{b}>{c}<", f"<{a}_m{b}>{d}<") for a, b, c, d in (
        ("x", "in", -100, -500), ("x", "ax", 100, 500), ("y", "in", -80, -500),
        ("y", "ax", 80, 500), ("z", "in", -60, -10), ("z", "ax", 60, 10))]  # fmt: skip
    on = [('format="csv" enabled="false"', 'format="csv" enabled="true"')] if rules else []
    path = project(
        *wide, *on, *ALONE, *changes,
        ("<use_2D>false", "<use_2D>true"), (">60</max_time>", f">{60 * hours}</max_time>"),
        cells="".join(f"{x},{y},0,0\n" for x, y in places), rules=rules,
    )  # fmt: skip
    text = path.read_text("utf-8")
    text = re.sub(r'<cycle code="6".*?</cycle>', cycle, text, flags=re.DOTALL)
    text = re.sub(r'<cell_definition name="hunter".*?</cell_definition>', "", text, flags=re.DOTALL)
    for part in ("cell_adhesion_affinities", "cell_interactions", "secretion"):
        text = re.sub(rf"<{part}>.*?</{part}>", "", text, flags=re.DOTALL)
    text = re.sub(r'<variable name="growth factor".*?</variable>', "", text, flags=re.DOTALL)
    path.write_text(text, "utf-8")
    return mc.import_physicell(path)


def quick(made, **changes):
    """Return the scene without what does not matter to growth."""
    return made.scene.with_changes({"nutrients": None, "integrator": "euler", **changes})


@pytest.mark.parametrize("cycle", [LIVE, FLOW, *KI67.values()])
def test_all_cells_grow_at_the_rate_of_the_settings(project, cycle):
    """V' = r (K - V), r of the whole cell, whatever the phases that a cell has drawn last.

    K is the volume of the settings, and twice that from S to division.
    """
    run = Simulation(quick(imported(project, cycle, 30)), threads=1)
    seen = []
    while not run.finished:
        before = run.cells
        run.step()
        same = run.cells.rows_of(before.id)
        stayed = (same >= 0) & (run.cells.phase[same] == before.phase)
        after = run.cells.take(same[stayed])
        first = before.take(np.flatnonzero(stayed))
        doubled = (first.phase > 1) & (cycle is not LIVE)
        largest = VOLUME * (1.0 + doubled)
        gap = largest - first.volume, largest - after.volume
        open_ = np.abs(gap[0]) > 0.01 * VOLUME
        seen.append(np.log(gap[0][open_] / gap[1][open_]) / STEP)
    rates = np.concatenate(seen)
    assert len(rates) > 3000
    np.testing.assert_allclose(rates, RATE, rtol=1e-6)


def test_the_account_states_the_rate(project):
    made = imported(project, FLOW, 1)
    for part in ("cytoplasmic_biomass_change_rate", "fluid_change_rate", "nuclear"):
        entry = next(e for e in made.entries if e.path.endswith(f"volume/{part}"))
        assert entry.fate is Fate.APPROXIMATED
        assert "growth.volume_doubling_time" in entry.key


@pytest.mark.parametrize(
    ("part", "old", "new"),
    [("nucleus", 0.0055, 0.001), ("water", 0.05, 0.004), ("cytoplasm", 0.005, 0.02)],
)
def test_each_part_of_a_cell_slows_its_growth(project, part, old, new):
    tag = {"nucleus": "nuclear_biomass", "water": "fluid", "cytoplasm": "cytoplasmic_biomass"}[part]
    change = f'{tag}_change_rate units="1/min">'
    growth = imported(
        project, LIVE, 1, 2, None, (change + str(old), change + str(new))
    ).scene.growth
    law = RelaxationGrowth(**growth.parameters)
    rate = 60.0 * law.exponent / growth.volume_doubling_time
    assert rate == pytest.approx(whole_rate(**{**RATES, part: new}), rel=1e-5)


def test_cells_whose_cytoplasm_or_water_stays_do_not_grow(project):
    for tag, rate in (("cytoplasmic_biomass", 0.005), ("fluid", 0.05)):
        change = f'<{tag}_change_rate units="1/min">'
        made = imported(project, LIVE, 1, 2, None, (change + str(rate), change + "0"))
        assert made.scene.growth.volume_doubling_time > 1e9


class Parts:
    """PhysiCell's volumes, a second program: solids go to their targets, water to its part of all.

    Columns of ``now``, µm³: solids of the nucleus and of the cytoplasm, and water.
    """

    FLUID, NUCLEUS = 0.75, 540.0
    RATES = np.array([0.0055, 0.0045, 0.05])  # 1/min

    def __init__(self, count, start=1.0):
        solid = (1.0 - self.FLUID) * np.array([self.NUCLEUS, VOLUME - self.NUCLEUS])
        self.targets = solid
        self.now = start * np.tile([*solid, self.FLUID * VOLUME], (count, 1))

    @property
    def volume(self):
        return self.now.sum(axis=1)

    def grow(self, step):
        water = self.FLUID * self.volume
        for k, target in enumerate((*self.targets, water)):
            self.now[:, k] += step * self.RATES[k] * (target - self.now[:, k])

    def divide(self, which):
        halves = np.repeat(0.5 * self.now[which], 2, axis=0)
        self.now = np.concatenate([self.now[~which], halves])


def chance_of(volume, least, most, half, power):
    odds = (volume / half) ** power
    return least + (most - least) * odds / (1.0 + odds)


def numbers_by_volume(seed, hours, count, rule, step=0.1):
    """Return how many cells there are under a rule by which their volume lets them divide."""
    rng, cells = np.random.default_rng(seed), Parts(count)
    for _ in range(round(hours * 60 / step)):
        cells.grow(step)
        chance = chance_of(cells.volume, *rule)
        cells.divide(rng.random(len(chance)) < -np.expm1(-chance * step))
    return len(cells.now)


def time_between(cells, grow, rule, step=0.05):
    """Return the time between divisions, min, of a cell that divides as soon as it is due."""
    times, due, t = [], 0.0, 0.0
    while len(times) < 12:
        grow(cells, step)
        due, t = due + step * float(chance_of(cells.volume, *rule)[0]), t + step
        if due >= 1.0:
            cells.now *= 0.5
            due, times = 0.0, [*times, t]
    return np.diff(times)[-1]


@pytest.mark.sample("rule0")
@pytest.mark.parametrize("rule", [
    (0.0, 0.17, 1200.0, 8), (0.00072, 0.05, 2400.0, 8), (0.0, 0.02, 2000.0, 4),
])  # fmt: skip
def test_one_rate_divides_as_often_as_solids_with_water(project, rule):
    text = f"tumour cell,volume,increases,cycle entry,{rule[1]},{rule[2]},{rule[3]},0\n"
    own = [('change_rate units="1/min">0.005<', 'change_rate units="1/min">0.0045<')]
    slow = LIVE.replace("0.00072", str(rule[0]))
    made = imported(project, slow, 1, 2, text, *own)
    law = mc.Scene.from_dict(made.scene.to_dict()).growth
    # V' = r (K - V) with K the volume of the settings: its half is gained in ln 2 / r
    target = law.parameters["target"]
    rate = np.log((target - 0.5) / (target - 1.0)) / law.volume_doubling_time * 60.0

    def relax(cells, step):
        cells.now += (1.0 - np.exp(-rate * step)) * (
            VOLUME * np.array([[0.0, 0.0, 1.0]]) - cells.now
        )

    one, theirs = Parts(1, 0.6), time_between(Parts(1, 0.6), Parts.grow, rule)
    assert time_between(one, relax, rule) == pytest.approx(theirs, rel=2e-3)
    path = "volume/cytoplasmic_biomass_change_rate"
    entry = next(e for e in made.entries if e.path.endswith(path))
    assert f"{rate:.4g} for " in entry.note
    assert 0.5 * 0.0045 < rate < 0.9 * 0.0045


@pytest.mark.slow
def test_a_rule_about_volume_lets_cells_divide_when_they_have_grown(project):
    """PhysiCell 1.14.2: 594 and 588 cells of 200 after 4 h, 2.95 of one."""
    rules = "tumour cell,volume,increases,cycle entry,0.05,2400,8,0\n"
    slower = ('change_rate units="1/min">0.005<', 'change_rate units="1/min">0.0045<')
    made = imported(project, LIVE, 4, 10, rules, slower)
    numbers = [len(finished(quick(made, seed=n), threads=1).cells) for n in range(2)]
    rule = 0.00072, 0.05, 2400.0, 8
    expected = [numbers_by_volume(seed, 4, 100, rule) for seed in range(10)]
    assert np.mean(expected) == pytest.approx(2.95 * 100, rel=0.03)
    assert np.mean(numbers) == pytest.approx(np.mean(expected), rel=0.1)


def ki67(hours, count, cycle, seed):
    """Return numbers of all and of Ki67-positive cells, by the times of all divisions."""
    rng, after = np.random.default_rng(seed), 150.0 if cycle == "advanced" else 0.0
    mean, before = (217.2, 780.0) if cycle == "advanced" else (275.4, 930.0)
    born, all_, positive, end = np.full(count, -after), 0, 0, 60.0 * hours
    while len(born):
        enters = born + after + rng.exponential(mean, len(born))
        there = enters + before > end
        all_ += int(there.sum())
        positive += int((there & ((enters <= end) | (born + after > end))).sum())
        born = np.repeat(enters[~there] + before, 2)
    return all_, positive / all_


@pytest.mark.parametrize("cycle", KI67)
def test_numbers_and_ki67_are_those_of_cells_that_start_in_the_first_phase(project, cycle):
    """After 45 h; PhysiCell 1.14.2 has 321 of 50 cells by the advanced model after 54 h.

    Its Ki67-positive part there is 0.65, and 0.73 after 36 h.
    """
    made = imported(project, KI67[cycle], 45)
    run = Simulation(quick(made), threads=1)
    assert run.history_row()["ki67_positive"] == 0.0
    expected = np.array([ki67(45, 49, cycle, seed) for seed in range(2000)])
    finished(run)
    row = run.history_row()
    found = np.array([row["cells"], row["ki67_positive"]])
    assert (np.abs(found - expected.mean(axis=0)) < 3.5 * expected.std(axis=0)).all()


def test_there_is_no_ki67_without_its_model(project):
    run = Simulation(quick(imported(project, FLOW, 1)), threads=1)
    assert "ki67_positive" not in run.history_row()


def test_a_start_in_the_first_phase_leaves_its_own_time(project):
    """G1 is what is left of Ki67+ after division and then Ki67-: only this lies ahead."""
    cells = Simulation(quick(imported(project, KI67["advanced"], 1, 20)), threads=1).cells
    np.testing.assert_allclose(cells.progress, 150.0 * 60.0, rtol=1e-12)
    left = (cells.phase_length - cells.progress) / 60.0
    assert (left >= 0.0).all()
    assert abs(left.mean() - 217.2) < 4.0 * 217.2 / np.sqrt(len(left))


@pytest.mark.parametrize("second", [217.2, 60.0])
def test_two_random_stages_in_one_phase_have_mean_and_variance_of_their_sum(project, second):
    """Of the Erlang distribution itself where they are alike."""
    random = KI67["advanced"].replace(
        'index="2" fixed_duration="true">150', f'index="2" fixed_duration="false">{second}'
    )
    phase = imported(project, random, 1).scene.growth.phases["G1"]
    u = (np.arange(20000) + 0.5) / 20000
    lengths = quantile(phase, u) / 60.0
    assert lengths.mean() == pytest.approx(217.2 + second, rel=1e-4)
    assert lengths.var() == pytest.approx(217.2**2 + second**2, rel=5e-3)
    if second == 217.2:
        np.testing.assert_allclose(lengths, gamma.ppf(u, 2, scale=second), rtol=1e-9)


def test_cells_that_never_divide_are_ki67_negative(project):
    cycle = ('<cycle code="6" name="Flow cytometry model (separated)">',
             f'{KI67["advanced"]}<unread enabled="false">')  # fmt: skip
    path = project(cycle)
    text = path.read_text("utf-8").replace("</cycle>", "</unread>", 2)
    path.write_text(text.replace("</unread><unread", "</cycle><unread", 1), "utf-8")
    made = mc.import_physicell(path)
    assert made.scene.growth.ki67_decay == 9000.0
    run = Simulation(made.scene, threads=1)
    assert run.history_row()["ki67_positive"] == 0.0
    assert set(run.cells.kind.tolist()) == {0, 1}


def test_a_large_type_that_does_not_divide_leaves_the_target_of_others(project):
    """A cell of ten times the volume sets the radius of division, not to what cells grow."""
    table = "x,y,z,type,volume\n" + "".join(f"{30 * k},0,0,tumour cell,\n" for k in range(3))
    made = mc.import_physicell(project(cells=f"{table}-60,0,0,hunter,24940\n"))
    growth, radius = made.scene.growth, made.scene.cells.division_radius
    scale = growth.parameters["target"] * 4.0 / 3.0 * np.pi * radius**3
    targets = [growth.phases[name].target_scale * scale for name in ("G1", "S", "G2", "M")]
    np.testing.assert_allclose(targets, VOLUME * np.array([1.0, 2.0, 2.0, 2.0]), rtol=1e-9)
    assert "hunter" in made.scene.types
