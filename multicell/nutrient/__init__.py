"""Dissolved substances: grids, solvers, uptake, balance."""
