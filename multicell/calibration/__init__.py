"""Parameters of a scene from measured data, and which of them decide its observables.

Three rooms stand side by side above studies: :mod:`~multicell.calibration.fitting` (fits and
posteriors), :mod:`~multicell.calibration.dose_response` and
:mod:`~multicell.calibration.sensitivity`. They vary scenes by the same ranges, and their runs are
those of studies; what they share is in :mod:`~multicell.calibration.shared`. Optuna, SALib and
scikit-learn are loaded where they are used (:mod:`multicell.host.extras`).
"""
