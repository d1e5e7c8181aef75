"""Laws by which volumes grow, ours and the user's, against closed forms and SciPy."""

import numpy as np
import pytest
from running import refused
from scipy import integrate

import multicell as mc
from multicell.behaviours.growth_laws.laws import GROWTH_LAWS
from multicell.biology.cycle import advance_cycle
from multicell.biology.division import divide
from multicell.biology.growth import lag_after, volumes_after
from multicell.biology.initial import initial_cells
from multicell.biology.plan import biology_plan
from multicell.cells import SPHERE, State
from multicell.scene.parts import Growth
from multicell.scene.scene import Scene
from multicell.scene.sizes import birth_volume
from multicell.schema import number
from multicell.simulation import Simulation
from multicell.testing import check_growth_law

PHASES = {"G1": "5 h", "S": "4 h", "G2": "2 h", "M": "1 h"}


def growth(law, target=1.3, **more):
    return {
        "law": law,
        **({"parameters": {"target": target}} if law == "relaxation" else {}),
        **more,
    }


def scene_of(law, count=20, target=1.3, initial=None, **more):
    return Scene.from_dict({
        "duration": "3 d",
        "coupling_step": "10 min",
        "initial": {"count": count, "spacing": 3.0, **(initial or {})},
        "contact": {"law": "hertz"},
        "growth": growth(law, target, **more),
    })  # fmt: skip


def right_hand_side(law, largest):
    """Return g(V) without its rate, written down once more."""
    return {
        "linear": lambda v: 1.0 + 0.0 * v,
        "exponential": lambda v: v,
        "relaxation": lambda v: largest - v,
    }[law]


@pytest.mark.parametrize("law", GROWTH_LAWS)
@pytest.mark.parametrize("target", [1.001, 1.3, 50.0])
def test_a_law_solves_its_equation_and_doubles_the_volume_in_a_cycle(law, target):
    """The rate that doubles V in a cycle comes from quadrature of dV/g, the course from SciPy."""
    law_of = Growth(**growth(law, target)).growth_law
    birth = 261.8
    g = right_hand_side(law, 2.0 * birth * target)
    points = [2.0 * birth * (1.0 - 1e-3)] if target < 1.01 else None
    rate = integrate.quad(
        lambda v: 1.0 / g(v), birth, 2.0 * birth, epsrel=1e-12, points=points, limit=200
    )[0]  # fmt: skip
    share = np.linspace(0.0, 1.2, 13)
    found = law_of.volume_after(np.full(13, birth), share, birth)
    assert found[10] == pytest.approx(2.0 * birth, rel=1e-12)
    course = integrate.solve_ivp(
        lambda s, v: rate * g(v), (0.0, 1.2), [birth], t_eval=share, rtol=1e-11, atol=1e-9
    ).y[0]
    np.testing.assert_allclose(found, course, rtol=1e-8)
    np.testing.assert_allclose(law_of.rate(found, birth), rate * g(found), rtol=1e-8)
    # two parts of a step are the whole of it
    half = law_of.volume_after(np.full(13, birth), 0.4 * share, birth)
    again = law_of.volume_after(half, 0.6 * share, birth)
    np.testing.assert_allclose(again, found, rtol=1e-12)


@pytest.mark.parametrize("law", GROWTH_LAWS)
def test_the_factor_of_growth_slows_the_clock_and_resting_cells_stay(law):
    scene = scene_of(law, cycle_time="10 h", cycle_variation=0.0)
    cells = initial_cells(scene)
    cells.state[0], cells.state[1] = State.QUIESCENT, State.QUIESCENT
    factor = np.linspace(0.0, 1.0, len(cells))
    after = volumes_after(biology_plan(scene), cells, factor, 18000.0)
    slow = scene.growth.growth_law.volume_after(cells.volume, 0.5 * factor, birth_volume(scene))
    np.testing.assert_allclose(after[2:], slow[2:], rtol=1e-14)
    np.testing.assert_array_equal(after[:2], cells.volume[:2])


