"""Texts of a picture or a page, and their places."""

from __future__ import annotations

from html.parser import HTMLParser
from itertools import combinations

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg

SMALLEST = 7.0
"""Letters of any picture at least, pt."""


def rendered(figure):
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return canvas.get_renderer()


def hidden_labels(axes):
    """Yield labels of ticks beyond the limits of an axis, which matplotlib keeps undrawn."""
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        for tick in axis.get_major_ticks() + axis.get_minor_ticks():
            if not low <= tick.get_loc() <= high:
                yield from (tick.label1, tick.label2)


def check_texts(figure):
    """Check that no text leaves the picture, covers another, is tiny or an undrawn formula."""
    drawn = rendered(figure)
    box, (wide, high) = figure.get_tightbbox(), figure.get_size_inches()
    assert box.x0 >= 0
    assert box.y0 >= 0
    assert box.x1 <= wide
    assert box.y1 <= high
    hidden = {id(label) for axes in figure.axes for label in hidden_labels(axes)}
    written = [
        text
        for text in figure.findobj(mpl.text.Text)
        if text.get_text().strip() and text.get_visible() and id(text) not in hidden
    ]
    boxes = [(text.get_text(), text.get_window_extent(drawn)) for text in written]
    assert {text.get_text() for text in written if text.get_fontsize() < SMALLEST} == set()
    assert len(boxes) > 4
    plain = [text for text in figure.findobj(mpl.text.Text) if not text.get_parse_math()]
    assert [text for text in plain if "$\\mathdefault" in text.get_text()] == []
    for (text, first), (other, second) in combinations(boxes, 2):
        assert not first.overlaps(second), (text, other)


def texts(figure):
    found = [text.get_text() for text in figure.findobj(mpl.text.Text)]
    return [text for text in found if text]


class Page(HTMLParser):
    """Collects tags and checks that every element that is opened is closed in order."""

    VOID = frozenset({"meta", "img", "source", "br", "hr", "link", "input"})

    def __init__(self):
        super().__init__()
        self.open, self.tags, self.text = [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "title"):
            self.text.append(data.strip())


def read(path):
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    page.close()
    assert page.open == []
    return page
