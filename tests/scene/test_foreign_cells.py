"""Cells from tables of other programs: files made after their documentation start runs."""

from __future__ import annotations

import io

import numpy as np
import pytest

import multicell as mc
from multicell.errors import DataError, SceneError

PLACES = np.array([[120.0, 80.0, 10.0], [131.5, 80.0, 10.0], [120.0, 95.0, 22.0]])
RADII = np.array([4.5, 4.75, 4.25])


def lines(head, *rows):
    return "\n".join([head, *(",".join(map(str, row)) for row in rows)]) + "\n"


def trackmate(unit="micron", scale=1.0, frames=(0,), below=True):
    head = (
        "LABEL,ID,TRACK_ID,QUALITY,POSITION_X,POSITION_Y,POSITION_Z,POSITION_T,FRAME,RADIUS,"
        "VISIBILITY,MEAN_INTENSITY_CH1"
    )
    more = (
        "\nLabel,Spot ID,Track ID,Quality,X,Y,Z,T,Frame,Radius,Visibility,Mean intensity ch1"
        "\nLabel,Spot ID,Track ID,Quality,X,Y,Z,T,Frame,R,Visibility,Mean ch1"
        f"\n,,,(quality),({unit}),({unit}),({unit}),(sec),,({unit}),,(counts)"
    )
    rows = [
        (f"ID{k}", k, 0, 3.2, *((p + 5 * f) / scale), 600.0 * f, f, r / scale, 1, 77)
        for f in frames
        for k, (p, r) in enumerate(zip(PLACES, RADII, strict=True))
    ]
    return lines(head + (more if below else ""), *rows)


def imaris(unit="um"):
    rows = [(*p, unit, "Spot", "Position", 1, k, "") for k, p in enumerate(PLACES)]
    head = "Position X,Position Y,Position Z,Unit,Category,Collection,Time,ID,"
    return lines(f"\n Position\n==================== \n{head}", *rows)


def volume(r, size=0.5):
    return 4.0 / 3.0 * np.pi * r**3 / size**3


def cellprofiler(size=0.5):
    head = (
        "ImageNumber,ObjectNumber,AreaShape_Volume,Location_Center_X,Location_Center_Y,"
        "Location_Center_Z,Intensity_MeanIntensity_DNA"
    )
    rows = [(1, k + 1, volume(r, size), *(p / size), 0.2)
            for k, (p, r) in enumerate(zip(PLACES, RADII, strict=True))]  # fmt: skip
    return lines(head, *rows)


def regions(size=0.5):
    rows = [(k, k + 1, *(p[::-1] / size), volume(r, size))
            for k, (p, r) in enumerate(zip(PLACES, RADII, strict=True))]  # fmt: skip
    return lines(",label,centroid-0,centroid-1,centroid-2,area", *rows)


def qupath():
    head = "Image\tObject ID\tName\tClassification\tCentroid X µm\tCentroid Y µm\tCell: Area µm^2"
    rows = [f"a.tif\tx-{k}\t\tTumor\t{p[0]}\t{p[1]}\t{np.pi * r**2}"
            for k, (p, r) in enumerate(zip(PLACES, RADII, strict=True))]  # fmt: skip
    return "\n".join([head, *rows]) + "\n"


def objects_counter(size=0.5):
    head = " ,Volume (micron^3),Surface (micron^2),Nb of obj. voxels,Nb of surf. voxels,X,Y,Z"
    rows = [(k + 1, volume(r, 1), 1, volume(r, size), 9, *(p / size))
            for k, (p, r) in enumerate(zip(PLACES, RADII, strict=True))]  # fmt: skip
    return lines(head, *rows)


def morpholibj():
    rows = [(k + 1, volume(r, 1), *p) for k, (p, r) in enumerate(zip(PLACES, RADII, strict=True))]
    return lines("Label,Volume,Centroid.X,Centroid.Y,Centroid.Z", *rows)


def imagej():
    rows = [(k + 1, np.pi * r**2, 100, *p[:2])
            for k, (p, r) in enumerate(zip(PLACES, RADII, strict=True))]  # fmt: skip
    return lines(" ,Area,Mean,X,Y", *rows)


