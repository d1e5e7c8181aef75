"""Choosing grid, geometry and regime of a field by estimated errors."""
