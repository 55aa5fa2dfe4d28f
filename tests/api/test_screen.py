"""What an operator sees in a browser, driven as an operator drives it."""

import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.api.browser import looker, needs_chromium
from tests.served import PATIENCE, wait_for

STATIC = Path(__file__).parents[2] / "api" / "static"

pytestmark = [pytest.mark.slow, needs_chromium]

CAMPAIGN = """
name: First day
samples:
  - {name: Sample 1, material: sample-1}
incident: [15, 30, 45, 60]
outgoing: {start: -40, stop: 60}
resolution: {mode: uniform, step: 1}
reference: {step: 20, scans: 1}
stray_light: false
monitor: null
"""
POINTS = 360
"""Of the sample at least: there is time to pause it, and to see it measured afterwards."""


@contextmanager
def service(folder: Path, port: int) -> Iterator[str]:
    """`goniometer serve` in a process of its own, which is told to end as systemd does; what it prints for people."""
    command = [str(Path(sys.executable).with_name("goniometer")), "serve", "--port", str(port)]
    said = folder / f"said-{len(list(folder.glob('said-*')))}"
    with said.open("w") as out, (folder / "log").open("a") as log:
        process = subprocess.Popen(command, cwd=folder, stdout=out, stderr=log)
    try:
        url = f"http://127.0.0.1:{port}"
        wait_for(lambda: _answers(url))
        yield said.read_text()
    finally:
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE) == 0, (folder / "log").read_text()


def _answers(url: str) -> bool:
    try:
        return httpx.get(f"{url}/health", trust_env=False).is_success
    except httpx.TransportError:
        return False


@pytest.fixture
def port() -> int:
    """One that nobody listens on."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


def test_a_first_time_operator_measures_a_sample_and_takes_the_result_home(tmp_path: Path, port: int) -> None:
    url = f"http://127.0.0.1:{port}"

    def state(page: Page, words: str) -> None:
        expect(page.get_by_role("banner").get_by_role("status")).to_contain_text(words)

    with looker(tmp_path, url) as looking:
        page, look = looking.page, looking.look
        with service(tmp_path, port) as said:
            # the first start prints an address that lets its reader in
            address = re.search(r"http://\S+#token=\S+", said)
            assert address is not None, said
            page.goto(url)
            expect(page.get_by_role("button", name="Log in")).to_be_visible()
            look("login")
            page.goto("about:blank")
            page.goto(address[0])
            state(page, "Not connected")
            assert "token" not in page.url
            look("bench")

            page.get_by_role("link", name="Queue").click()
            new = page.get_by_role("region", name="A new campaign")
            new.get_by_label("Campaign (YAML)").fill(CAMPAIGN.replace("samples:", "sample:"))
            new.get_by_role("button", name="Look at the plan").click()
            expect(new.get_by_role("alert")).to_contain_text("lines 3 and 2: sample: there is no such key")
            look("refused")
            new.get_by_label("Campaign (YAML)").fill(CAMPAIGN)
            expect(new.get_by_role("alert")).to_have_count(0)
            new.get_by_role("button", name="Look at the plan").click()
            expect(page.get_by_role("heading", name="First day")).to_be_visible()
            look("plan")
            page.get_by_role("button", name="Start it").click()

            expect(page.get_by_text("Mount", exact=False).first).to_be_visible()
            look("mount")
            page.get_by_role("button", name="It is mounted", exact=True).click()
            expect(page.get_by_text("Mount Sample 1").first).to_be_visible()
            page.get_by_role("button", name="It is mounted", exact=True).click()
            state(page, "Sample 1")
            page.get_by_role("button", name=re.compile("^Pause")).click()
            state(page, "Paus")
            page.reload()
            state(page, "Paused")
            assert page.get_by_text("Nothing is waiting").count() == 0, "said before the queue was read"
            look("paused")
            done = page.get_by_text(re.compile(r"\d+ of about \d+ points")).inner_text()

        with service(tmp_path, port) as said:
            assert "#token=" not in said
            # the page that was open comes back by itself, and what was measured is still there
            expect(page.get_by_text("The service does not answer")).to_be_hidden()
            expect(page.get_by_role("button", name="Go on")).to_be_visible()
            assert page.get_by_text(re.compile(r"\d+ of about \d+ points")).inner_text() == done
            page.get_by_role("button", name="Go on").click()
            page.get_by_role("button", name="It is mounted", exact=True).click()
            page.get_by_role("link", name="Bench").click()
            state(page, "Measuring")
            expect(page.get_by_label("Raw counts of the last spectrum against wavelength")).to_be_visible()
            look("measuring")

            page.get_by_role("link", name="Queue").click()
            page.get_by_role("link", name="its datasets").click()
            page.get_by_role("link", name="Sample 1", exact=True).click()
            chart = page.get_by_role("application", name=re.compile("In-plane map"))
            chart.focus()
            page.keyboard.press("ArrowRight")
            page.keyboard.press("Enter")
            expect(page.get_by_role("button", name="unpin")).to_be_visible()
            for tab in ("distributions", "slopes", "models", "quality", "lineage", "export"):
                page.get_by_role("tab", name=tab).click()
                page.wait_for_load_state("networkidle")
                look(f"dataset-{tab}")
            page.get_by_role("button", name="Export to csv").click()
            with page.expect_download() as download:
                page.get_by_role("link", name=re.compile(r"\.csv$")).first.click()
            assert download.value.path().read_text().count("\n") > POINTS

            for name in ("Datasets", "Calibration", "Analysis", "Exports", "Log"):
                page.get_by_role("link", name=name, exact=True).first.click()
                expect(page.get_by_role("heading", level=1)).to_be_visible()
                page.wait_for_timeout(500)
                look(name.lower())
            page.get_by_role("button", name="Verify the whole log").click()
            expect(page.get_by_text("as they were written")).to_be_visible()
    assert looking.faults == []
    assert looking.strangers == [], "the page asked another server"