def ilastik(size=0.5):
    head = (
        "object_id,timestep,labelimage_oid,User Label,Predicted Class,"
        "Center_of_the_object_0,Center_of_the_object_1,Center_of_the_object_2"
    )
    return lines(head, *((k, 0, k + 1, 0, "live", *(p / size)) for k, p in enumerate(PLACES)))


def napari(size=0.5):
    return lines("index,axis-0,axis-1,axis-2", *((k, *(p[::-1] / size))
                                                 for k, p in enumerate(PLACES)))  # fmt: skip


def physicell():
    return lines("x,y,z,type,volume", *((*p, "default", volume(r, 1))
                                        for p, r in zip(PLACES, RADII, strict=True)))  # fmt: skip


def german():
    rows = ";".join(("Pos X", "Pos Y", "Pos Z", "R", "Klasse")) + "\n"
    for p, r in zip(PLACES, RADII, strict=True):
        rows += ";".join(f"{x:.2f}".replace(".", ",") for x in (*p, r)) + ";weich\n"
    return rows


NAMED = 'x="Pos X" um, y="Pos Y" um, z="Pos Z" um, radius=R um, type=Klasse'
PIXEL = "pixel=0.5 um"

FILES = {
    "TrackMate": (trackmate(), "", "TrackMate spots: 3 cells; µm"),
    "TrackMate, µm": (trackmate("µm"), "", "TrackMate spots"),
    "TrackMate in pixels": (trackmate("pixel", 0.5), PIXEL, "TrackMate spots"),
    "TrackMate 6": (trackmate(below=False, scale=0.5), PIXEL, "TrackMate spots"),
    "TrackMate film": (trackmate(frames=(0, 1, 2)), "", "TrackMate spots: 3 cells of frame 0; µm"),
    "Imaris": (imaris(), "", "positions of Imaris"),
    "CellProfiler": (cellprofiler(), PIXEL, "objects of CellProfiler"),
    "scikit-image": (regions(), PIXEL, "regions of scikit-image"),
    "QuPath": (qupath(), "", "detections of QuPath: 3 cells; µm; columns between tabs"),
    "3D Objects Counter": (objects_counter(), PIXEL, "3D Objects Counter"),
    "MorphoLibJ": (morpholibj(), "pixel=1 um", "MorphoLibJ"),
    "ImageJ": (imagej(), "pixel=1 um", "measurements of ImageJ"),
    "ilastik": (ilastik(), PIXEL, "objects of ilastik"),
    "napari": (napari(), PIXEL, "points of napari"),
    "PhysiCell": (physicell(), "", "cells of PhysiCell"),
    "named": (german(), NAMED, "columns between semicolons, decimal commas"),
}
TYPES = {name: {} for name in ("Tumor", "default", "live", "weich")}
FLAT = ("QuPath", "ImageJ")
WITHOUT_RADII = ("Imaris", "ilastik", "napari")


def scene_of(path, columns="", dimensions=3, **more):
    table = {"file": str(path), "columns": columns, **more}
    scene = mc.Scene(duration="1 h", dimensions=dimensions, types=TYPES)
    return scene.with_changes({"initial.cells": table})


@pytest.mark.parametrize("name", FILES)
def test_a_table_of_a_known_program_gives_places_and_radii(name, tmp_path):
    text, columns, said = FILES[name]
    path = tmp_path / "cells.txt"
    path.write_bytes(text.encode("cp1252" if name == "named" else "utf-8"))
    table = scene_of(path, columns, dimensions=2 if name in FLAT else 3).initial.cells
    given = table.given.columns
    for k, axis in enumerate("xy" if name in FLAT else "xyz"):
        np.testing.assert_allclose(given[f"position_{axis}"], PLACES[:, k], rtol=1e-12)
    if name not in WITHOUT_RADII:
        np.testing.assert_allclose(given["radius"], RADII, rtol=1e-12)
    assert said in table.said


