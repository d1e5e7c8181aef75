"""Every picture that the package draws: no text is clipped, covered, or smaller than 7 pt."""

import ast
import itertools
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from cheap_fits import MATRIX, fitted, linear
from picture_texts import check_texts
from study_tables import AXES, grid
from synthetic import SCENE, growing_frames, history_of, spheroid
from two_cells import ladders, result_of

import multicell as mc
from multicell.calibration.sensitivity.analysis import sample_sensitivity as indices_of
from multicell.calibration.sensitivity.indices import sample
from multicell.calibration.sensitivity.result import SobolIndices
from multicell.comparison.stability_limits.failure_map import FailureMap
from multicell.comparison.stability_limits.failures import STEP_ENDS
from multicell.report.plots.colouring import colouring
from multicell.report.plots.run import Plots
from multicell.report.plots.space import View, film_picture, room
from multicell.report.result import history_columns
from multicell.studies.axes import parse_ranges
from multicell.studies.pictures import StudyPlots
from multicell.studies.runs import StudyRun
from multicell.studies.spheroids import spheroids

FIELD = {"geometry": "box", "spacing": "15 um", "boundary": 0.07, "quiescence": 0.06, "uptake": 40}


@cache
def run(name, **changes):
    return mc.run(mc.load_scene(name).with_changes({"duration": "30 min", **dict(changes)}))


@cache
def grown():
    frames = growing_frames(count=6, last=1500)
    return Plots(frames, history_columns(history_of(frames)), SCENE)


@cache
def fields(count):
    """Return a run with so many fields, the first of which is renewed."""
    names = ("oxygen", "glucose", "lactate", "a_drug_of_a_long_name", "glutamine")[:count]
    nutrients = {name: FIELD | {"boundary": 0.07 * 20.0**k} for k, name in enumerate(names)}
    nutrients["oxygen"]["media"] = [["15 min", "0.065 mM"]]
    return mc.run(
        mc.Scene.from_dict(
            {"title": "Several fields", "duration": "30 min", "coupling_step": "15 min",
             "initial": {"count": 60}, "growth": {}, "nutrients": nutrients}
        )
    )  # fmt: skip


@cache
def study(*names):
    return StudyPlots(grid(*names, seeds=2), "A study of a spheroid")


@cache
def fit():
    values = np.array(MATRIX) @ [0.4, 0.6]
    return fitted(linear(MATRIX, values, np.full(4, 0.05))).plot


@cache
def sensitivity():
    keys = ("cells.division_radius", "cells.young", "drag.viscosity", "cells.poisson")
    ranges = parse_ranges(dict(zip(keys, ("5:8 um", "0.5:2 kPa", "0.1:10 kPa s", "0.2:0.4"),
                                   strict=True)), SCENE)  # fmt: skip
    shares = sample([free.name for free in ranges], 8)
    values = shares @ [1.0, 3.0, 0.2, 0.0]
    return indices_of(SCENE, ranges, range(2), {"diameter": np.stack(2 * [values], 1)})


@cache
def sobol():
    rows = [
        {"observable": "diameter", "unit": "um", "parameter": name, "key": f"cells.{name}",
         "low": 0.5, "high": 2.0, "parameter_unit": "kPa", "S1": first, "S1_conf": 0.04,
         "ST": first + 0.1, "ST_conf": 0.05, "noise": 0.02}
        for name, first in (("young", 0.1), ("division_radius", 0.6), ("poisson", 0.0))
    ]  # fmt: skip
    return SobolIndices(SCENE, (), 256, (0, 1), rows, [], {})


@cache
def measured():
    table = {"Time (h)": [0.1, 0.25, 0.4], "Diameter (µm)": [45.0, 46.0, 44.0], "SD": [1.0] * 3}
    return run("settle", **{"initial.count": 20}).compare_with(table)


@cache
def comparison(count, failed=True):
    names = [f"method-{k}" for k in range(count)]
    lost = [("method-0", 1e-6), ("method-1", 1e5), ("method-1", 2.0)] if failed else []
    return result_of(ladders(names), lost)


def two_drugs():
    side = np.concatenate([[0.0], np.geomspace(0.1, 10.0, 5)])
    a, b = (x.ravel() for x in np.meshgrid(side, side, indexing="ij"))
    return {"dose A / uM": a, "dose B / nM": b, "response": 400.0 / (1.0 + a) / (1.0 + b)}


