"""Measured data of runs: tables with units, their columns, and the distance of a run from them."""
