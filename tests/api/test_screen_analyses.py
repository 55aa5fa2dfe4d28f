"""What a researcher and an admin see in a browser: analyses that are acted on, the bench's history, who may what."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from analysis.figures.page import png
from analysis.strict_json import strict_json
from analysis.tradeoff import Axis, Chart, Choice, Use, charts_json
from api.access.accounts import add_user
from api.access.tokens import create_token
from api.jobs.rows import add_job, begin, finish
from api.results.stability import stability_content
from simulators.stability.ensemble import cells
from simulators.stability.stability import Estimate, Job, Run
from tests.api.browser import Looker, looker, needs_chromium
from tests.drawn_dataset import drawn_dataset
from tests.served import TINY, Served, served

pytestmark = [pytest.mark.slow, needs_chromium]

SCANS = Chart(
    "scan-error",
    "Scanning: time at the bench against error",
    "Two of three are of use.",
    Axis("time at the bench", "min"),
    Axis("rms error", ""),
    (
        Choice("5°", "even grid of 5°", "uniform", 22, 21, 23, 2e-3, {"points": 306.0}, Use("campaign", {"step": 5.0})),
        Choice("0.01", "to 0.01", "dynamic", 5, 5, 6, 3e-4, {}, Use("campaign", {"tolerance": 0.01})),
        Choice("lmfit", "by lmfit", "fits", 9, 9, 9, 1e-4, {}, Use("fit", {"model": "local", "engine": "lmfit"})),
        Choice("rays", "1000 rays", "rays", 60, 50, 70, 1e-2, {}, Use("text", {"text": "goniometer simulate rays"})),
        Choice("one start", "as it is", "lmfit", 3, 3, 3, 1e-1),
    ),
)


def _run(method: str, seed: int, *, wrong: bool) -> Run:
    off = 6.5 if wrong else 0.4
    estimate = Estimate(1.2 + 0.01 * off, 0.01, 1.2)
    job = Job("few points", "6 points", method, seed)
    return Run(job, float(not wrong), True, wrong, {"h": off}, {"h": 0.01 * off}, 1.0, "reached", (), {"h": estimate})


def _choice() -> dict[str, Any]:
    score = {"mean": 0.4, "p95": 1.1, "expected": 0.5, "u_trace": 0.01, "low": 0.3, "high": 0.7}
    known = {"wavelengths_nm": [450.0, 600.0], "parameters": 3, "bytes": 12, "least_directions": 3, "nanoseconds": 40.0}
    rung = {"model": "cook-torrance", "name": "Cook-Torrance", "state": "meets", "why": "", "dE00": score} | known
    far = score | {"expected": 9.0, "low": 8.0, "high": 10.0}
    lambert = rung | {"model": "lambert", "name": "Lambert", "state": "fails", "why": "Far too matt.", "dE00": far}
    image = np.ones((8, 8, 4))
    pictures = [
        {"by": "shaded", "name": name, "words": f"by the {name}", "dE00_brightest": top, "png": png(image)}
        for name, top in (("measurement", None), ("model", None), ("difference", 2.0))
    ]
    return {
        "dataset": 1,
        "sample": "Plate",
        "words": ["Cook-Torrance meets dE00 1.", "Refused: Lambert.", "1 % of the pixels are dark."],
        "tolerance": 1.0,
        "chosen": rung,
        "rungs": [lambert, rung],
        "too_few_wavelengths": [],
        "rendered": None,
        "pictures": pictures,
    }


def _done(service: Served, kind: str, arguments: dict[str, Any], result: dict[str, Any]) -> int:
    store = service.live.store
    number = add_job(store, kind, json.dumps(arguments), "local", "test:1:0").id
    assert begin(store, number)
    assert finish(store, number, "done", result=strict_json(result))
    return number


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Served]:
    """A service with a dataset, and with a result of each kind."""
    with served(tmp_path) as found:
        found.live.store.add_dataset(None, drawn_dataset("sample-4"))
        yield found


@pytest.fixture
def looking(service: Served, tmp_path: Path) -> Iterator[Looker]:
    """The pages, opened by an admin."""
    with looker(tmp_path, service.url) as found:
        enter(found.page, service, "local")
        yield found
    assert found.faults == []
    assert found.strangers == [], "the page asked another server"


def enter(page: Page, service: Served, name: str) -> None:
    """Come in with a token of somebody."""
    token = create_token(service.live.store, name, "browser")[0]
    page.goto("about:blank")
    page.goto(f"{service.url}/bench#token={token}")
    expect(page.get_by_role("banner")).to_be_visible()


def test_a_mark_of_the_trade_off_becomes_a_campaign_a_fit_or_a_text_to_copy(service: Served, looking: Looker) -> None:
    number = _done(service, "tradeoff", {"kinds": ["scans"], "dataset": None}, {"charts": charts_json([SCANS])})
    page = looking.page
    page.goto(f"{service.url}/analysis/{number}")
    dynamic = page.get_by_role("button", name=re.compile("^dynamic, 0.01: to 0.01"))
    dynamic.hover()
    expect(page.get_by_text("Press it for a campaign with this resolution.")).to_be_visible()
    looking.look("tradeoff")
    dynamic.focus()
    page.keyboard.press("Enter")
    expect(page.get_by_label("Campaign (YAML)")).to_have_value(re.compile(r"resolution: \{tolerance: 0.01\}"))
    page.get_by_role("button", name="Look at the plan").click()
    expect(page.get_by_role("button", name="Start it")).to_be_enabled()
    page.go_back()
    page.get_by_role("button", name=re.compile("^fits, lmfit")).click()
    expect(page.get_by_label("fit another model")).to_have_value("local")
    expect(page.get_by_label("engine")).to_have_value("lmfit")
    page.go_back()
    page.get_by_role("button", name=re.compile("^rays, rays")).click()
    expect(page.get_by_text("goniometer simulate rays")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.get_by_text("goniometer simulate rays")).to_be_hidden()


def test_what_waits_is_put_into_another_order_by_dragging_and_by_the_keyboard(service: Served, looking: Looker) -> None:
    page = looking.page
    for name in ("First", "Second", "Third"):
        assert service.client.post("/api/queue", json={"campaign": TINY | {"name": name}}).is_success
    page.goto(f"{service.url}/queue")
    cards = page.get_by_role("region", name="Campaigns to be measured").get_by_role("listitem")

    def order(*names: str) -> None:
        expect(cards.locator(".name")).to_have_text(names)
        waiting = service.client.get("/api/queue").json()["items"]
        assert [entry["campaign"] for entry in waiting] == [*names]

    order("First", "Second", "Third")
    cards.nth(2).drag_to(cards.nth(0))
    order("Third", "First", "Second")
    cards.nth(0).drag_to(cards.nth(1))
    order("First", "Third", "Second")
    up = page.get_by_role("button", name="Move Second up")
    up.focus()
    page.keyboard.press("Enter")
    order("First", "Second", "Third")
    expect(up).to_be_focused()
    page.keyboard.press("Enter")
    order("Second", "First", "Third")
    expect(page.get_by_text("Second is number 1 of 3 now.")).to_be_attached()
    expect(page.get_by_role("button", name="Move Second down")).to_be_focused()


def test_a_cell_of_the_stability_map_opens_the_runs_behind_it(service: Served, looking: Looker) -> None:
    runs = [
        _run(method, seed, wrong=method == "global" and seed == 2) for method in ("local", "global") for seed in (1, 2)
    ]
    number = _done(service, "stability", {"runs": 2}, stability_content(cells(runs), runs))
    page = looking.page
    page.goto(f"{service.url}/analysis/{number}")
    expect(page.get_by_text("1 of 4 fits were wrong and did not say so")).to_be_visible()
    page.get_by_role("button", name=re.compile("few points, 6 points, local")).focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    runs_shown = page.get_by_role("region", name="Runs behind the cell")
    expect(runs_shown.get_by_role("row", name=re.compile("^2 .*1.265.*6.5.*wrong without a word"))).to_be_visible()
    looking.look("stability")
    address = page.url
    page.keyboard.press("Escape")
    expect(runs_shown).to_be_hidden()
    page.goto(address)
    expect(runs_shown).to_be_visible()


def test_a_choice_shows_its_ladder_and_the_pair_of_pictures(service: Served, looking: Looker) -> None:
    number = _done(service, "choose", {"dataset": 1, "scene": "camera: {}"}, _choice())
    page = looking.page
    page.goto(f"{service.url}/analysis/{number}")
    expect(page.get_by_role("row", name=re.compile("^fails Lambert Far too matt"))).to_be_visible()
    expect(page.get_by_role("row", name=re.compile("^meets the tolerance Cook-Torrance")).first).to_be_visible()
    pictures = page.locator("img")
    expect(pictures, "both, one over the other, each alone, and the difference").to_have_count(5)
    for which in range(5):
        expect(pictures.nth(which)).to_have_js_property("naturalWidth", 8)
    looking.look("choice")


def test_an_admin_lets_somebody_in_keeps_them_out_and_makes_a_token_that_is_shown_once(
    service: Served, looking: Looker
) -> None:
    page = looking.page
    page.get_by_role("link", name=re.compile("^local")).click()
    expect(page.get_by_text("this browser")).to_be_visible()
    users = page.get_by_role("region", name="Users")
    users.get_by_label("name", exact=True).fill("anna")
    users.get_by_label("role of the new user").select_option("viewer")
    users.get_by_label("first password").fill("a long one of hers")
    users.get_by_role("button", name="Let them in").click()
    expect(users.get_by_text("anna may come in now, as viewer.")).to_be_visible()
    users.get_by_label("Role of anna").select_option("operator")
    expect(users.get_by_text("anna is operator now.")).to_be_visible()
    users.get_by_role("button", name="Set the password of anna").click()
    users.get_by_label("New password of anna").fill("another long one")
    users.get_by_role("button", name="Set", exact=True).click()
    expect(users.get_by_text("their sessions have ended")).to_be_visible()
    assert service.client.post("/api/login", json={"name": "anna", "password": "another long one"}).is_success
    users.get_by_role("button", name="Keep out: anna").click()
    expect(users.get_by_text("kept out; their")).to_be_visible()

    tokens = page.get_by_role("region", name="Tokens")
    tokens.get_by_label("what it is for").fill("night script")
    tokens.get_by_role("button", name="Make a token").click()
    secret = tokens.locator("code").inner_text()
    headers = {"Authorization": f"Bearer {secret}"}
    assert service.client.get("/api/me", headers=headers).json()["role"] == "operator"
    looking.look("account")
    page.reload()
    expect(tokens.get_by_text("night script")).to_be_visible()
    assert secret not in page.content()
    page.on("dialog", lambda dialog: dialog.accept())
    tokens.get_by_role("button", name="Revoke night script").click()
    expect(tokens.get_by_text("night script")).to_be_hidden()
    assert service.client.get("/api/me", headers=headers).status_code == 401


def test_who_may_not_is_told_so_and_a_place_that_is_none_says_where_to_go(service: Served, looking: Looker) -> None:
    page = looking.page
    add_user(service.live.store, "vera", "viewer", None)
    enter(page, service, "vera")
    expect(page.get_by_role("button", name="Stop")).to_be_disabled()
    page.goto(f"{service.url}/log")
    expect(page.get_by_text("This needs the role operator")).to_be_visible()
    looking.look("not-allowed")
    page.goto(f"{service.url}/datasets/4711")
    expect(page.get_by_text("There is no dataset 4711")).to_be_visible()
    looking.look("no-dataset")
    page.goto(f"{service.url}/no/such/place")
    expect(page.get_by_role("link", name="To the bench")).to_be_visible()
    page.goto(f"{service.url}/calibration")
    expect(page.get_by_text("No scan has come to its end yet.")).to_be_visible()


def test_datasets_are_found_by_quality_and_pinned_cells_are_in_the_address(service: Served, looking: Looker) -> None:
    page = looking.page
    page.goto(f"{service.url}/datasets?operator=nobody")
    expect(page.get_by_role("heading", name="No dataset is like that")).to_be_visible()
    page.goto(f"{service.url}/datasets")
    page.get_by_label("quality").select_option("all checks passed")
    page.get_by_role("link", name="sample-4", exact=True).click()
    chart = page.get_by_role("application", name=re.compile("In-plane map"))
    chart.focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    expect(page.get_by_role("button", name="unpin")).to_be_visible()
    page.reload()
    expect(page.get_by_role("button", name="unpin")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.get_by_role("button", name="unpin")).to_be_hidden()
