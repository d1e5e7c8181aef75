"""Pictures and key figures of contact: types, heterotypic contacts, pull."""

import json

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.collections import EllipseCollection
from picture_texts import read, rendered, texts
from synthetic import BARE, ball, cells_at

import multicell as mc
from multicell.cells import State
from multicell.report.plots import contacts as contact_plots
from multicell.report.plots import style as drawing
from multicell.report.plots.run import Plots
from multicell.results.frame import Frame
from multicell.results.observables import heterotypic_fraction
from multicell.scene.pairs import pair_of, type_pairs
from multicell.scene.scene import Scene

TWO_TYPES = BARE.with_changes({"types": {"inner": {}, "outer": {}}})
STICKY = {
    "duration": "1 h",
    "cells": {"division_radius": 10.0 * 2 ** (1 / 3), "young": 1.0, "poisson": 0.5},
}


@pytest.fixture(scope="module")
def doublet(tmp_path_factory):
    # from just below the pull-off on, so that a minute of simulated time is enough
    scene = mc.load_scene("doublet").with_changes(
        {"pull.force": "2.25 nN", "output.every": "30 s", "coupling_step": "2 s"}
    )
    return mc.run(scene, output=tmp_path_factory.mktemp("doublet") / "out")


@pytest.fixture(scope="module")
def mixture(tmp_path_factory):
    scene = mc.load_scene("sorting").with_changes(
        {"initial.count": 60, "duration": "30 min", "output.every": "10 min"}
    )
    return mc.run(scene, output=tmp_path_factory.mktemp("sorting") / "out")


def lines(axes):
    return {line.get_label(): line for line in axes.get_lines()}


# --- colours of the types ----------------------------------------------------------------------


def test_section_is_coloured_by_type_and_dead_cells_stay_dark():
    position = [[0.0, 0, 0], [12.0, 0, 0], [-12.0, 0, 0], [0, 12.0, 0]]
    cells = cells_at(position, state=[0, 1, State.NECROTIC, 0])
    cells.kind[:] = [0, 1, 0, 1]
    figure = Plots([Frame(0.0, 0, cells)], {}, TWO_TYPES).section()
    *_, circles = figure.axes[0].findobj(EllipseCollection)
    colours = drawing.type_colours(["inner", "outer"])
    expected = [
        colours["inner"],
        colours["outer"],
        drawing.STATE_COLOURS["necrotic"],
        colours["outer"],
    ]
    np.testing.assert_allclose(
        circles.get_facecolor()[:, :3], [mpl.colors.to_rgb(c) for c in expected]
    )
    words = texts(figure)
    for label in ("inner (1)", "outer (2)", "necrotic (1)"):
        assert label in words
    assert not any("proliferating" in text for text in words)


def test_a_type_may_be_named_like_a_state_or_a_hidden_label():
    cells = cells_at([[0.0, 0, 0], [12.0, 0, 0], [0, 12.0, 0], [0, 0, 0]], state=[0, 0, 2, 0])
    cells.kind[:] = [0, 1, 1, 1]
    scene = BARE.with_changes({"types": {"necrotic": {}, "_hidden": {}}})
    figure = Plots([Frame(0.0, 0, cells)], {}, scene).section()
    words = texts(figure)
    assert "necrotic (1)" in words
    assert "dead (necrotic) (1)" in words
    assert any("_hidden (2)" in text for text in words)


@pytest.mark.parametrize("count", [2, 7, 12])
def test_types_have_colours_of_their_own(count):
    colours = list(drawing.type_colours([f"type{k}" for k in range(count)]).values())
    assert len(set(colours)) == count
    assert drawing.STATE_COLOURS["necrotic"] not in colours


def test_two_cells_are_cut_through_both_centres():
    along_z = cells_at([[1.0, 2.0, -9.0], [1.0, 2.0, 9.0]], radius=10.0)
    figure = Plots([Frame(0.0, 0, along_z)], {}, BARE).section()
    *_, circles = figure.axes[0].findobj(EllipseCollection)
    np.testing.assert_allclose(circles.get_widths(), 20.0)
    gap = np.diff(circles.get_offsets(), axis=0)
    assert np.linalg.norm(gap) == pytest.approx(18.0)


