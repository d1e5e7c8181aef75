"""Wrong inputs of a newcomer: each message states the right input, and nothing is written."""

import pytest
from click.testing import CliRunner

import multicell as mc
from multicell.cli.main import main

FILES = {
    "comma.csv": "day, diameter / um\n1, 30,5\n",
    "no-unit.csv": "day, diameter\n1, 30\n",
    "dates.csv": "date, diameter / um\n2026-01-01, 30\n",
    "sd.csv": "day, sd\n1, 3\n",
    "empty.csv": "",
    "time.csv": "time, diameter / um\n1, 30\n",
    "broken.toml": "duration = 3 d\n",
    "misspelt.toml": "duration = '3 d'\n[growht]\ncycle_time='18 h'\n",
    "no-duration.toml": "title = 'x'\n",
    "cells.csv": "x,y,z\n0,0,0\n",
    "pixels.csv": "x_px,y_px\n0,0\n",
    "twice.csv": "x_um,y_um,z_um\n0,0,0\n0,0,0\n",
    "mine.py": "def law(x):\n    return x\n",
    "dose.csv": "conc,response\n1,2\n",
    "early.csv": "day, diameter / um\n-1, 30\n",
    "good.csv": "day, diameter / um\n1, 30\n",
    "labels.tif": "no image\n",
    "law.py": "import multicell as mc\n",
    "net.xml": "<sbml></sbml>\n",
    "semi.csv": "x_um;y_um;z_um\n0;0;0\n",
    "yaml.toml": "duration: 3 d\n",
}
SET = {
    "duration=3,5 d": "Use '.' as decimal separator",
    "duration=-3 d": "must be above 0",
    "oxygen=5 %": "Did you mean 'nutrients.oxygen.boundary'",
    "oxygen.boundary=5 %": "Did you mean 'nutrients.oxygen.boundary'",
    "nutrients.oxygen=5 %": "Name one of its keys: diffusion, boundary",
    "nutrients.oxygen.boundary=120 %": "at most 100 %",
    "nutrients.oxygen.boundary=5 ppm": "unknown unit 'ppm'",
    "nutrients.oxygn.boundary=0.1 mM": "Did you mean 'nutrients.oxygen.boundary'",
    "nutrients.oxyegn.boundary=0.1 mM": "Did you mean 'nutrients.oxygen.boundary'",
    "nutrients.glucose.boundary=25 %": "Only of the field named 'oxygen'",
    "nutrients.oxygen.uptake=1 fmol/h/cell": "unknown unit 'fmol/h/cell'",
    "cells.diameter=9 um": "Did you mean 'division_radius'",
    "cells.radius=5 um": "Did you mean 'division_radius'",
    "growth.doubling_time=18 h": "Did you mean 'cycle_time'",
    "growth.cycle_time=18": "write '18 h' for hours",
    'growth.cycle_time="18"': "Write for example '18 h'",
    "initial.cells=cells.csv": "Title it 'x_um'",
    "integrator=implicit": "'backward-euler'",
    "contact.law=jrk": "Did you mean 'jkr'",
    "duration": "write the value without a space",
    "duration=twelve days": "must be a number and a unit",
    "timestep=1": "Did you mean 'coupling_step'",
    "growth=off": "--set growth= takes it out",
    "integrator.tolerance=0": "Did you mean 'rtol'",
    "nutrients.oxygen.consumption=4 amol/s": "Did you mean 'uptake'",
    "nutrients.glucose.boundary=4.5 g/l": "1 g/l of glucose (180 g/mol) is 5.55 mM",
    "duration=3 months": "write days, as '90 d'",
    "growth.cycle_time=18±2 h": "ranges are for --vary, --free and --key",
    "growth.cycle_time=10-20 h": "ranges are for --vary, --free and --key",
    "contact.stiffness=1 kPa": "The stiffness of cells is cells.young",
    "output.frames=10": "The time between frames is output.every",
    "temperature=37": "Did you mean 'nutrients.oxygen.temperature'?",
    "networks.a.file=net.xml": "it lacks the namespace of its level",
}
STUDY = "study new growth -o out --vary"
FREE = "fit growth -o out --data good.csv --free"
FIT = ["-o", "out", "--free", "growth.cycle_time=8:25 h", "--data"]
COMMANDS = {
    "run spheroid": "Missing option '-o'",
    "run sphreoid -o out": "Did you mean 'spheroid'",
    "run broken.toml -o out": "A value with a unit stands in quotes: '3 d'",
    "run misspelt.toml -o out": "Did you mean 'growth'",
    "run no-duration.toml -o out": "duration: is missing",
    "run none.toml -o out": "does not exist",
    "run spheroid -o out --cells pixels.csv": "How many um is a pixel?",
    "run spheroid -o out --cells twice.csv": "One cell has one row",
    "run spheroid -o out --law mine.py:law": "by the decorator multicell.pair_law",
    "run spheroid -o out --law none.py:law": "there is no file 'none.py'",
    "explain spheroid --set drag.viskosity=5": "Did you mean 'viscosity'",
    "resume nothing": "there are no results in 'nothing'",
    "view spheroid": "there is no such folder",
    "play spheroid --no-browser --key oxygen=1:21": "Did you mean 'nutrients.oxygen.boundary'",
    "export nothing -o out --format excel": "there is no format 'excel'. Allowed: csv",
    "export nothing -o out": "there is no such folder",
    "study run nothing": "multicell study new SCENE",
    "study new spheroid -o out --vary drag.viscosty=1,2": "Did you mean 'drag.viscosity'",
    "dose-response --data dose.csv -o out": "Allowed: dose, response, replicate",
    "compare spheroid -o out --methods euler,rk5": "Did you mean 'rk4'",
    "runn spheroid": "Did you mean 'run'",
    "spheroid": "multicell run spheroid -o out",
    "scene.toml": "multicell run scene.toml -o out",
    "workprecision settle": "multicell compare SCENE -o out",
    "check spheroid": "multicell explain SCENE",
    "study spheroid -o s": "multicell study new spheroid --vary KEY=VALUES -o study",
    "study help": "multicell study --help",
    "fit spheroid -o f": "Missing option '--data', for example --data",
    "fit spheroid -o f --data comma.csv --free growth.cycle_time": "cycle_time='LOW:HIGH'",
    "play spheroid --key oxygen": "--key oxygen='LOW:HIGH'",
    "sensitivity spheroid -o s --vary growth.cycle_time=1:2": "Write --free",
    "import settings.xml -o out": "multicell import physicell settings.xml -o out",
    "import sbml net.xml": "--set networks.NAME.file=FILE",
    "run spheroid -o out --cells labels.tif": "labels.tif: is no TIFF image",
    "run spheroid -o out --cells semi.csv --columns x=X": "Allowed: x_um, y_um, z_um",
    "explain yaml.toml": "A scene is TOML, not YAML",
    "explain law.py": "Python files are for --law",
    "resume law.py": "it is a file, not a folder",
    "plot out": "for example -o section.png",
    "movie out": "for example -o movie.gif",
    "export out": "for example -o tables",
    "study report law.py": "'law.py' is a file, not the folder of a study",
    f"{STUDY} growth.cycle_time=10:20h": "'10:20:5h' has five",
    f"{FREE} growth.cycle_time=uniform(8,25)": "A uniform one is the range alone",
    f"{FREE} growth.cycle_time=8:25h --constraint cycle_time>10": "A limit is an end of a range",
    "compare growth -o out --methods all": "Name none to compare all",
    "dose-response growth -o out": "for example --dose nutrients.drug.boundary",
    "profile nowhere": "there is no such folder",
    "stability growth -o out --file 5": "--set networks.NAME.file='…'",
    "gui": "multicell play SCENE",
}
DATA = {
    "comma.csv": "Use '.' as decimal separator",
    "no-unit.csv": "Write 'diameter / um'",
    "dates.csv": "A column of times is titled 'day' or 'time / h'",
    "sd.csv": "has no column of values to its left",
    "empty.csv": "holds no data",
    "time.csv": "Write 'time / h'",
    "none.csv": "does not exist",
    "early.csv": "was measured 1 d before the run begins",
}
PYTHON = {
    "a number": (lambda: mc.run(5), "5"),
    "a scene's name": (lambda: mc.Simulation("growth"), "multicell.load_scene makes one"),
    "progress": (lambda: mc.run("growth", progress=5), "must be a function, True or False"),
    "key": (lambda: mc.load_scene("growth").with_changes({"growth.cycletime": 1}), "'cycle_time'"),
    "format": (lambda: mc.export("nothing", "out", format="exel"), "Allowed: csv"),
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, "utf-8")
    return tmp_path


