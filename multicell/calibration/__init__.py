"""Parameters of a scene from measured data, and which of them decide its observables.

Fits, posteriors and sensitivity stand above studies: they vary scenes by the same ranges, and their
runs are those of studies. Optuna, SALib and scikit-learn are loaded where they are used
(:mod:`multicell.host.extras`).
"""
