"""Nutrient fields in quasi-steady state: grid, transfer between cells and nodes, solver.

Nothing is imported here, so that a scene without nutrients does not pay for the field:
take :class:`multicell.nutrient.field.NutrientField` from its module.
"""
