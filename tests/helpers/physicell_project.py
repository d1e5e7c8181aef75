"""A model of PhysiCell of our own, in a folder as PhysiCell's projects have it."""

from pathlib import Path

MM_HG = 0.133322387415 * 0.01052
"""mM for 1 mmHg of oxygen at 37 °C: 0.01052 mM/kPa (Battino et al. 1983)."""
ON = ('format="csv" enabled="false"', 'format="csv" enabled="true"')
"""The change that enables rules."""
SETTINGS = Path(__file__).parents[1] / "importing" / "settings.xml"
CELLS = "0,0,0,0\n15,0,0,0\n0,15,4,0\n-40,10,0,3\n"


def writer(folder):
    """Return a function that writes settings with some text replaced, and returns their path."""

    def write(*changes, cells=CELLS, rules=None):
        text = SETTINGS.read_text(encoding="utf-8")
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new)
        config = folder / "config"
        config.mkdir(exist_ok=True)
        (config / "cells.csv").write_text(cells, encoding="utf-8")
        if rules is not None:
            (config / "rules.csv").write_text(rules, encoding="utf-8")
        path = config / "settings.xml"
        path.write_text(text, encoding="utf-8")
        return path

    return write
