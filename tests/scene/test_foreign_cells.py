"""Cells from tables of other programs: files made after their documentation start runs."""

from __future__ import annotations

import io
import tracemalloc

import numpy as np
import pytest

import multicell as mc
from multicell.errors import DataError, SceneError
from multicell.scene.foreign_cells import CellsChoice, foreign_cells

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


PIXEL = "pixel=0.5 um"


def flat(head, row, between=","):
    """Return a table in a plane: a row for each cell, of its number, place and area."""
    rows = [row(k, p, np.pi * r**2) for k, (p, r) in enumerate(zip(PLACES, RADII, strict=True))]
    return "\n".join([head, *(between.join(map(str, fields)) for fields in rows)]) + "\n"


def deep(head, row, between=","):
    """Return a table of cells in space: a row for each, of its number, place and radius."""
    rows = [row(k, p, r) for k, (p, r) in enumerate(zip(PLACES, RADII, strict=True))]
    return "\n".join([head, *(between.join(map(str, fields)) for fields in rows)]) + "\n"


def commas(text):
    """Return a table as a German Excel writes it."""
    return text.replace(",", ";").replace(".", ",")


MORE = {
    "ROI manager": (
        flat(" ,Label,Area,Mean,Min,Max,X,Y,Perim.,Circ.",
             lambda k, p, a: (k + 1, f"00{k}-0080", a, 90, 3, 250, p[0], p[1], 30, 0.9)),
        "pixel=1 um", "measurements of ImageJ"),
    "ROI manager, centre of mass": (
        flat(" \tArea\tMean\tXM\tYM\tFrame",
             lambda k, p, a: (k + 1, a, 90, p[0], p[1], 1), "\t"),
        "pixel=1 um", "columns between tabs"),
    "CellProfiler, plane": (
        flat("ImageNumber,ObjectNumber,AreaShape_Area,AreaShape_Center_X,AreaShape_Center_Y",
             lambda k, p, a: (1, k + 1, 4 * a, 2 * p[0], 2 * p[1])),
        PIXEL, "objects of CellProfiler"),
    "CellProfiler, German Excel": (commas(cellprofiler()), PIXEL, "decimal commas"),
    "Cellpose": (
        flat(",label,area,centroid-0,centroid-1,mean_intensity",
             lambda k, p, a: (k, k + 1, 4 * a, 2 * p[1], 2 * p[0], 7)),
        PIXEL, "regions of scikit-image (Cellpose, StarDist)"),
    "StarDist": (
        deep("label,area,centroid-0,centroid-1,centroid-2,intensity_mean",
             lambda k, p, r: (k + 1, volume(r), *(p[::-1] / 0.5), 7)),
        PIXEL, "regions of scikit-image (Cellpose, StarDist)"),
    "QuPath, nuclei": (
        flat("Image\tClassification\tCentroid X µm\tCentroid Y µm\tNucleus: Area",
             lambda k, p, a: ("a.tif", "Tumor", p[0], p[1], a), "\t"),
        "", "detections of QuPath"),
    "QuPath 0.2": (
        flat("Image,Name,Class,Parent,ROI,Centroid X µm,Centroid Y µm,Area µm^2",
             lambda k, p, a: ("a.tif", "x", "Tumor", "Root", "Polygon", p[0], p[1], a)),
        "", "detections of QuPath"),
    "napari, plane": (
        flat("index,axis-0,axis-1", lambda k, p, a: (k, 2 * p[1], 2 * p[0])),
        PIXEL, "points of napari"),
    "PhysiCell Studio": (
        deep("x,y,z,type,volume,cycle entry,custom:GFP",
             lambda k, p, r: (*p, "default", volume(r, 1), "default", 0)),
        "", "cells of PhysiCell"),
    "PhysiCell without volumes": (
        deep("x,y,z,type", lambda k, p, r: (*p, "default")), "", "cells of PhysiCell"),
    "Icy": (
        deep("Name\tX center\tY center\tZ center\tRadius",
             lambda k, p, r: (f"ROI3D {k}", *p, r), "\t"),
        'x="X center" um, y="Y center" um, z="Z center" um, radius=Radius um', "read: 3 cells"),
    "btrack": (
        deep("ID,t,x,y,z,parent,root,state,generation",
             lambda k, p, r: (k, 0, *p, k, k, "interphase", 0)),
        "x=x um, y=y um, z=z um, frame=t", "3 cells of frame 0"),
    "Mastodon": (
        deep("Label,ID,Spot frame,Spot position X,Spot position Y,Spot position Z,Spot radius",
             lambda k, p, r: (k, k, 0, *p, r)),
        'x="Spot position X" um, y="Spot position Y" um, z="Spot position Z" um, '
        'radius="Spot radius" um, frame="Spot frame"', "3 cells of frame 0"),
    "Morpheus": (
        deep("time\tcell.id\tcell.center.x\tcell.center.y\tcell.center.z\tcell.volume",
             lambda k, p, r: (0, k, *p, volume(r, 1)), "\t"),
        "x=cell.center.x um, y=cell.center.y um, z=cell.center.z um, radius=cell.volume um^3",
        "columns between tabs"),
    "ParaView": (
        deep('"radius","Points:0","Points:1","Points:2"', lambda k, p, r: (r, *p)),
        'x="Points:0" um, y="Points:1" um, z="Points:2" um, radius=radius um', "read: 3 cells"),
    "MATLAB": (
        flat("Area,Centroid_1,Centroid_2", lambda k, p, a: (4 * a, 2 * p[0], 2 * p[1])),
        "x=Centroid_1 pixel, y=Centroid_2 pixel, radius=Area pixel^2, pixel=0.5 um",
        "read: 3 cells"),
    "arivis": (
        deep("Id;Centroid X (µm);Centroid Y (µm);Centroid Z (µm);Volume (µm³)",
             lambda k, p, r: (k, *p, volume(r, 1)), ";"),
        'x="Centroid X (µm)" um, y="Centroid Y (µm)" um, z="Centroid Z (µm)" um, '
        'radius="Volume (µm³)" um^3', "columns between semicolons"),
    "tracks of napari": (
        deep("track_id,t,z,y,x", lambda k, p, r: (k, 0, *p[::-1])),
        "x=x um, y=y um, z=z um, frame=t", "3 cells of frame 0"),
    "ilastik, other titles": (
        deep("object_id,timestep,Center of the object_0,Center of the object_1,"
             "Center of the object_2,Size in pixels",
             lambda k, p, r: (k, 0, *(p / 0.5), volume(r))),
        'x="Center of the object_0" pixel, y="Center of the object_1" pixel, '
        'z="Center of the object_2" pixel, radius="Size in pixels" pixel^3, pixel=0.5 um',
        "read: 3 cells"),
}  # fmt: skip


