"""Size of the letters of a picture on a page."""

from matplotlib.figure import Figure
from matplotlib.text import Text

PAGE = 1004.0
"""Width of a picture on a page, px of 1/96 inch: ``main`` and ``section`` of ``style.css``."""
SMALLEST = 7.0
"""Points below which letters are hard to read."""


def smallest_letters(figure: Figure, page: float = PAGE) -> tuple[float, str]:
    """Return the size of the smallest letters at the width of a page, points, and their text."""
    scale = page / 96.0 / figure.get_figwidth()
    texts = [t for t in figure.findobj(Text) if t.get_visible() and t.get_text().strip()]
    return min(((scale * t.get_fontsize(), t.get_text()) for t in texts), default=(SMALLEST, ""))
