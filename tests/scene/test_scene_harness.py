"""Scenes drawn from the declarations: each loads or is refused by name, runs or fails by name.

``pytest tests/scene/test_scene_harness.py -s --scenes 20000 --runs 1000 --first-seed 1`` searches
longer and prints what became of them; several at once need other seeds. Every fault found got a
test here.
"""

from __future__ import annotations

from contextlib import suppress

import pytest
import scene_strategies as drawn
import tomli_w
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scene_harness import (
    Fault,
    campaign,
    explained,
    load_case,
    place_exists,
    run_case,
    start_of,
)

from multicell.cli.main import main
from multicell.errors import SceneError
from multicell.runner import next_frame, run
from multicell.scene.ranges import check_memory
from multicell.scene.scene import Scene, load_scene
from multicell.simulation import Simulation
from multicell.units import RANGES, shown, to_base

# --- the search --------------------------------------------------------------------------------


def searched(request, kind, option):
    """Draw as many cases as the command asks for; print and return the tally."""
    number = request.config.getoption(option)
    seed = request.config.getoption("--first-seed") * 10_000
    forks, place = map(request.getfixturevalue, ("forks", "tmp_path"))
    tally = campaign(kind, number, forks, place, first_seed=seed)
    print(f"\n{option[2:]}: {tally}")
    assert not tally.faults, str(tally)
    assert tally.total >= 0.9 * number
    return tally.counts


@pytest.mark.harness
@pytest.mark.slow
def test_scenes_load_or_are_refused_by_name(request):
    counts = searched(request, "load", "--scenes")
    assert set(counts) == {"loaded", "refused"}
    assert 0.25 < counts["loaded"] / counts.total() < 0.9, "a search of one kind only finds nothing"


@pytest.mark.harness
@pytest.mark.slow
def test_small_scenes_run_to_finite_numbers_or_fail_by_name(request):
    counts = searched(request, "run", "--runs")
    assert {name.split(" ")[0] for name in counts} <= {"ran", "refused", "StepFailed"}
    assert counts["ran"] >= 0.4 * counts.total(), "the search runs too little"


@pytest.mark.harness
@pytest.mark.slow
def test_every_scene_with_any_parts_by_any_method_runs_to_finite_numbers(request):
    counts = searched(request, "compose", "--draws")
    # refused: what holds the parts together does not hold the cells that are drawn
    assert {name.split(" ")[0] for name in counts} <= {"ran", "StepFailed", "refused"}
    assert counts["refused"] <= max(2, 0.1 * counts.total())
    assert counts["ran"] / counts.total() > 0.6, "the search runs too little"


@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_broken_text_is_refused_by_name(tmp_path_factory, data):
    file = tmp_path_factory.mktemp("scene") / "scene.toml"
    text = data.draw(drawn.broken_text(load_scene("treatment").to_toml()))
    file.write_text(text, encoding="utf-8")
    # text that stays whole by chance may be a scene; anything else is refused with words
    with suppress(SceneError):
        assert load_scene(file).duration > 0.0


def test_the_harness_sees_faults(monkeypatch):
    monkeypatch.setattr(Scene, "to_dict", lambda self: {"duration": 2.0})
    with pytest.raises((Fault, AssertionError)):
        load_case({"duration": 1.0})
    assert not place_exists("nutrients.oxygen.boundary", {"duration": 1.0})
    assert not place_exists("", {"duration": 1.0})
    assert place_exists("duration", {})


# --- faults that it found, each with its class -------------------------------------------------


def refusal(entries):
    with pytest.raises(SceneError) as caught:
        Scene.from_dict({"duration": 3600.0, **entries})
    return caught.value


def numbers():
    """Yield every declared number of a scene that stands in a table without names."""
    for path, spec in drawn.declared():
        if spec.kind in ("quantity", "number") and "*" not in path:
            yield pytest.param(path, spec, id=path)


