"""A field that is used up is not drawn behind a section: shades of it would be rounding."""

import multicell as mc
from multicell.report.plots import section as sections


def drawn(left):
    scene = mc.load_scene("growth").with_changes(
        {"initial.count": 30, "duration": "1 h", "coupling_step": "20 min",
         "nutrients.drug": {"boundary": 0, "media": [["20 min", 1.0], ["40 min", left]],
                            "geometry": "radial", "uptake": 0}}
    )  # fmt: skip
    figure = sections.section(mc.run(scene).frames[-1], scene)
    return any(text.get_text().startswith("Drug") for text in figure.texts)


def test_what_is_left_of_a_field_is_drawn_where_it_is_more_than_rounding():
    assert drawn(1e-6)
    assert not drawn(1e-11)