NAMED = 'x="Pos X" um, y="Pos Y" um, z="Pos Z" um, radius=R um, type=Klasse'

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
    **MORE,
}
TYPES = {name: {} for name in ("Tumor", "default", "live", "weich")}
FLAT = (
    "QuPath", "ImageJ", "ROI manager", "ROI manager, centre of mass", "CellProfiler, plane",
    "Cellpose", "QuPath, nuclei", "QuPath 0.2", "napari, plane", "MATLAB",
)  # fmt: skip
WITHOUT_RADII = (
    "Imaris", "ilastik", "napari", "napari, plane", "PhysiCell without volumes", "btrack",
    "tracks of napari",
)  # fmt: skip


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
        ("", "", "holds no data"),
        (napari(), "", r"lengths whose unit it does not state.*pixel=0\.65 um"),
        ("ROI;Spalte 1;Spalte 2\n1;2,5;3,5\n", "", r"is not a known column here"),
        ("X,Y,R\n1,2,-3\n", "x=X um, y=Y um, radius=R um", r"line 2, 'radius.*is -3, must be"),
        ("X,Y,R\n1,2,3\n", "x=X mm, y=Y kg, radius=R um", "has the unit 'kg', must be one like um"),
    ],
)
def test_what_cannot_be_read_is_refused_with_what_to_write(text, columns, said, tmp_path):
    path = tmp_path / "cells.csv"
    path.write_text(text)
    with pytest.raises((DataError, SceneError), match=said):
        scene_of(path, columns)


def test_a_frame_of_a_table_without_frames_is_refused(tmp_path):
    path = tmp_path / "cells.csv"
    path.write_text("X,Y,Z\n1,2,3\n")
    with pytest.raises(
        SceneError, match=r"chooses from cells.csv, which has no column of the fram"
    ):
        scene_of(path, "x=X um, y=Y um, z=Z um", frame=2)


@pytest.mark.slow
def test_a_row_of_a_long_table_takes_bounded_memory(tmp_path):
    """Of ten columns four are needed: 8 bytes a number, and lines; text is gone by then."""
    head, *rows = trackmate().splitlines()[:1] + trackmate().splitlines()[4:5]
    peaks = []
    for count in (60_000, 180_000):
        content = "\n".join([head, *rows * count]).encode()
        tracemalloc.start()
        foreign_cells(content, tmp_path / "spots.csv", CellsChoice("pixel=0.5 um"))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        del content
    assert (peaks[1] - peaks[0]) / 120_000 < 300.0  # 3 GB of ten million rows


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


def test_a_workbook_of_a_known_program_is_recognised(tmp_path):
    path = tmp_path / "spots.xlsx"
    rows = [line.split(",") for line in trackmate(below=False, scale=0.5).splitlines()]
    path.write_bytes(
        workbook([rows[0], *([float(x) if "." in x else x for x in row] for row in rows[1:])])
    )
    table = scene_of(path, PIXEL).initial.cells
    np.testing.assert_allclose(table.given.columns["radius"], RADII)
    assert "spots.xlsx read as TrackMate spots: 3 cells" in table.said


def test_an_own_export_is_read_without_a_word(tmp_path):
    run = mc.run(mc.load_scene("growth").with_changes({"duration": "1 h", "initial.count": 3}))
    run.frames[0].to_pandas().to_csv(tmp_path / "cells.csv", index=False)
    table = scene_of(tmp_path / "cells.csv").initial.cells
    assert table.said == ""
    np.testing.assert_array_equal(table.given.columns["radius"], run.frames[0].cells.radius)
