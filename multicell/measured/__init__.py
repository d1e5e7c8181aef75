"""Measured data of runs: tables with units, what they hold, and how far a run is from them."""
