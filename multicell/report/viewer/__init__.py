"""The view of cells in space and time that is part of a run's report."""
