"""Geometry of a population of cells: how far it reaches, and the regions round its centre."""
