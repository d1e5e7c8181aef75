"""The laws of growth by their names in a scene."""

from __future__ import annotations

from multicell.behaviours.growth_laws.law import GrowthLaw
from multicell.behaviours.growth_laws.laws import (
    Exponential,
    Gompertz,
    Linear,
    Logistic,
    Relaxation,
)
from multicell.plugins.laws import Laws

LAWS: Laws[GrowthLaw] = Laws(
    {
        "linear": Linear,
        "exponential": Exponential,
        "relaxation": Relaxation,
        "logistic": Logistic,
        "gompertz": Gompertz,
    }
)
"""All laws of growth; those of the user's own are entered by :func:`multicell.growth_law`."""
