"""A browser for tests of the pages, that keeps pictures and asks what people with other eyes or hands cannot use."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect, sync_playwright

from tests.served import PATIENCE

CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")

needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: nobody looks at the pages")


@dataclass
class Looker:
    """A page, and what was wrong with all that it showed."""

    page: Page
    shots: Path
    faults: list[str] = field(default_factory=list)
    strangers: list[str] = field(default_factory=list)
    """Addresses on other servers that the page asked for."""

    def look(self, name: str) -> None:
        """Keep a picture, dark and light, and ask axe."""
        for scheme in ("dark", "light"):
            self.page.emulate_media(color_scheme=scheme)
            self.page.screenshot(path=self.shots / f"{name}-{scheme}.png", full_page=True)
            found = Axe().run(self.page)
            self.faults += [f"{name}, {scheme}: {each['id']}: {each['help']}" for each in found.response["violations"]]


@contextmanager
def looker(folder: Path, url: str, width: int = 1500, height: int = 1000) -> Iterator[Looker]:
    """A page of this size; pictures go to SCREENSHOTS or below `folder`, and `url` is whom the page may ask."""
    shots = Path(os.environ.get("SCREENSHOTS", folder / "screenshots"))
    shots.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        context = browser.new_context(viewport={"width": width, "height": height}, accept_downloads=True)
        context.set_default_timeout(1000 * PATIENCE)
        expect.set_options(timeout=1000 * PATIENCE)
        found = Looker(context.new_page(), shots)
        found.page.on("request", lambda asked: None if asked.url.startswith(url) else found.strangers.append(asked.url))
        found.page.on("pageerror", lambda error: found.faults.append(str(error)))
        yield found
        browser.close()
