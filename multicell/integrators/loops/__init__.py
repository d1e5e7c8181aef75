"""Compiled loops of the explicit methods over the steps of a coupling step."""
