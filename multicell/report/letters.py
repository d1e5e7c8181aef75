"""Sizes of letters in pictures on a page."""

import math
from typing import Final

SMALLEST: Final = 7.0  # points below which letters are hard to read


def readable_from(points: float, inches: float) -> int:
    """Return the width of a page from which letters can be read, px of 1/96 inch.

    - ``points``: their size in a picture that is ``inches`` wide, and as wide as the page is shown
    """
    return math.ceil(SMALLEST / points * 96.0 * inches)
