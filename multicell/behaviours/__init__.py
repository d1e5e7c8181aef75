"""Behaviours of cells, the signals that they respond to, and the laws of response."""
