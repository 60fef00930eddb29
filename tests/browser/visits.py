"""A page opened in a headless browser, and where things are drawn on it."""

from pathlib import Path

import numpy as np


class Visit:
    """A page in a context of its own, with all that it asked for and said."""

    def __init__(self, browser, path, **options):
        self.requests, self.said = [], []
        self.context = browser.new_context(viewport={"width": 1280, "height": 900}, **options)
        self.context.route("**/*", self._asked)
        self.page = self.context.new_page()
        self.page.on("console", lambda message: self.said.append((message.type, message.text)))
        self.page.on("pageerror", lambda error: self.said.append(("error", str(error))))
        self.page.goto(Path(path).resolve().as_uri(), wait_until="load")

    def _asked(self, route):
        self.requests.append(route.request.url)
        route.continue_()

    def do(self, script, *arguments):
        return self.page.evaluate(script, *arguments)

    def wait(self, condition):
        """Until a condition holds, five seconds at most; looked at from inside, for the page's policy forbids what playwright would do."""
        held = self.do(
            f"""() => new Promise((done) => {{
              const began = performance.now();
              const look = () => ({condition} ? done(true) : performance.now() - began > 5000 ? done(false) : setTimeout(look, 20));
              look();
            }})"""
        )
        assert held, condition

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.context.close()


CENTRE = """([selector, figure]) => {
  const box = document.querySelector(selector).getBoundingClientRect(), svg = document.getElementById(figure);
  const at = new DOMPoint(box.x + box.width / 2, box.y + box.height / 2).matrixTransform(svg.getScreenCTM().inverse());
  const a = svg.getScreenCTM().a;
  return [at.x, at.y, a];
}"""


def drawn_at(visit, figure, selector):
    """Where the middle of an element is in the figure's own points, and how many pixels a point is."""
    u, v, scale = visit.do(CENTRE, [selector, figure])
    return np.array([u, v]), scale