@pytest.mark.parametrize("law", GROWTH_LAWS)
@pytest.mark.parametrize("phases", [False, True])
def test_cells_described_by_their_radii_go_on_like_those_described_by_their_ages(law, phases):
    """Cells of a start table have their place in the cycle by their size."""
    cycle = {"cycle_time": "12 h", "cycle_variation": 0.0}
    more = {"phases": {n: {"duration": d} for n, d in PHASES.items()}} if phases else cycle
    scene, share = scene_of(law, **more), np.array([0.0, 0.2, 0.5, 0.8])
    columns = {"position_x_um": 40.0 * np.arange(4)}
    columns |= {f"position_{axis}_um": np.zeros(4) for axis in "yz"}
    by_age = Simulation(scene, cells={**columns, "age_h": 12.0 * share}).cells
    by_radius = Simulation(scene, cells={**columns, "radius_um": by_age.radius}).cells
    if not phases:
        birth = birth_volume(scene)
        exact = scene.growth.growth_law.volume_after(np.full(4, birth), share, birth)
        np.testing.assert_allclose(by_age.volume, exact, rtol=1e-12)
    np.testing.assert_allclose(by_radius.age, by_age.age, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(by_radius.radius, by_age.radius, rtol=1e-12)
    assert by_radius.phase.tolist() == by_age.phase.tolist()


@pytest.mark.parametrize("phases", [False, True])
def test_linear_growth_has_the_bits_of_the_formula(phases):
    more = {"phases": {n: {"duration": d} for n, d in PHASES.items()}} if phases else {}
    scene = scene_of("linear", 20, initial={"stage": "uniform"}, **more)
    cells = initial_cells(scene)
    factor = np.linspace(0.1, 1.0, 20)
    if not phases:
        exact = cells.volume + 600.0 * (factor * birth_volume(scene) / cells.cycle_time)
        np.testing.assert_array_equal(
            volumes_after(biology_plan(scene), cells, factor, 600.0), exact
        )
        return
    within = cells.phase_length - cells.progress > 600.0
    found = advance_cycle(biology_plan(scene), cells, factor, np.zeros(20, bool), 600.0).volume
    exact = cells.volume + birth_volume(scene) / cells.cycle_time * factor * 600.0
    assert within.sum() > 15
    np.testing.assert_array_equal(found[within], exact[within])


def grown_for(scene, dt, duration):
    """Let the cells of a scene grow freely in steps of dt; return them by their identities."""
    plan, cells, number = biology_plan(scene), initial_cells(scene), scene.initial.count
    for _ in range(round(duration / dt)):
        grown = volumes_after(plan, cells, np.ones(len(cells)), dt)
        cells.radius = np.cbrt(grown / SPHERE)
        cells, number = divide(plan, cells, number, dt)
    return cells.take(np.argsort(cells.id))


@pytest.mark.parametrize("dt", [600.0, 3000.0, 9000.0])
@pytest.mark.parametrize("law", GROWTH_LAWS)
def test_daughters_grow_since_the_division_whatever_the_step(law, dt):
    """After 3.75 cycles of 10 h all are eight times as many, three quarters through their cycle."""
    scene = scene_of(law, 3, cycle_time="10 h", cycle_variation=0.0, initial={"stage": "birth"})
    cells = grown_for(scene, dt, 37.5 * 3600.0)
    assert len(cells) == 24
    birth = birth_volume(scene)
    exact = scene.growth.growth_law.volume_after(np.array(birth), np.array(0.75), birth)
    np.testing.assert_allclose(cells.volume, exact, rtol=1e-9)


@pytest.mark.parametrize("law", GROWTH_LAWS)
def test_other_steps_leave_draws_and_volumes_as_they_are(law):
    scene = scene_of(law, 20, cycle_time="10 h", cycle_variation=0.2, initial={"stage": "uniform"})
    fine, coarse = (grown_for(scene, dt, 24.0 * 3600.0) for dt in (300.0, 3600.0))
    np.testing.assert_array_equal(fine.id, coarse.id)
    np.testing.assert_array_equal(fine.parent, coarse.parent)
    np.testing.assert_array_equal(fine.cycle_time, coarse.cycle_time)
    np.testing.assert_allclose(fine.volume, coarse.volume, rtol=1e-9)


def test_a_mother_who_was_large_before_is_halved():
    """Only what can have grown in the step counts as grown since the division."""
    scene = scene_of(
        "linear", 1, cycle_time="10 h", cycle_variation=0.0, initial={"stage": "birth"}
    )
    plan, cells = biology_plan(scene), initial_cells(scene)
    cells.radius = np.cbrt(np.array([3.0 * birth_volume(scene)]) / SPHERE)
    after, _ = divide(plan, cells, 1, 3600.0)
    # a tenth of the birth volume in an hour: each daughter has grown by that since
    np.testing.assert_allclose(after.volume, (1.45 + 0.1) * birth_volume(scene), rtol=1e-12)


@pytest.mark.parametrize("law", GROWTH_LAWS)
def test_a_changing_factor_is_made_good_whatever_the_law(law):
    """At f0 where f falls linearly to f1: the time that a cell grows is f dt, integrated."""
    scene = scene_of(law, 50, cycle_variation=0.1, initial={"stage": "uniform"})
    plan, began, dt = biology_plan(scene), initial_cells(scene), 60.0
    first, last = np.linspace(0.2, 1.0, 50), np.linspace(0.4, 0.7, 50)
    cells = began.shared()
    cells.radius = np.cbrt(volumes_after(plan, began, first, dt) / SPHERE)
    cells.lag = lag_after(plan, began, first, cells, last, dt)
    made_good = volumes_after(plan, cells, cells.lag / dt, dt)
    true = volumes_after(plan, began, 0.5 * (first + last), dt)
    np.testing.assert_allclose(made_good, true, rtol=1e-12)


@pytest.mark.parametrize(
    ("entries", "path", "words"),
    [
        ({"law": "relaxation"}, "growth.parameters.target", "is missing"),
        ({"law": "relaxation", "parameters": {"target": 1}}, "growth.parameters.target", "above 1"),
        ({"law": "linear", "parameters": {"target": 2}}, "growth.parameters.target", "not a known"),
        ({"law": "cubic"}, "growth.law", "must be one of"),
    ],
)
def test_a_law_that_never_comes_to_division_is_refused(entries, path, words):
    with refused(path, words):
        Scene.from_dict({"duration": "1 h", "growth": entries})


# laws of the user's own


@mc.growth_law(parameters={"exponent": number(default=0.75, above=0.0, below=1.0)})
def power(volume, p):
    return volume**p.exponent


@mc.growth_law(parameters={"largest": ""})
def same_as_relaxation(volume, p):
    return p.largest - volume


def test_a_derived_course_is_that_of_a_closed_form_and_of_scipy():
    """V' ~ V^a has V^(1-a) = 1 + (2^(1-a) - 1) s; relaxation is written down once more."""
    share = np.linspace(0.0, 1.1, 12)
    a = 0.75
    exact = (1.0 + (2.0 ** (1.0 - a) - 1.0) * share) ** (1.0 / (1.0 - a))
    law = power(exponent=a)
    check_growth_law(law)
    np.testing.assert_allclose(law.volume_after(np.ones(12), share), exact, rtol=1e-13)
    np.testing.assert_allclose(law.share_at(exact), share, rtol=0.0, atol=1e-13)
    ours, again = GROWTH_LAWS["relaxation"](target=1.2), same_as_relaxation(largest=2.4)
    check_growth_law(again)
    birth, begin = 261.8, np.full(12, 300.0)
    np.testing.assert_allclose(
        again.volume_after(begin, share, birth), ours.volume_after(begin, share, birth), rtol=1e-11
    )
    np.testing.assert_allclose(again.rate(begin, birth), ours.rate(begin, birth), rtol=1e-13)
    course = integrate.solve_ivp(
        lambda s, v: again.rate(v), (0.0, 1.1), [1.0], t_eval=share, rtol=1e-11, atol=1e-11
    ).y[0]
    np.testing.assert_allclose(again.volume_after(np.ones(12), share), course, rtol=1e-9)


def test_a_run_by_an_own_law_has_cells_of_its_volumes(tmp_path):
    scene = mc.load_scene("growth").with_changes({
        "growth.law": power(exponent=0.5), "duration": "6 h", "growth.cycle_variation": 0,
        "initial.count": 3, "initial.stage": "birth",
    })  # fmt: skip
    assert scene.growth.law == power.scene_name()
    result = mc.run(scene, output=tmp_path / "out", report=False)
    share = 6.0 * 3600.0 / scene.growth.cycle_time
    exact = (1.0 + (2.0**0.5 - 1.0) * share) ** 2
    cells = result.frames[-1].cells
    birth = 0.5 * 4.0 / 3.0 * np.pi * scene.cells.division_radius**3
    np.testing.assert_allclose(cells.volume / birth, exact, rtol=1e-9)
    assert mc.load_scene(tmp_path / "out" / "scene.toml") == scene
    with pytest.raises(mc.SceneError, match=r"growth\.parameters\.exponent"):
        scene.with_changes({"growth.law": "linear"})


def test_an_own_law_doubles_the_population_in_a_cycle_in_phases_too():
    phases = {n: {"duration": d} for n, d in PHASES.items()}
    scene = mc.Scene.from_dict({
        "duration": "1 d", "coupling_step": "10 min", "contact": {"law": "hertz"},
        "initial": {"count": 4, "spacing": 3.0, "stage": "birth"},
        "growth": {"law": power.scene_name(), "parameters": {"exponent": 0.9}, "phases": phases},
    })  # fmt: skip
    simulation = Simulation(scene, threads=1)
    while simulation.time < 13.0 * 3600.0:
        simulation.step()
    assert len(simulation.cells) == 8
    assert simulation.cells.volume.mean() == pytest.approx(
        261.8 * float(scene.growth.growth_law.volume_after(1.0, 1.0 / 12.0)), rel=1e-4
    )


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: mc.growth_law(parameters={})(lambda v: v), "must have the arguments volume, p"),
        (lambda: mc.growth_law(parameters={"rate": ""})(lambda volume, p: volume), "'rate'"),
    ],
)
def test_functions_that_are_no_laws_are_refused(made, words):
    with pytest.raises(TypeError, match=words):
        made()