def test_a_frame_is_chosen_by_number_or_time(tmp_path):
    path = tmp_path / "spots.csv"
    path.write_text(trackmate(frames=(0, 1, 2)))
    for choice in ({"frame": 2}, {"time": "19 min"}):
        table = scene_of(path, **choice).initial.cells
        np.testing.assert_allclose(table.given.columns["position_x"], PLACES[:, 0] + 10.0)
    with pytest.raises(
        SceneError, match=r"frame: is 7, which spots.csv does not have\. It has frames from 0 to 2"
    ):
        scene_of(path, frame=7)


def test_the_folder_of_a_run_holds_the_cells_that_were_read(tmp_path):
    path = tmp_path / "spots.csv"
    path.write_text(trackmate(frames=(0, 1)))
    scene = scene_of(path, frame=1).with_changes({"cells.division_radius": "6 um"})
    run = mc.run(scene, output=tmp_path / "run", report=False)
    path.unlink()
    again = mc.load_scene(tmp_path / "run" / "scene.toml")
    assert again.initial.cells.columns == ""
    first = run.frames[0].cells.position
    np.testing.assert_array_equal(mc.Simulation(again).cells.position, first)


def test_a_simulation_takes_a_table_with_names_of_its_columns(tmp_path):
    path = tmp_path / "cells.csv"
    path.write_bytes(german().encode("cp1252"))
    scene = mc.Scene(duration="1 h", types=TYPES)
    simulation = mc.Simulation(scene, cells={"file": path, "columns": NAMED})
    np.testing.assert_allclose(np.sort(simulation.cells.radius), np.sort(RADII))
    assert set(simulation.cells.kind) == {list(TYPES).index("weich")}


@pytest.mark.parametrize(
    ("text", "columns", "said"),
    [
        (trackmate("pixel"), "", r"lengths whose unit it does not state.*pixel=0\.65 um"),
        (imaris("um").replace("22.0,um", "22.0,mm"), "", "has several units: mm, um"),
        ("X,Y,Z\n1,2,3\n", "", r"has no unit.*x=X um, y=Y um, z=Z um"),
        ("X;Y;Z\n1;2;3\n", "x=X um, y=B um", "is 'B um', which cells.csv has no column for"),
        ("X,Y\n1,2\n", "x=X um, x=Y um", "name 'x' twice"),
        ("X,Y\n1,2\n", "x=X um, Y", "have 'Y', which is not NAME=TITLE"),
        ("X,Y\n1,2\n1,2\n", "x=X um, y=Y um", "line 3.*is at the place of line 2"),
        ("X,Y\n1,2\nnan,2\n", "x=X um, y=Y um", "line 3.*is empty or NaN"),
        ("X,Y\n", "x=X um, y=Y um", "holds no rows"),
        ("X,Y\n1,2\n1,b\n", "x=X 2 um, y=Y 2 um", "line 3, 'Y': is 'b', must be a number"),
        (cellprofiler(), "pixel=2 s", "pixel: is '2 s', must be a length"),
    ],
)
def test_what_cannot_be_read_is_refused_with_what_to_write(text, columns, said, tmp_path):
    path = tmp_path / "cells.csv"
    path.write_text(text)
    with pytest.raises((DataError, SceneError), match=said):
        scene_of(path, columns)


def workbook(rows, title="Cells"):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.title = title
    for row in rows:
        book.active.append(row)
    content = io.BytesIO()
    book.save(content)
    return content.getvalue()


def test_a_sheet_is_a_table(tmp_path):
    path = tmp_path / "cells.xlsx"
    path.write_bytes(workbook([("X", "Y", None), *PLACES[:, :2].tolist()]))
    given = scene_of(path, "x=X um, y=Y um", dimensions=2).initial.cells.given.columns
    np.testing.assert_array_equal(given["position_y"], PLACES[:, 1])


def test_a_formula_without_a_value_is_refused_by_its_cell(tmp_path):
    path = tmp_path / "cells.xlsx"
    path.write_bytes(workbook([("X", "Y"), (1, "=A2*2")]))
    with pytest.raises(DataError, match=r"sheet 'Cells', row 2, B2: is the formula '=A2\*2'"):
        scene_of(path, "x=X um, y=Y um")
    path.write_bytes(b"PK\x03\x04 and nothing more")
    with pytest.raises(DataError, match="is no Excel workbook"):
        scene_of(path, "x=X um, y=Y um")
