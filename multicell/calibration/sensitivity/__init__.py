"""Sensitivity of observables to parameters: Morris trajectories, Sobol indices, pages."""
