"""Solvers of a scene's fields against each other: py-pde's, SciPy's and ours."""
