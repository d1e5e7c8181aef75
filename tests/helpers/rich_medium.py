"""Media in which no cell starves: docs/rich-medium.toml, and much oxygen for the scene spheroid."""

from pathlib import Path

SCALE = 8.0
MUCH_OXYGEN = {
    f"nutrients.oxygen.{key}": value / SCALE
    for key, value in {
        "boundary": 5.0, "uptake": 40.0, "half_saturation": 0.005,
        "growth_half_saturation": 0.01, "quiescence": 0.015, "necrosis": 0.008,
    }.items()
}  # fmt: skip
"""A hundred times the oxygen of ``spheroid`` for its uptake and thresholds.

5 mM does not dissolve; with concentrations and uptake eight times smaller all parts are the same.
"""

RICH = str(Path(__file__).parents[2] / "docs" / "rich-medium.toml")
