"""Pages on narrow screens: pictures whose letters can be read, and pages that fit."""

import pytest
from letters import PAGE, SMALLEST, smallest_letters

from multicell.report import html, live
from multicell.report.letters import readable_from
from multicell.report.plots import growth, style

TEMPLATE = """{% extends "base.html" %}{% from "parts.html" import picture %}
{% block body %}{% for shown in pictures %}{{ picture({"caption": "c", "shown": shown}) }}
{% endfor %}{% endblock %}"""


def figure(points, size=style.SIZE):
    found = style.blank("A title", "small letters", size)
    found.text(0.5, 0.5, "small", fontsize=points)
    return found


@pytest.fixture(scope="module")
def shown():
    return [style.inline_picture(figure(*given)) for given in ((10.0,), (7.5, (8.0, 4.0)))]


def test_a_picture_knows_from_which_width_its_letters_can_be_read():
    drawn = figure(10.0)
    least = style.readable_width(drawn)
    assert smallest_letters(drawn, least)[0] >= SMALLEST
    assert smallest_letters(drawn, least - 2)[0] < SMALLEST


@pytest.fixture
def opened(browser, shown, tmp_path, request):
    page = html._environment().from_string(TEMPLATE)
    path = tmp_path / "page.html"
    path.write_text(page.render(
        title="t", subtitle="s", tiles={}, scene="", version="1", pictures=shown,
    ))  # fmt: skip
    context = browser.new_context(viewport={"width": request.param, "height": 800})
    found = context.new_page()
    found.goto(path.as_uri())
    yield found
    context.close()


WIDTHS = "[...document.querySelectorAll('figure img')].map((each) => each.clientWidth)"
FITS = "document.documentElement.scrollWidth <= window.innerWidth"


@pytest.mark.parametrize("opened", [390, 800, 1280], indirect=True)
def test_letters_can_be_read_at_any_width(opened, shown):
    widths = opened.evaluate(WIDTHS)
    assert [wide >= each.least for wide, each in zip(widths, shown, strict=True)] == [True, True]
    assert opened.evaluate(FITS)


@pytest.mark.parametrize("opened", [390], indirect=True)
def test_a_tap_shows_a_whole_picture(opened):
    opened.locator(".fit").first.click()
    first, second = opened.evaluate(WIDTHS)
    assert first < 390 < second
    assert opened.evaluate(FITS)


def test_the_curves_of_the_playground_can_be_read():
    """Its page states their width beforehand: ``.curves`` of ``style.css``, 40 rem of 16 px."""
    history = {"time": [0.0, 3600.0], "diameter": [10.0, 12.0]}
    drawn = growth.overlay(
        {"run 1": {k: style.np.array(v) for k, v in history.items()}}, "diameter"
    )
    style.render(drawn, "png")
    assert style.readable_width(drawn) <= 640
    assert ".sheet.curves { --least:40rem; }" in html.files("multicell.report").joinpath(
        "templates/style.css"
    ).read_text("utf-8")


def test_the_live_picture_can_be_read():
    assert f"--least:{readable_from(18.0, live.WIDE / 72.0)}px" in live._page(_scene())
    assert readable_from(7.0, PAGE / 96.0) == PAGE


def _scene():
    import multicell as mc

    return mc.load_scene("growth")
