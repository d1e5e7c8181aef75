"""Results whose folder holds another run by now."""

import multicell as mc


def test_a_result_whose_files_have_been_replaced_is_printed(tmp_path):
    """Who prints it after Ctrl-C must not get a traceback for that."""
    scene = mc.load_scene("growth").with_changes({"duration": "20 min", "initial.count": 2})
    old = mc.run(scene, output=tmp_path / "out", report=False, threads=1)
    assert " cells, in " in repr(old)
    mc.run(scene.with_changes({"seed": 9}), output=tmp_path / "out", report=False, overwrite=True)
    assert "it holds another run" in repr(old)