@pytest.mark.parametrize("value", [1e300, 1e-300, 5e-324])
@pytest.mark.parametrize(("path", "spec"), list(numbers()))
def test_numbers_that_nothing_can_be_computed_with_are_refused(path, spec, value):
    *tables, key = path.split(".")
    entries = {key: value}
    if tables[:1] == ["contact"]:
        entries["law"] = next(
            name for name, part in specs_of_laws().items() if key in drawn.specs(part)
        )
    if tables == ["initial", "cells"]:
        entries["file"] = "cells.csv"
    for name in reversed(tables):
        entries = {name: entries}
    error = refusal(entries)
    assert error.path in (path, "coupling_step", "integrator.step")


def specs_of_laws():
    return drawn.specs(Scene)["contact"].parts


@pytest.mark.parametrize(
    ("entries", "path"),
    [
        ({"initial": {"count": 10**18}}, "initial.count"),
        ({"integrator": {"max_steps": 10**18}}, "integrator.max_steps"),
        ({"duration": 1e6, "coupling_step": 1e-6}, "coupling_step"),
        ({"integrator": {"method": "euler", "step": 1e-6}}, "integrator.step"),
        ({"growth": {"cycle_time": 500.0}}, "growth.cycle_time"),
        (
            {"growth": {"cycle_time": 6000.0}, "types": {"a": {"cycle_scale": 0.05}}},
            "coupling_step",
        ),
        ({"cells": {"young": 1e-6}}, "contact.surface_energy"),
        ({"cells": {"young": 1e-6}, "contact": {"law": "exact-jkr"}}, "contact.surface_energy"),
        (
            {
                "adhesion": {"strength": 1e6},
                "types": {"a": {"receptor": 1, "ligand": [[0, 0], ["5 d", 1]]}},
            },
            "adhesion.strength",
        ),
        (
            {"nutrients": {"o2": {"diffusion_medium": 1e9, "diffusion": 1.0}}},
            "nutrients.o2.diffusion_medium",
        ),
        ({"nutrients": {"o2": {"media": [[0, 1], ["1 h", 1e300]]}}}, "nutrients.o2.media"),
        ({"contact": {"law": "linear", "cutoff": 1e9}}, "contact.cutoff"),
        ({"cells": {"": 1}}, "cells.''"),
        (
            {
                "domain": {axis: [-50, 50] for axis in "xyz"},
                "nutrients": {"o2": {}},
                "reactions": {"r": {"rate": 1, "consumes": {"co2": 1}}},
            },
            "reactions.r.consumes.co2",
        ),
        ({"": 1}, "''"),
    ],
)
def test_what_would_hang_overflow_or_collapse_is_refused(entries, path):
    assert refusal(entries).path == path


