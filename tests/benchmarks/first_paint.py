"""How soon the bench is on the screen, and how much goes over the wire for it.

python -m tests.benchmarks.first_paint
"""

import tempfile
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright

from api.access.tokens import create_token
from tests.api.browser import CHROMIUM
from tests.benchmarks.figures import tell
from tests.served import served

TIMES = 10
"""With an empty cache each."""


def main() -> None:
    """Print paints and sizes."""
    paints, arms, sizes = [], [], []
    with tempfile.TemporaryDirectory() as folder, served(Path(folder)) as service, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        for _ in range(TIMES):
            token = create_token(service.live.store, "local", "first paint")[0]
            page = browser.new_context(viewport={"width": 1500, "height": 1000}).new_page()
            page.goto(f"{service.url}/bench#token={token}")
            page.get_by_text("source", exact=True).wait_for()
            arms.append(page.evaluate("performance.now()"))
            entries = "performance.getEntriesByName('first-contentful-paint').map(each => each.startTime)"
            while not (found := page.evaluate(entries)):
                page.wait_for_timeout(10)
            paints += found
            kinds = "[...performance.getEntriesByType('resource'), ...performance.getEntriesByType('navigation')]"
            sizes.append(page.evaluate(f"{kinds}.reduce((sum, each) => sum + each.transferSize, 0)"))
        browser.close()
    tell("first contentful paint, median", np.median(paints), f"ms (worst {max(paints):.0f})", "< 1000")
    tell("the arm is drawn, median", np.median(arms), f"ms (worst {max(arms):.0f})")
    tell("transferred without the 3D view", max(sizes) / 1000, "kB", "< 300")


if __name__ == "__main__":
    main()
