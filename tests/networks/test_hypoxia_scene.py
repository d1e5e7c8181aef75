"""The built-in scene with a network in each cell."""

import subprocess
import sys

import pytest

import multicell as mc
from multicell.cli.main import main

WITHOUT = """
import sys

sys.modules["sbmlode"] = None
from multicell.cli.main import main

main(sys.argv[1:])
"""


@pytest.mark.slow
def test_cells_without_oxygen_lose_each_other():
    ends = {}
    for name, media in (("little", [["1 h", "1 %"]]), ("plenty", [["1 h", "8 %"]])):
        changes = {"initial.count": 40, "duration": "12 h", "nutrients.oxygen.media": media}
        result = mc.run(mc.load_scene("hypoxia-invasion").with_changes(changes), report=False)
        history = result.history
        ends[name] = {key: history[f"network_mean_hypoxia_{key}"][-1] for key in ("HIF", "ECAD")}
        ends[name]["radius"] = history["radius"][-1] / history["radius"][0]
    assert ends["little"]["HIF"] > 4.0 * ends["plenty"]["HIF"]
    assert ends["plenty"]["ECAD"] == pytest.approx(1.0, abs=0.01)
    assert ends["little"]["ECAD"] < 0.4
    assert ends["little"]["radius"] > 1.5
    assert ends["plenty"]["radius"] == pytest.approx(1.0, abs=0.1)


def test_the_file_of_the_network_is_written_with_the_scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    main(["init", "hypoxia-invasion", "-o", "mine.toml"], standalone_mode=False)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hypoxia.ant", "mine.toml"]
    mine = mc.load_scene("mine.toml")
    assert mine.networks["hypoxia"].file == str(tmp_path / "hypoxia.ant")
    with pytest.raises(mc.OutputError, match=r"hypoxia\.ant"):
        main(["init", "hypoxia-invasion", "-o", "other.toml"], standalone_mode=False)
    assert not (tmp_path / "other.toml").exists()


@pytest.mark.parametrize(("command", "code", "words"), [
    (["scenes"], 0, "hypoxia-invasion"),
    (["explain", "hypoxia-invasion"], None, 'pip install "multicell[networks]"'),
    (["explain", "growth"], 0, "growth"),
])  # fmt: skip
def test_who_lacks_the_extra_is_given_its_name(command, code, words):
    done = subprocess.run(
        [sys.executable, "-P", "-c", WITHOUT, *command], capture_output=True, text=True, check=False
    )
    text = done.stdout + done.stderr
    assert words in " ".join(text.split())
    assert "Traceback" not in text
    assert (done.returncode == 0) == (code == 0)