def tissues():
    """Return the picture of the tissues of a study, of three points of which one is not done."""
    levels = AXES["oxygen.boundary"][0]
    points = [{"oxygen.boundary": level, "seed": 1} for level in levels]
    runs = [StudyRun(f"run-{k}", SCENE, point, 1.0) for k, point in enumerate(points)]
    found = [(run, spheroid(100 + 100 * k)) for k, run in enumerate(runs[:2])]
    return spheroids(grid("oxygen.boundary", seeds=2), "A study of a spheroid", found, 3)


def film(frame):
    return film_picture(frame, SCENE, colouring(frame, SCENE, None, {}), View(), room(frame))


FEW = mc.load_scene("settle").with_changes({"initial.count": 12})
DOUBLET = {"pull.force": "2.25 nN", "output.every": "10 s", "coupling_step": "2 s"}


def failures(states, methods):
    """Draw a map with all kinds of ends."""
    kinds, numbers = list(STEP_ENDS), itertools.count()
    rows = [
        {
            "state": f"exact-jkr at {s} h",
            "method": f"rk4-adaptive-{m}",
            "control": "tolerance",
            "setting": atol,
            "kind": kinds[next(numbers) % len(kinds)],
            "ratio": 10.0 ** (m - 4),
            "null_ratio": 1234.0,
            "words": "",
        }
        for s in range(states)
        for m in range(methods)
        for atol in (0.001, 0.01, 0.1)
    ]
    return FailureMap(FEW, rows, {}).figure()


PICTURES = {
    "growth": [lambda: grown().growth(), lambda: fields(3).plot.growth()],
    "motion": [lambda: run("settle", **{"initial.count": 20}).plot.growth()],
    "section": [lambda: grown().section(), lambda: grown().section(colour="pressure", plane="x"),
                lambda: run("sorting", **{"initial.count": 40}).plot.section()],
    "profiles": [lambda: grown().profiles(), lambda: fields(5).plot.profiles(),
                 lambda: run("sorting", **{"initial.count": 40}).plot.profiles()],
    "field_maps": [lambda: fields(3).plot.fields(), lambda: fields(5).plot.fields()],
    "space": [lambda: Plots([spheroid(300)], {}, SCENE).space()],
    "film_picture": [lambda: film(spheroid(300))],
    "contacts": [lambda: run("sorting", **{"initial.count": 40}).plot.contacts()],
    "pull": [lambda: run("doublet", **DOUBLET, duration="40 s").plot.pull()],
    "response_curves": [lambda: fields(3).plot.responses()],
    "overlay": [lambda: run("settle", **{"initial.count": 20}).plot.quantity("diameter")],
    "response": [lambda: study("oxygen.boundary").response("cells"),
                 lambda: study(*AXES).response("diameter")],
    "heatmap": [lambda: study("oxygen.boundary", "glucose.boundary").heatmap("viable_rim")],
    "curves": [lambda: study("oxygen.boundary").curves("diameter"),
               lambda: study(*AXES).curves("diameter")],
    "workprecision": [lambda: comparison(3, failed=False).figure(),
                      lambda: comparison(20).figure()],
    "spheroids": [tissues],
    "stability_map": [lambda: mc.stability(FEW, ["euler"], threads=1).figure()],
    "failure_figure": [lambda: failures(2, 3), lambda: failures(6, 14)],
    "indices": [lambda: sensitivity().plot("diameter")],
    "data": [lambda: fit().data()],
    "parameters": [lambda: fit().parameters()],
    "profile": [lambda: fit().profile()],
    "deviations": [lambda: fit().deviations()],
    "sobol_bars": [lambda: sobol().plot()],
    "compared": [lambda: measured().plot()],
    "draw": [lambda: mc.dose_response(data=two_drugs()).plot()],
}  # fmt: skip
"""Ways to draw by the name of the function that draws."""


def drawing_functions():
    """Return the names of all functions of the package that draw a picture."""
    found = []
    for path in sorted((Path(mc.__file__).parent).rglob("*.py")):
        text = path.read_text("utf-8")
        for node in ast.walk(ast.parse(text)) if "styled" in text else ():
            if isinstance(node, ast.FunctionDef) and any(
                ast.unparse(mark).rpartition(".")[2] == "styled" for mark in node.decorator_list
            ):
                found.append(node.name)
    return found


def test_there_is_a_case_for_every_picture():
    found = drawing_functions()
    assert len(found) > 15
    assert sorted(found) == sorted(PICTURES)


@pytest.mark.parametrize(
    ("name", "number"), [(name, k) for name, ways in PICTURES.items() for k in range(len(ways))]
)
def test_no_text_is_clipped_covered_or_tiny(name, number):
    check_texts(PICTURES[name][number]())