CUBE = {axis: [-20.0, 20.0] for axis in "xyz"}
CANNOT_START = {
    "a motion of an identity": (
        {"initial": {"count": 3}, "motions": {"a": {"cells": [7]}}}, "motions.a.cells"
    ),
    "a motion of a region": (
        {"initial": {"count": 3}, "motions": {"a": {"x": [500.0, 600.0]}}}, "motions.a"
    ),
    "two motions of one cell": (
        {"motions": {"a": {"cells": [0]}, "b": {"cells": [0]}}}, "motions.b"
    ),
    "a small box": ({"initial": {"count": 500}, "domain": CUBE}, "domain.y"),
    "a small sphere": (
        {"initial": {"count": 500}, "domain": {"shape": "sphere", "radius": 20.0}}, "domain.radius"
    ),
    "a small medium": (
        {"nutrients": {"o2": {"finite_medium": {"volume": 1e5}}}},
        "nutrients.o2.finite_medium.volume",
    ),
    "a small medium round shells": (
        {"nutrients": {"o2": {"geometry": "radial", "finite_medium": {"volume": 1e5}}}},
        "nutrients.o2.finite_medium.volume",
    ),
    "a wide margin": (
        {"nutrients": {"o2": {"margin": 5000.0, "spacing": 10.0}}}, "nutrients.o2.spacing"
    ),
    "a long row": (
        {"initial": {"count": 900, "shape": "row", "spacing": 1e4},
         "nutrients": {"o2": {"spacing": 0.5}}},
        "nutrients.o2.spacing",
    ),
    "a wide jitter": (
        {"initial": {"count": 9, "jitter": 1e3}, "nutrients": {"o2": {"spacing": 2.0}}},
        "nutrients.o2.spacing",
    ),
    "shells beyond number": (
        {"initial": {"count": 2, "spacing": 1e6},
         "nutrients": {"o2": {"geometry": "radial", "spacing": 0.5}}},
        "nutrients.o2.spacing",
    ),
    "a crowd": ({"initial": {"count": 20_000, "spacing": 1e-3}}, "initial.spacing"),
    "cells at one point": ({"initial": {"count": 20_000, "spacing": 1e-300}}, "initial.spacing"),
    "a crowd in a plane": (
        {"dimensions": 2, "initial": {"count": 20_000, "spacing": 0.01}}, "initial.spacing"
    ),
    "a plane of too many squares": (
        {"dimensions": 2,
         "nutrients": {"o2": {"uptake": 0.0, "margin": 1e5, "spacing": 10.0}}},
        "nutrients.o2.spacing",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CANNOT_START)
def test_what_no_run_could_begin_with_is_refused_before_it(case, tmp_path):
    entries, path = CANNOT_START[case]
    entries, out = {"duration": 3600.0, **entries}, tmp_path / "out"
    for door in (explained, lambda scene: run(scene, output=out)):
        with pytest.raises(SceneError) as caught:
            door(Scene.from_dict(entries))
        assert caught.value.path == path
        assert caught.value.hint
    file = tmp_path / "scene.toml"
    file.write_text(tomli_w.dumps(entries), "utf-8")
    for command in (["explain", str(file)], ["run", str(file), "-o", str(out)]):
        answer = CliRunner().invoke(main, command)
        assert answer.exit_code == 2
        assert f"Error: {path}: " in answer.stderr
    assert not out.exists()


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(entries=drawn.starting())
@pytest.mark.slow
def test_scenes_that_are_explained_begin(entries):
    """Motions, domains and media of the sizes at which some fit and some do not."""
    if start_of(entries) == "begins":
        scene = Scene.from_dict(entries)
        assert len(Simulation(scene, threads=1).cells) == scene.initial.count


def test_both_kinds_of_starts_are_drawn():
    found = set()
    seeds = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
    seeds(given(entries=drawn.starting())(lambda entries: found.add(start_of(entries))))()
    assert found == {"begins", "refused"}


def test_ranges_say_zero_only_where_zero_is_allowed():
    assert "must be from 1e-08 to 1e+12 kPa s" in refusal({"drag": {"viscosity": 1e-30}}).problem
    assert "must be 0 or from" in refusal({"contact": {"surface_energy": 1e-30}}).problem
    assert all(0.0 < low < 1.0 < high for low, high in RANGES.values())


def test_cells_that_do_not_fit_into_memory_are_refused_before_they_are_made(monkeypatch):
    monkeypatch.setattr("multicell.scene.ranges.physical_memory", lambda: 2**30)
    scene = Scene(duration=1.0, initial={"count": 10**8})
    with pytest.raises(SceneError, match=r"initial.count: is 100,000,000: .* need about 100 GB"):
        Simulation(scene)
    check_memory(Scene(duration=1.0, initial={"count": 10**5}))
    monkeypatch.setattr("multicell.scene.ranges.physical_memory", lambda: None)
    check_memory(scene)


@pytest.mark.parametrize("value", [10**5000, -(10**5000)], ids=["large", "small"])
def test_integers_of_thousands_of_digits_are_refused_with_words(value):
    assert "too long to show" in refusal({"initial": {"count": value}}).problem
    assert "finite" in refusal({"coupling_step": value}).problem
    assert len(shown("x" * 10**6)) < 100


def test_deep_nesting_is_refused_with_words():
    value = []
    for _ in range(100_000):
        value = [value]
    with pytest.raises(SceneError, match="nested too deeply"):
        Scene(duration=1.0).with_changes({"title": value})


@pytest.mark.parametrize(
    "entries",
    [
        {"types": {"a": {"uptake_of": {}, "surface_energy": {}}}},
        {"adhesion": {}, "types": {"a": {"receptor": [["5 h", 1.0]], "ligand": 1}}},
        {"nutrients": {"o2": {"secretion_from": {}, "uptake_on": {}, "sides": {}}}},
        {"growth": {}, "death": {}, "friction": {}, "motility": {}, "pull": {}},
        {"growth": {"phases": {}}, "types": {}, "chemotaxis": {}, "nutrients": {}},
        {"initial": {"jitter": -0.0}, "cells": {"heritable": [], "poisson": -0.0}},
        {"title": "with \"quotes\" \\ # = [x] ''' é"},
    ],
)
def test_empty_and_single_values_survive_a_round_trip(entries):
    assert load_case({"duration": 3600.0, **entries}) == "loaded"


def test_a_table_known_by_its_digest_is_looked_for_when_it_is_needed():
    known = {"file": "µ", "sha256": "0" * 64, "rows": 3}
    assert load_case({"duration": 3600.0, "initial": {"cells": known}}) == "refused"
    assert run_case({"duration": 3600.0, "initial": {"cells": known}}) == "refused"


@pytest.mark.parametrize("text", ["1e-400 um", "-1e-999999999 um", "0.0e-5 um"])
def test_a_quantity_is_never_rounded_to_nothing(text):
    if float(text.split("e")[0]) == 0.0:
        assert to_base(text, "um") == 0.0
    else:
        with pytest.raises(SceneError, match="too small for a number"):
            to_base(text, "um")


@pytest.mark.parametrize("every", [1e-6, 1.0, 7.0, 10.0, 25.0, 1e12])
def test_frames_are_due_as_by_counting(every):
    """The next frame is the first multiple of ``every`` after now, at once also for tiny ones."""
    for step in range(40):
        found = next_frame(every, 10.0 * step)
        due = every * (10.0 * step // every + 1.0)
        if every >= 1.0:
            assert found == pytest.approx(due, rel=1e-12)
        assert 10.0 * step < found <= 10.0 * step + every * (1.0 + 1e-9)
    assert next_frame(every, 1e9) > 1e9


def test_more_frames_than_coupling_steps_are_not_promised():
    scene = Scene(duration=3600.0, output={"every": 1e-6})
    told = {number["name"]: number["value"] for number in explained(scene)["numbers"]}
    assert (told["coupling steps"], told["frames"]) == (6, 7)


@pytest.mark.parametrize(
    "entries",
    [
        {"contact": {"law": "generalised-linear", "cutoff": 1.0}},
        {
            "contact": {"law": "generalised-linear"},
            "adhesion": {"strength": 0.08},
            "types": {"a": {"receptor": 1, "ligand": 1}},
        },
    ],
)
def test_explain_finds_rest_where_the_law_is_at_its_end(entries):
    scene = Scene.from_dict({"duration": 3600.0, **entries})
    (rest,) = [n for n in explained(scene)["numbers"] if "equilibrium distance" in n["name"]]
    assert rest["value"] == pytest.approx(2.0 * scene.cells.division_radius * 0.5 ** (1 / 3))


@pytest.mark.parametrize(
    "entries",
    [
        {"growth": {}, "initial": {"count": 3}, "coupling_step": 600.0},
        {  # a field that goes from shells to cubes, and has a side that only shells have
            "initial": {"count": 2},
            "nutrients": {
                "o2": {"geometry": "auto", "regime": "steady", "sides": {"r+": {"value": 0.1}}}
            },
        },
    ],
)
def test_scenes_that_once_failed_run(entries):
    assert run_case({"duration": 1200.0, **entries}) == "ran"