def test_profile_shows_the_part_of_each_type():
    cells = cells_at(ball(300))
    far = np.linalg.norm(cells.position - cells.position.mean(axis=0), axis=1)
    cells.kind[:] = far > 0.5 * far.max()
    figure = Plots([Frame(0.0, 0, cells)], {}, TWO_TYPES).profiles()
    lower = figure.axes[1]
    assert "Cells by type" in texts(figure)
    inner, outer = (drawing.type_colours(["inner", "outer"])[name] for name in ("inner", "outer"))
    heights = {}
    for part in lower.patches:
        tops, _, bottoms = part.get_data()
        heights[mpl.colors.to_hex(part.get_facecolor())] = tops - bottoms
    assert heights[inner][0] == 100.0
    assert heights[inner][-1] == 0.0
    assert heights[outer][-1] == 100.0


# --- heterotypic contacts ----------------------------------------------------------------------


def test_random_mixing_is_the_mean_over_all_dealings_of_the_types():
    """Shuffled types of fixed numbers over the contacts of a fixed graph."""
    cells = cells_at(ball(60))
    cells.kind[:] = np.arange(len(cells)) % 3 == 0
    far = np.linalg.norm(cells.position[:, None] - cells.position[None], axis=2)
    contacts = cells.id[np.argwhere(np.triu(far < 9.5, 1))]
    rng = np.random.default_rng(5)
    seen = []
    for _ in range(400):
        cells.kind[:] = rng.permutation(cells.kind)
        seen.append(heterotypic_fraction(cells, contacts))
    expected = contact_plots.random_mixing(cells)
    assert np.mean(seen) == pytest.approx(expected, abs=5 * np.std(seen) / np.sqrt(len(seen)))
    assert np.isnan(contact_plots.random_mixing(cells_at([[0, 0, 0]])))


def test_contacts_chart_shows_history_and_random_mixing(mixture):
    figure = mixture.plot.contacts()
    rendered(figure)
    upper, lower = figure.axes
    history = mixture.history
    shown = lines(upper)["as simulated"]
    np.testing.assert_allclose(shown.get_ydata(), 100.0 * history["heterotypic_fraction"])
    dashed = lines(upper)["random mixing of these numbers"]
    assert dashed.get_linestyle() == "--"
    kinds = mixture.frames[0].cells.kind
    a, b, n = (kinds == 0).sum(), (kinds == 1).sum(), len(kinds)
    np.testing.assert_allclose(dashed.get_ydata(), 100.0 * 2 * a * b / (n * (n - 1)))
    np.testing.assert_allclose(lower.get_lines()[0].get_ydata(), history["contacts"])


def test_contacts_at_one_moment_can_be_drawn():
    scene = mc.load_scene("sorting").with_changes({"initial.count": 1, "duration": "5 min"})
    result = mc.run(scene)
    rendered(result.plot.contacts())
    assert np.isnan(result.history["heterotypic_fraction"]).all()
    assert result.summary()["heterotypic_fraction"] is None


@pytest.mark.parametrize("name", ["contacts", "pull"])
def test_a_scene_without_them_has_nothing_to_draw(name):
    result = mc.run(mc.load_scene("settle").with_changes({"initial.count": 3, "duration": "60 s"}))
    with pytest.raises(ValueError, match="nothing to draw"):
        getattr(result.plot, name)()


# --- pull --------------------------------------------------------------------------------------


def test_pull_chart_follows_the_law_up_to_the_separation(doublet):
    figure = doublet.plot.pull()
    rendered(figure)
    (axes,) = figure.axes
    distance, force = lines(axes)["pull"].get_data()
    # slow against the relaxation of the pair: the pull is the attraction of the contact, which
    # the closed form gives without the package's own pair
    r = float(doublet.frames[0].cells.radius[0])
    a, b = (8 / 9) * np.sqrt(r / 2), np.sqrt(6 * np.pi * 0.1 * (8 / 9) * (r / 2) ** 1.5)
    h = 2 * r - distance
    settled = slice(5, -5)
    attraction = b * h**0.75 - a * h**1.5
    np.testing.assert_allclose(force[settled], attraction[settled], rtol=2e-3)
    (dashed,) = [line for line in axes.get_lines() if line.get_linestyle() == "--"]
    theory = 1.5 * np.pi * 0.1 * r / 2
    assert dashed.get_ydata()[0] == pytest.approx(theory, rel=1e-9)
    separation = doublet.summary()["separation"]["force"]
    (mark,) = [line for line in axes.get_lines() if line.get_marker() == "o"]
    assert mark.get_ydata()[0] == separation
    assert separation == pytest.approx(theory, rel=5e-3)


