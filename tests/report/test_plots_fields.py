"""Pictures and report of runs with several fields."""

import matplotlib as mpl
import numpy as np
import pytest
from synthetic import SCENE, ball, cells_at, growing_frames, history_of

import multicell as mc
from multicell.population import extents
from multicell.report.plots.run import PICTURES, Plots
from multicell.report.result import history_columns
from multicell.results.frame import Frame
from multicell.results.observable import TissueState
from multicell.results.summary import history_row
from multicell.scene.scene import Scene


def scene(geometry="box", **more):
    field = {"geometry": geometry, "spacing": "15 um", "height": "10 um"}
    return Scene.from_dict(
        {
            "title": "Three fields",
            "duration": "1 h",
            "coupling_step": "15 min",
            "output": {"every": "15 min"},
            "initial": {"count": 120},
            "growth": {},
            "nutrients": {
                "oxygen": {**field, "boundary": 0.07, "hypoxia": 0.06, "uptake": 40.0,
                           "media": [["30 min", "0.065 mM"]]},
                "glucose": {**field, "boundary": 5.5, "diffusion": 200.0, "uptake": 60.0},
                "lactate": {**field, "boundary": 0.0, "diffusion": 500.0, "uptake": 0.0,
                            "secretion_from": {"glucose": 2.0}},
            },
            **more,
        }
    )  # fmt: skip


@pytest.fixture(scope="module", params=["box", "radial", "plane"])
def result(request):
    flat = {"dimensions": 2} if request.param == "plane" else {}
    chosen = scene("box" if flat else request.param, **flat)
    return mc.run(chosen)


def titles(figure):
    return [axes.get_title(loc="left") for axes in figure.axes]


def test_profiles_have_a_panel_for_each_field_in_its_own_range(result):
    figure = result.plot.profiles()
    assert titles(figure) == ["Oxygen", "Glucose", "Lactate", "Cells by state"]
    for axes, name in zip(figure.axes, result.scene.nutrients, strict=False):
        top = result.frames[-1].concentrations[name].max()
        assert 0.5 * top < axes.get_ylim()[1] < 3.0 * top


def test_every_field_has_a_map_over_its_own_values(result):
    figure = result.plot.fields()
    assert titles(figure)[:3] == ["Oxygen (mM)", "Glucose (mM)", "Lactate (mM)"]
    for axes, name in zip(figure.axes[:3], result.scene.nutrients, strict=True):
        (image,) = axes.images
        values = result.frames[-1].fields[name].values
        assert image.get_clim()[0] <= values.min() + 0.05 * np.ptp(values)
        assert image.get_clim()[1] >= values.max() - 0.05 * np.ptp(values)


def test_history_and_summary_tell_the_hypoxic_radius(result):
    """Without cells between, it lies between those below the threshold and those above."""
    cells, low = result.frames[-1].cells, result.frames[-1].concentrations["oxygen"] < 0.06
    apart = np.sort(extents.distances(cells, extents.centre(cells, result.scene.dimensions)))
    count = int(low.sum())
    expected = result.history["hypoxic_radius_oxygen"][-1]
    assert apart[count - 5] - 5.0 < expected < apart[min(count + 5, len(cells) - 1)] + 5.0
    assert result.summary()["hypoxic_radius"] == {"oxygen": expected}
    assert "hypoxic_radius_glucose" not in result.history


@pytest.mark.parametrize("result", ["box"], indirect=True)
def test_growth_marks_the_switch_of_the_medium(result):
    figure = result.plot.growth()
    texts = [text.get_text().strip() for text in figure.findobj(mpl.text.Text)]
    assert "oxygen 0.065 mM" in texts


@pytest.mark.parametrize("result", ["box"], indirect=True)
def test_report_has_one_ledger_with_a_column_for_each_field(result, tmp_path, monkeypatch):
    only = {"fields": PICTURES["fields"]}  # the others are drawn elsewhere
    monkeypatch.setattr("multicell.report.page.PICTURES", only)
    page = result.report(tmp_path).read_text(encoding="utf-8")
    assert "<td></td><th>oxygen</th><th>glucose</th><th>lactate</th>" in page
    ledger = result.summary()["ledger"].values()
    for entry in ("inflow", "uptake", "secreted", "decayed", "relaid", "stored", "remainder"):
        told = any(account[entry] != 0.0 for account in ledger if isinstance(account, dict))
        assert (f"<tr><th>{entry} (amol)</th>" in page) is told
    assert (tmp_path / "fields.png").is_file()


@pytest.mark.parametrize("threshold", [None, "0.02 mM"])
def test_cells_below_the_threshold_make_the_hypoxic_ball(threshold):
    """10 mmHg at 37 degrees are 0.01403 mM, whatever makes cells rest."""
    position = ball(4000, jitter=0.0)
    apart, level = np.linalg.norm(position, axis=1), 0.02 if threshold else 0.01403
    changes = {"nutrients.oxygen.quiescence": "0.06 mM", "nutrients.oxygen.hypoxia": threshold}
    scene = mc.load_scene("spheroid").with_changes(changes)
    found = [
        history_row(TissueState(Frame(0.0, 0, cells_at(position), {"oxygen": levels}), scene))
        for levels in (
            np.where(apart < 50.0, 0.99, 1.01) * level,
            np.full(len(apart), 1.01 * level),
        )
    ]
    got, none = (row["hypoxic_radius_oxygen"] for row in found)
    assert got == pytest.approx(50.0, rel=0.02)
    assert none == 0.0


def test_a_frame_without_fields_has_no_map():
    frames = growing_frames(count=2, last=50)
    bare = type(frames[0])(0.0, 0, frames[0].cells)
    with pytest.raises(ValueError, match="no fields"):
        Plots([bare], {}, SCENE).fields()
    assert len(Plots(frames, history_columns(history_of(frames)), SCENE).growth().axes) == 3


def draws_drug(left):
    scene = mc.load_scene("growth").with_changes(
        {"initial.count": 30, "duration": "1 h", "coupling_step": "20 min",
         "nutrients.drug": {"boundary": 0, "media": [["20 min", 1.0], ["40 min", left]],
                            "geometry": "radial", "uptake": 0}}
    )  # fmt: skip
    figure = mc.run(scene).plot.section()
    return any(text.get_text().startswith("Drug") for text in figure.texts)


def test_what_is_left_of_a_field_is_drawn_where_it_is_more_than_rounding():
    assert draws_drug(1e-6)
    assert not draws_drug(1e-11)
