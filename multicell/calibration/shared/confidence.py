"""Confidence of reported intervals."""

from typing import Final

LEVEL: Final = 0.95  # the usual one, where a caller names none
TAILS: Final = (0.025, 0.975)  # probabilities at the ends of a central interval of that level
BAND: Final = (0.025, 0.5, 0.975)  # and of its median
