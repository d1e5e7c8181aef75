"""Dose response of one drug or two: runs, curves with intervals, combinations, page."""
