"""Figures of the pages on narrow screens: their letters can be read, and pages stay narrow."""

import pytest
from page_commands import ROOT

from multicell.report.plots import style

PAGE = """<meta name="viewport" content="width=device-width"><style>{css}</style>
<body data-theme="light"><article><p><img src="figure.png" alt="a figure"></p>
<figure><img src="figure.png" alt="the same"></figure>
<div><img src="thumb.png" width="100" alt="small"></div></article></body>"""


@pytest.mark.parametrize(("window", "least"), [(390, 640), (1280, 640)])
def test_figures_keep_their_letters(browser, tmp_path, window, least):
    drawn = style.blank("A title", "small letters", style.SIZE)
    drawn.text(0.5, 0.5, "a legend", fontsize=10.5)  # as all pictures of the package have it
    (tmp_path / "figure.png").write_bytes(style.render(drawn, "png"))
    (tmp_path / "thumb.png").write_bytes(style.render(drawn, "png"))
    css = (ROOT / "docs" / "static" / "multicell.css").read_text("utf-8")
    (tmp_path / "page.html").write_text(PAGE.format(css=css), "utf-8")
    context = browser.new_context(viewport={"width": window, "height": 800})
    page = context.new_page()
    page.goto((tmp_path / "page.html").as_uri())
    *figures, thumb = page.evaluate("[...document.images].map((each) => each.clientWidth)")
    assert style.readable_width(drawn) <= least <= min(figures)
    assert thumb == 100
    if window < 640:
        assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    context.close()