def test_a_check_finds_what_is_wrong():
    def shrinking(volume, p):
        return 1.5 - volume

    with pytest.raises(mc.SceneError, match=r"growth\.parameters.*above zero up to 2"):
        mc.load_scene("growth").with_changes(
            {"growth.law": same_as_relaxation.scene_name(), "growth.parameters": {"largest": 1.9}}
        )

    with pytest.raises(mc.SceneError, match=r"rate of growth 0 at 1.5 times .* above zero up to 2"):
        mc.growth_law(parameters={})(shrinking)()
    wrong = mc.growth_law(parameters={})(lambda volume, p: 1.0 + 0.0 * volume)
    wrong.volume_after = lambda law, begin, share, birth=1.0: begin + 0.5 * birth * share
    with pytest.raises(AssertionError, match=r"does not double the volume.*not the inverse"):
        check_growth_law(wrong())


def test_failures_of_an_own_law_name_its_line():
    def broken(volume, p):
        return volume.nothing

    with pytest.raises(mc.SceneError, match=r"test_growth_laws\.py.*nothing"):
        mc.growth_law(parameters={})(broken)()


@pytest.mark.slow
def test_a_scene_on_disk_runs_no_file_and_the_command_line_does(tmp_path, forks):
    with pytest.raises(mc.SceneError, match="which is not loaded") as caught:
        mc.load_scene("growth").with_changes({"growth.law": "mine.py:other@0123456789ab"})
    assert "--law mine.py:other" in caught.value.hint
    (tmp_path / "mine.py").write_text(
        "import multicell as mc\n"
        "@mc.growth_law(parameters={'exponent': ''})\n"
        "def power(volume, p):\n"
        "    return volume**p.exponent\n"
    )
    done = forks.multicell(
        "run", "growth", "--law", "mine.py:power", "--set", "growth.parameters.exponent=0.5",
        "--set", "duration='1 h'", "--quiet", "--no-report", "-o", "out", folder=str(tmp_path),
    )  # fmt: skip
    assert done["code"] == 0, done["text"]
    assert 'law = "mine.py:power@' in (tmp_path / "out" / "scene.toml").read_text()
