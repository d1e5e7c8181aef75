"""Every number that a run hands out has a unit, or is declared to have none."""

from __future__ import annotations

import csv
import importlib
import json
import re
from dataclasses import replace
from fnmatch import fnmatchcase
from numbers import Number
from pathlib import Path

import h5py
import numpy as np
import pytest

import multicell as mc
from multicell.cells import State
from multicell.results.measures import OBSERVABLES
from multicell.results.quantities import ABSENT_WORDS, QUANTITY_UNITS, unit_of, units_of
from multicell.units import to_base


def _eaten(t, y, u, p, out):
    out[0] = p[0] * u[0] * y[0]


@mc.network(states={"E": 1.0}, inputs={"food": 0.0}, parameters={"k": 40.0},
            observed=("eaten",), observe=_eaten)  # fmt: skip
def eater(t, y, u, p, out):
    """A species that food makes."""
    out[0] = 1e-3 * (u[0] - y[0])


PHASES = {"G1": {"duration": "3 h"}, "S": {"duration": "3 h"}, "G2": {"duration": "2 h"},
          "M": {"duration": "1 h", "grows": False}}  # fmt: skip
SHORT = {"duration": "30 min", "output": {"every": "10 min"}}
SCENES = {
    "all of biology and nutrients": {
        **SHORT, "initial": {"count": 60, "stage": "asynchronous"},
        "growth": {"phases": PHASES, "critical_pressure": 0.1, "ki67_decay": "1 h"},
        "death": {"apoptosis_rate": 1e-4, "necrosis_rate": 1e-3, "inflow": True},
        "surface": {"tension": 0.1},
        "types": {"a": {"receptor": 1.0, "ligand": 1.0}, "b": {"young": 2.0}},
        "adhesion": {"strength": 0.01}, "friction": {},
        "motility": {}, "chemotaxis": {"oxygen": {}},
        "nutrients": {
            "oxygen": {"quiescence": 0.068, "necrosis": 0.01, "geometry": "radial", "layer": 40.0,
                       "sides": {}},
            "glucose": {"finite_medium": {"volume": 1e9}},
            "waste_2": {"uptake": 0.0, "secretion": 3.0, "boundary": 0.0, "regime": "transient"},
        },
        "reactions": {"breakdown": {"rate": 1e-4, "consumes": {"waste_2": 1}}},
    },
    "a release": {
        **SHORT, "initial": {"count": 3},
        "nutrients": {"drug": {"regime": "transient", "uptake": 0.0, "boundary": 0.0,
                               "release": {"shot": {"amount": 5.0, "place": [0.0, 0.0, 0.0]}}}},
    },
    "a plane with a field": {
        **SHORT, "dimensions": 2, "initial": {"count": 30},
        "growth": {"critical_pressure": 0.02}, "death": {},
        "radiation": {"beam": {"dose": 1.0, "start": "5 min", "alpha": 0.1, "oxygen": "oxygen",
                               "mitotic_divisions": 1}},
        "nutrients": {
            "oxygen": {"quiescence": 0.06, "necrosis": 0.05, "uptake": 500.0, "height": 10.0},
            "drug": {"boundary": 0.01, "uptake": 1.0, "height": 10.0},
        },
        "integrator": {"method": "auto"},
    },
    "lengths of steps that the run chooses": {
        **SHORT, "initial": {"count": 8}, "growth": {"critical_pressure": 0.1},
        "coupling_step": "auto",
    },
    "networks that exchange": {
        **SHORT, "initial": {"count": 8}, "growth": {},
        "nutrients": {"oxygen": {"boundary": 0.2, "spacing": 20.0}},
        "networks": {"eater": {"network": eater.name, "inputs": {"food": "oxygen"},
                               "fluxes": {"oxygen": "uptake: eaten"}}},
    },
    "a pull with memory": {
        "duration": "3 min", "coupling_step": "10 s", "initial": {"count": 2, "spacing": 0.95},
        "contact": {"law": "exact-jkr"}, "pull": {"force": 2.0, "rate": 0.01},
        "drag": {"viscosity": 0.5},
    },
    "driven cells": {
        "duration": "2 min", "coupling_step": "30 s", "initial": {"count": 3},
        "motions": {"plate": {"cells": [0], "velocity": [0.001, 0.0, 0.0]}},
    },
    "bare mechanics": {
        "duration": "80 min", "coupling_step": "1 min", "initial": {"count": 3},
        "integrator": {"method": "euler"},
        "domain": {axis: [-60.0, 60.0] for axis in "xyz"},
    },
    "cells in a gel": {
        "duration": "20 min", "coupling_step": "10 min", "initial": {"count": 3},
        "domain": {"shape": "sphere", "radius": 60.0, "stiffness": 10.0},
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("units")
    return {
        name: mc.run(mc.Scene.from_dict(entries), output=folder / name, report=False)
        for name, entries in SCENES.items()
    }


@pytest.fixture(params=SCENES)
def run(request, runs):
    return runs[request.param]


def leaves(entries, prefix=""):
    """Give every number of a summary by its dotted name, those that do not exist too."""
    for name, value in entries.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{prefix}{name}.")
        elif value is None or (isinstance(value, Number) and not isinstance(value, bool)):
            yield f"{prefix}{name}", value


def test_every_number_of_history_summary_and_tables_has_a_unit(run, tmp_path):
    for name in run.history:
        unit_of(name)
    found = dict(leaves(run.summary()))
    assert len(found) > 30
    units = run.summary()["units"]
    for name in found:
        assert units.get(name, "") == unit_of(name)
    assert set(units) <= set(found)
    on_disk = json.loads((run.folder / "summary.json").read_text(encoding="utf-8"))
    assert on_disk["units"] == units == units_of(run.summary())
    for path in mc.export(run, tmp_path):
        with path.open(encoding="utf-8", newline="") as file:
            titles = next(csv.reader(file), [])
        assert titles
        for title in titles:
            assert_titled(path.stem, title)


def assert_titled(table, title):
    """Check that the title of a column is a declared name with its unit behind it."""
    for cut in range(len(title), 0, -1):
        name = re.sub("_[xyz]$", "", title[:cut])
        try:
            unit = unit_of(name if table == "history" else f"{table}.{name}")
        except KeyError:
            continue
        behind = unit.replace("^", "").replace("/", "_per_").replace(" ", "_")
        if title == (f"{title[:cut]}_{behind}" if unit else title[:cut]):
            return
    pytest.fail(f"{table}: no unit for {title}")


def test_every_history_column_has_its_unit_in_hdf5(run):
    with h5py.File(run.folder / "frames.h5", "r") as file:
        units = file["history"].attrs["unit"]
        seen = dict(zip(file["history"].dtype.names, units, strict=True))
    assert seen == {name: unit_of(name) for name in run.history}


def test_the_scenes_have_all_that_is_declared(runs):
    """A name that no run hands out is a leftover."""
    given = set()
    for result in runs.values():
        given |= set(result.history) | {name for name, _ in leaves(result.summary())}
    # of scenes with types, and of commands
    given |= {"heterotypic_fraction", "wall.startup"}
    for declared in QUANTITY_UNITS:
        if declared.startswith(("cells.", "contacts.", "lineage.", "integrator.steps_")):
            continue
        pattern = "[^.]+".join(map(re.escape, declared.split("*")))
        assert any(re.fullmatch(pattern, name) for name in given), declared


STATES = {
    "no cells": lambda cells: cells.take(np.arange(0)),
    "two cells in contact": lambda cells: cells.take(np.arange(2)),
    "cells out of touch": lambda cells: apart(cells, 1.6),
    "all dead": lambda cells: replace(cells, state=np.full_like(cells.state, State.NECROTIC)),
}


def apart(cells, diameters):
    """Return cells on a lattice; on a line their field has many nodes."""
    side = int(np.ceil(np.cbrt(len(cells))))
    place = np.stack(np.unravel_index(np.arange(len(cells)), (side,) * 3), axis=1)
    return replace(cells, position=2.0 * cells.radius.max(initial=1.0) * diameters * place)


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize(
    "name", [name for name in SCENES if name not in ("driven cells", "a release")]
)
def test_every_number_is_finite_in_every_state_or_documented_as_absent(name, state):
    scene = mc.Scene.from_dict(SCENES[name])
    cells = STATES[state](mc.Simulation(scene).cells)
    simulation = mc.Simulation(scene, cells=cells)
    for _ in range(2):
        row, summary = simulation.history_row(), simulation.summary()
        absent = {column for column, value in row.items() if np.isnan(value)}
        paths = dict(leaves(summary))
        missing = {path for path, value in paths.items() if value is None}
        assert absent & set(paths) == missing & set(row)
        absent |= missing  # the summary has more than the history
        assert not [x for x in absent if not any(fnmatchcase(x, known) for known in ABSENT_WORDS)]
        known = [value for _, value in leaves(summary) if value is not None]
        known += [value for column, value in row.items() if column not in absent]
        assert np.isfinite(known).all()
        if not simulation.finished:
            simulation.step()


def test_what_may_be_absent_is_documented_with_its_case(monkeypatch):
    docs = Path(__file__).parents[2] / "docs"
    page = (docs / "theory/measured.md").read_text("utf-8")
    assert "{observables}" in page
    monkeypatch.syspath_prepend(str(docs / "extensions"))
    pytest.importorskip("sphinx", reason="pages are built with multicell[docs]")
    page += importlib.import_module("scene_keys").observables()
    names = {
        one.entry: one.name
        for one in OBSERVABLES
        if one.name.startswith(("network_", "hypoxic_radius_"))
    }
    for name, when in ABSENT_WORDS.items():
        # some entries of the summary stand on the page by their name in the history
        shown = names.get(name, name).replace("*", "<field>")
        (line,) = [line for line in page.splitlines() if line.startswith(f"| `{shown}` ")]
        assert f"absent {when}" in line


def test_units_are_those_that_the_scene_files_know():
    for unit in {unit_of(name.replace("*", "x")) for name in QUANTITY_UNITS} - {"", "um^3", "amol"}:
        assert to_base(f"1 {unit}", unit) == 1.0


@pytest.mark.parametrize("name", ["", "hypoxic_radius", "cells.height", "ledger.a.b.inflow"])
def test_an_unknown_name_is_refused(name):
    with pytest.raises(KeyError, match="no unit is declared"):
        unit_of(name)


def test_an_undeclared_number_is_refused_and_texts_have_no_unit():
    with pytest.raises(KeyError, match=r"fields.oxygen.error"):
        units_of({"fields": {"oxygen": {"error": 1.0}}})
    assert units_of({"title": "x", "notes": ["a"], "interrupted": True, "cells": 3}) == {}
    assert units_of({"viable_rim": None, "ledger": {"o_2": {"inflow": 0.0}}}) == {
        "viable_rim": "um", "ledger.o_2.inflow": "amol"}  # fmt: skip
    assert unit_of("hypoxic_radius_oxygen") == unit_of("hypoxic_radius.oxygen") == "um"
    assert unit_of("cells.concentration_oxygen") == "mM"
    assert unit_of("cells.position") == "um"


def test_the_report_names_units(runs, tmp_path, monkeypatch):
    monkeypatch.setattr("multicell.report.page.PICTURES", {})
    page = runs["a plane with a field"].report(tmp_path).read_text(encoding="utf-8")
    for words in ("spacing (µm)", "estimated error at the cells (mM)", "inflow (amol)",
                  "<th>relative remainder</th>"):  # fmt: skip
        assert words in page
