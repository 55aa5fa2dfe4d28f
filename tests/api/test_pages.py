"""The pages, their headers, and what a watchman reads of the service."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from api.bench.queue import add_entry
from api.web import pages
from api.web.access import Access
from api.web.live import open_live
from goniometer.campaigns.campaign import Campaign, Sample
from tests.api.service_client import Client

BUILT = {"index.html": "<!doctype html>", "assets/app-1a2b.js": "let x;", "favicon.svg": "<svg/>"}


@pytest.fixture
def client(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Client]:
    """A service with pages built into it, and one campaign in its queue."""
    static = tmp_path / "static"
    for name, content in BUILT.items():
        file = static / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(content)
    (tmp_path / "secret.txt").write_text("not a page")
    monkeypatch.setattr(pages, "STATIC", static)
    with open_live(tmp_path / "bench.db", tmp_path) as live:
        add_entry(live.store, Campaign(name="One", samples=(Sample(name="A", material="sample-1"),)), "anna")
        yield Client(live)


def test_every_place_in_the_application_can_be_reloaded_and_is_never_stale(client: Client) -> None:
    for place in ("/", "/queue", "/datasets/7/slopes"):
        answer = client.get(place)
        assert answer.text == BUILT["index.html"]
        assert answer.headers["cache-control"] == "no-cache"
        assert "default-src 'self'" in answer.headers["content-security-policy"]
        assert answer.headers["x-content-type-options"] == "nosniff"
    script = client.get("/assets/app-1a2b.js")
    assert "immutable" in script.headers["cache-control"]
    assert script.headers["content-type"].startswith("text/javascript")
    assert client.get("/favicon.svg").headers["cache-control"] == "no-cache"


@pytest.mark.parametrize("path", ["/../secret.txt", "/..%2fsecret.txt", "/assets/gone.js", "/api/gone", "/gone.png"])
def test_what_is_no_page_is_not_there_and_no_file_outside_is_told(client: Client, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


def test_an_installation_without_pages_says_so(client: Client) -> None:
    (pages.STATIC / "index.html").unlink()
    answer = client.get("/")
    assert answer.status_code == 404
    assert "not built into this installation" in answer.json()["detail"]


def test_a_watchman_reads_what_is_queued_and_how_requests_were_answered(client: Client) -> None:
    client.get("/health")
    client.get("/api/nothing/like/this")
    families = {family.name: family for family in text_string_to_metric_families(client.get("/metrics").text)}
    queued = {sample.labels["phase"]: sample.value for sample in families["goniometer_queue_entries"].samples}
    assert queued == {"idle": 1, "queued": 0, "running": 0}
    answered = {
        (sample.labels["route"], sample.labels["status"]): sample.value
        for sample in families["goniometer_requests"].samples
        if sample.name.endswith("_total")
    }
    assert answered["/health", "200"] == 1
    assert ("/api/nothing/like/this", "404") not in answered, "paths that lead nowhere are not told one by one"
    assert families["goniometer_bench_up"].samples[0].value == 0, "no process was started here"


def test_from_elsewhere_metrics_need_a_token(tmp_path: Path) -> None:
    with open_live(tmp_path / "bench.db", tmp_path) as live:
        proxied = Client(live, Access(loopback=False, secure=True))
        assert proxied.get("/metrics").status_code == 401
        assert proxied.get("/health").status_code == 200
