"""Fixtures of tests of pictures."""

import pytest

import multicell as mc


@pytest.fixture(scope="session")
def small_run(tmp_path_factory):
    """A run of few cells in a field, with three frames."""
    scene = mc.load_scene("spheroid").with_changes(
        {"duration": "20 h", "initial.count": 30, "output.every": "10 h"}
    )
    return mc.run(scene, output=tmp_path_factory.mktemp("small") / "run", report=False)
