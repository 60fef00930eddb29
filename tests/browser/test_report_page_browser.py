"""The report's page as people meet it, in a headless browser: quiet, quick, complete, readable."""

import pytest
from visits import Visit


def test_it_says_nothing_on_the_console_and_asks_for_nothing(visit):
    visit.do("testbedPlayer.seek(3)")
    assert visit.said == []
    assert [url for url in visit.requests if not url.startswith(("file:", "data:"))] == []
    assert len([url for url in visit.requests if url.startswith("file:")]) == 1  # the page itself


def test_the_policy_holds_even_against_the_page_itself(visit):
    blocked = visit.do(
        "fetch('https://example.org/').then(() => 'fetched', () => 'blocked')",
    )
    assert blocked == "blocked"
    assert [url for url in visit.requests if "example.org" in url] == []


def test_the_demos_report_is_at_most_4_mb_and_opens_within_2_seconds(browser, demo):
    assert (demo / "report.html").stat().st_size <= 4_000_000
    took = []
    for _ in range(3):
        with Visit(browser, demo / "report.html") as visit:
            took.append(visit.do("performance.getEntriesByType('navigation')[0].loadEventEnd"))
    assert min(took) <= 2000, took


def test_every_image_has_a_size(visit):
    sizes = visit.do(
        "Promise.all([...document.images].map((i) => i.decode().then(() => [i.naturalWidth, i.naturalHeight, i.clientWidth, i.alt])))"
    )
    assert len(sizes) >= 2
    for width, height, shown, alt in sizes:
        assert width >= 200
        assert height >= 150
        assert shown >= 200
        assert alt
    figures = visit.do("[...document.querySelectorAll('svg.figure')].filter((s) => s.checkVisibility()).map((s) => s.clientHeight)")
    assert len(figures) >= 5
    assert min(figures) > 100


OVERLAPS = """() => {
  document.querySelectorAll('details').forEach((one) => (one.open = true));
  const wrong = [];
  for (const svg of document.querySelectorAll('svg.figure')) {
    const whole = svg.getBoundingClientRect();
    const texts = [...svg.querySelectorAll('text')].map((t) => [t.textContent.trim(), t.getBoundingClientRect()]).filter(([text]) => text);
    texts.forEach(([text, box], i) => {
      if (box.left < whole.left - 1 || box.right > whole.right + 1 || box.top < whole.top - 1 || box.bottom > whole.bottom + 1)
        wrong.push(`${svg.id}: ${text} is cut`);
      for (const [other, place] of texts.slice(0, i)) {
        const x = Math.min(box.right, place.right) - Math.max(box.left, place.left);
        const y = Math.min(box.bottom, place.bottom) - Math.max(box.top, place.top);
        if (x > 1.5 && y > 3.0) wrong.push(`${svg.id}: ${text} lies on ${other}`);
      }
    });
  }
  return wrong;
}"""


def test_no_label_is_cut_or_lies_on_another(browser, demo, several):
    for folder in (demo, several):
        with Visit(browser, folder / "report.html") as visit:
            assert visit.do("document.querySelectorAll('svg.figure text').length") > 100
            assert visit.do(OVERLAPS) == []


def test_a_label_that_lies_on_another_is_found(visit):
    """The test above can fail."""
    visit.do(
        """() => {
          const text = document.querySelector('#plan-0 text'), twin = text.cloneNode(true);
          twin.textContent = 'twin'; text.parentNode.appendChild(twin);
        }"""
    )
    assert any("twin lies on" in wrong for wrong in visit.do(OVERLAPS))


@pytest.mark.parametrize("width", [1280, 390])
def test_nothing_is_wider_than_the_window(browser, demo, width):
    with Visit(browser, demo / "report.html") as visit:
        visit.page.set_viewport_size({"width": width, "height": 800})
        assert visit.do("document.documentElement.scrollWidth") <= width


def test_without_scripts_everything_can_be_read(browser, demo):
    with Visit(browser, demo / "report.html", java_script_enabled=False) as visit:
        page = visit.page
        text = page.inner_text("body")
        for words in ("came nearest to the truth", "95 % interval", "Scripts are off", "What the models leave out", "ekf − ukf"):
            assert words in text
        assert page.locator("#plan-0").bounding_box()["height"] > 200
        assert page.locator("#errors-0").bounding_box()["height"] > 150
        assert not page.locator('[data-part="play"]').is_visible()
        assert page.locator("img").first.bounding_box()["width"] > 200


def test_on_paper_the_whole_trial_is_drawn_and_what_is_folded_away_opens(visit):
    visit.do("testbedPlayer.seek(5)")
    visit.page.emulate_media(media="print")
    assert visit.do("getComputedStyle(document.querySelector('#plan-0 .live-layer')).display") == "none"
    assert visit.do("getComputedStyle(document.querySelector('#plan-0 [data-layer=b0]')).display") == "inline"
    assert visit.do("getComputedStyle(document.querySelector('#plan-0 [data-layer=e0]')).opacity") == "1"
    assert not visit.page.locator('[data-part="play"]').is_visible()
    opened = visit.do("() => { dispatchEvent(new Event('beforeprint')); return document.querySelectorAll('details:not([open])').length; }")
    assert opened == 0
    assert visit.do("() => { dispatchEvent(new Event('afterprint')); return document.querySelectorAll('details:not([open])').length; }") > 0
    assert len(visit.page.pdf(format="A4")) > 10_000


def test_a_dark_page_is_dark_and_its_ink_light(browser, demo):
    with Visit(browser, demo / "report.html", color_scheme="dark") as visit:
        paper, ink = visit.do(
            """() => [getComputedStyle(document.documentElement).backgroundColor,
                      getComputedStyle(document.querySelector('#plan-0 text')).fill]"""
        )
        assert max(int(c) for c in paper.removeprefix("rgb(").rstrip(")").split(",")) < 60
        assert min(int(c) for c in ink.removeprefix("rgb(").rstrip(")").split(",")) > 180
