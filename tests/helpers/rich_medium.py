"""A scene with phases, thresholds and two fields that take up by cell: docs/rich-medium.toml."""

from pathlib import Path

RICH = str(Path(__file__).parents[2] / "docs" / "rich-medium.toml")
