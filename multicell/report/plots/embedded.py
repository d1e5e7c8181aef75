"""Figures as parts of a page, for light and dark mode, without the title: pages have their own."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, final

from matplotlib.transforms import Bbox

from multicell.report.plots.marks import Mark, marks
from multicell.report.plots.night import darken
from multicell.report.plots.style import DPI, SUBTITLE, TITLE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TITLE_HEIGHT: Final = 0.4  # inches, what the title takes
_COLOURS: Final = 256


@final
@dataclass(frozen=True)
class Embedded:
    """A picture as a page shows it.

    Attributes
    ----------
    light, dark
        PNG in base64, for either mode.
    marks
        Its places that have a name.
    wide, high
        Pixels.
    subtitle
        What the picture says of itself.
    """

    light: str
    dark: str
    marks: Sequence[Mark]
    wide: int
    high: int
    subtitle: str


def embedded(figure: Figure) -> Embedded:
    """Return a figure for a page. The figure is changed: it is dark afterwards, without title."""
    wide, high = figure.get_size_inches()
    titles = [text for text in figure.texts if text.get_gid() == TITLE]
    for text in titles:
        text.set_visible(False)
    kept = high - _TITLE_HEIGHT if titles else high
    shown = Bbox([[0.0, 0.0], [wide, kept]])
    light, size = _png(figure, shown)
    places = [_moved(mark, high, kept) for mark in marks(figure)]
    told = [text.get_text() for text in figure.texts if text.get_gid() == SUBTITLE]
    darken(figure)
    return Embedded(light, _png(figure, shown)[0], places, *size, subtitle="".join(told))


def _moved(mark: Mark, high: float, kept: float) -> Mark:
    """Return a mark of a figure of which the upper end is cut off."""
    share = high / kept
    return mark._replace(y=1.0 - (1.0 - mark.y) * share, high=mark.high * share)


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
