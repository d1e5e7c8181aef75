"""Figures as parts of a page, without the title: pages have their own."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from typing import Any, Final, final

from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from multicell.report.plots.style import DPI, SUBTITLE, TITLE

_TITLE_HEIGHT: Final = 0.4  # inches, what the title takes
_COLOURS: Final = 256


@final
@dataclass(frozen=True)
class InlinePicture:
    """A picture as a page shows it; ``style.css`` turns its colours in dark mode.

    - ``png``: the picture in base64
    - ``wide``, ``high``: pixels
    - ``subtitle``: what the picture says of itself
    """

    png: str
    wide: int
    high: int
    subtitle: str


def inline_picture(figure: Figure) -> InlinePicture:
    """Return a figure for a page; its title is hidden afterwards."""
    wide, high = figure.get_size_inches()
    titles = [text for text in figure.texts if text.get_gid() == TITLE]
    for text in titles:
        text.set_visible(False)
    shown_height = high - _TITLE_HEIGHT if titles else high
    png, size = _png(figure, Bbox([[0.0, 0.0], [wide, shown_height]]))
    subtitles = [text.get_text() for text in figure.texts if text.get_gid() == SUBTITLE]
    return InlinePicture(png, *size, subtitle="".join(subtitles))


def _png(figure: Figure, shown: Bbox) -> tuple[str, tuple[int, int]]:
    """Return a figure as PNG in base64, and its pixels; a palette makes it a third as large."""
    from PIL import Image

    drawn, packed = io.BytesIO(), io.BytesIO()
    background: Any = figure.get_facecolor()
    figure.savefig(drawn, format="png", dpi=DPI, bbox_inches=shown, facecolor=background)
    image = Image.open(drawn).convert("RGB")
    few = image.quantize(_COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    few.save(packed, format="PNG", optimize=True)
    return base64.b64encode(packed.getvalue()).decode("ascii"), image.size
