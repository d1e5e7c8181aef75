"""The pages as a browser shows them, where they have been built (``.ci/run`` runs this then)."""

import pytest
from page_commands import ROOT

BUILT = ROOT / "build" / "docs"
PAGES = sorted(
    str(page.relative_to(BUILT))
    for page in BUILT.rglob("*.html")
    if not {"_static", "_sources"} & set(page.relative_to(BUILT).parts)
)

# what is wider than the window, unless something round it scrolls or cuts it off
WIDE = """() => [...document.querySelectorAll("article *")].filter(element => {
  if (element.getBoundingClientRect().right <= document.documentElement.clientWidth + 2) return false;
  for (let e = element; e && e !== document.body; e = e.parentElement)
    if (getComputedStyle(e).overflowX !== "visible") return false;
  return true;
}).map(element => element.outerHTML.slice(0, 120))"""  # noqa: E501
BROKEN = """() => [...document.images].filter(
  image => !image.hasAttribute("alt") || (image.complete && !image.naturalWidth)
).map(image => image.src)"""

pytestmark = pytest.mark.skipif(not PAGES, reason="build/docs is not there: sphinx-build makes it")


@pytest.mark.slow
@pytest.mark.parametrize("half", [0, 1])  # side by side
def test_pages_fit_and_load_what_is_theirs(half, browser):
    context = browser.new_context(viewport={"width": 390, "height": 900}, color_scheme="dark")
    page, said = context.new_page(), []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda asked: said.append(asked.url) if asked.url[:4] == "http" else None)
    windows = [(390, "dark"), (1280, "light")]
    for name in PAGES[half::2]:  # loaded once, and formulas are set: in the window of the last
        page.goto((BUILT / name).as_uri(), wait_until="load")
        for wide, scheme in windows:
            page.set_viewport_size({"width": wide, "height": 900})
            page.emulate_media(color_scheme=scheme)
            assert page.evaluate(WIDE) == [], (name, wide)
            assert page.evaluate(BROKEN) == [], (name, wide)
        assert said == [], name
        windows.reverse()
    context.close()