def test_pull_on_more_cells_is_over_their_diameter():
    scene = mc.load_scene("doublet").with_changes(
        {"initial.count": 4, "pull.force": "1 nN", "duration": "60 s"}
    )
    result = mc.run(scene)
    figure = result.plot.pull()
    rendered(figure)
    (axes,) = figure.axes
    assert axes.get_xlabel().startswith("diameter")
    np.testing.assert_allclose(lines(axes)["pull"].get_xdata(), result.history["diameter"])
    assert "not pulled apart" in " ".join(texts(figure))


@pytest.mark.parametrize(("law", "i", "j"), [("jkr", 4.0, 11.0), ("exact-jkr", 5.0, 5.0)])
def test_deepest_attraction_is_the_pull_off_of_jkr(law, i, j):
    scene = Scene.from_dict({**STICKY, "contact": {"law": law, "surface_energy": 0.07}})
    load, _ = pair_of(scene, 0, 0, i, j).deepest()
    assert load == pytest.approx(1.5 * np.pi * 0.07 * i * j / (i + j), rel=1e-9)


def test_bonds_shift_equilibrium_and_pull_off():
    """Hertz and bonds: E √r h^{3/2} = A h at rest, largest attraction (4/27) A³ / (E² r)."""
    scene = Scene.from_dict(
        {
            **STICKY,
            "contact": {"law": "hertz"},
            "adhesion": {"strength": 0.05},
            "types": {"a": {"receptor": 0.9, "ligand": 0.5}, "b": {"receptor": 0.2}},
        }
    )
    found = dict(type_pairs(scene, 10.0))
    assert list(found) == ["a-a", "a-b", "b-b"]
    for name, product in (("a-a", 0.9 * 0.5), ("a-b", 0.5 * 0.5 * 0.2)):
        slope = np.pi * 5.0 * 0.05 * product
        stiff = (8 / 9) * np.sqrt(5.0)
        pair = found[name]
        assert pair.equilibrium_overlap() == pytest.approx((slope / stiff) ** 2, rel=1e-9)
        load, overlap = pair.deepest()
        assert overlap == pytest.approx((2 * slope / (3 * stiff)) ** 2, rel=1e-5)
        assert load == pytest.approx(4 * slope**3 / (27 * stiff**2), rel=1e-9)
    assert found["b-b"].equilibrium_overlap() == 0.0
    assert found["b-b"].deepest()[0] == 0.0


# --- report, summary and folder ----------------------------------------------------------------


def test_report_of_the_doublet_has_the_force(doublet):
    text = " ".join(read(doublet.folder / "report.html").text)
    force = doublet.summary()["separation"]["force"]
    assert f"{force:.4g} nN" in text
    names = {entry.name for entry in doublet.folder.iterdir()}
    assert "pull.png" in names
    assert "contacts.png" not in names
    # averages over shells say nothing about two cells
    assert "profiles.png" not in names


def test_report_of_the_mixture_has_the_fraction_at_last(mixture):
    text = " ".join(read(mixture.folder / "report.html").text)
    fraction = 100.0 * mixture.history["heterotypic_fraction"]
    assert f"{fraction[-1]:.1f} %" in text
    assert "[types.cohesive.surface_energy]" in text
    assert "cohesive = 0.2" in text
    assert (mixture.folder / "contacts.png").is_file()
    summary = json.loads((mixture.folder / "summary.json").read_text())
    assert summary["heterotypic_fraction"] == mixture.history["heterotypic_fraction"][-1]