def refused(folder, arguments, words):
    answer = CliRunner().invoke(main, arguments)
    said = " ".join(answer.output.split())
    assert (answer.exit_code, answer.stdout) == (2, ""), said
    assert "Traceback" not in said
    assert words in said
    assert sorted(path.name for path in folder.iterdir()) == sorted(FILES)


@pytest.mark.parametrize("change", SET)
def test_a_wrong_value_is_answered(change, folder):
    refused(folder, ["run", "spheroid", "-o", "out", "--set", change], SET[change])


@pytest.mark.parametrize("command", COMMANDS)
def test_a_wrong_command_is_answered(command, folder):
    refused(folder, command.split(), COMMANDS[command])


@pytest.mark.parametrize("name", DATA)
def test_a_wrong_table_is_answered(name, folder):
    refused(folder, ["fit", "growth", *FIT, name], DATA[name])


@pytest.mark.parametrize("case", PYTHON)
def test_wrong_calls_are_answered(case, folder):
    call, words = PYTHON[case]
    with pytest.raises((mc.MulticellError, TypeError), match=words):
        call()


def test_a_short_time_is_run_with_a_note(folder, monkeypatch):
    monkeypatch.setattr("multicell.scene.bare._NAMED", set())  # each key is named once a process
    answer = CliRunner().invoke(main, ["explain", "growth", "--set", "duration=18"])
    assert answer.exit_code == 0
    assert "Note: duration: 18 was read as 18 s" in answer.output
    assert "Write '18 h' for hours" in answer.output
    monkeypatch.setattr("multicell.scene.bare._NAMED", set())
    quiet = CliRunner().invoke(main, ["explain", "growth", "--set", "duration=18 s"])
    assert "Note: duration" not in quiet.output
