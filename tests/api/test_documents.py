"""What the documents show is what the program takes."""

import importlib.util
import re
import shlex
import shutil
import sqlite3
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from api.settings import load_instrument
from goniometer.campaigns.campaign import Campaign, Sample
from goniometer.campaigns.campaign_file import load_campaign
from goniometer.certificates.certificate import Certificate
from goniometer.certificates.certificate_file import parse_certificate
from goniometer.storage.tables import BENCH
from tests.served import served

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
SERVICE = "http://127.0.0.1:8000"
"""Where the documents have it."""

ONLY_READ = re.compile(
    r"""
    .*--instrument\ docs/instrument.toml$         # devices that only a laboratory has
    | (demo|serve|run|characterise|abort|pause|resume)\b    # lasts, or wants a bench that runs
    | .*(theirs|raw)\.(json|csv|txt)\b            # files of somebody else
    | photos\b                                    # photographs that nobody took
    | (choose|render|report|stability|tradeoff|simulate\ (surface|rays|waves|grating|material|photos))\b    # take long
    | export\ .*\b(mitsuba|package)\b            # take long
    | .*--cluster\b                               # a cluster of somebody
    """,
    re.VERBOSE,
)
"""Commands that other tests run; here they are read by the command line, with all their options, and go no further."""

ENDS_WITH = {'goniometer check "Sample 1"': 1}
"""Exit codes other than 0: the text beside it says why."""


def blocks(document: Path, language: str) -> list[str]:
    """What stands between fences."""
    fenced = re.findall(r"^```(\w*)\n(.*?)^```$", document.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    return [text for name, text in fenced if name == language]


def lines(document: Path, program: str) -> list[str]:
    """Every command of that program in a document, without its comment."""
    found = (line for block in blocks(document, "") for line in block.splitlines() if line.startswith(program + " "))
    return [re.sub(r"\s+#.*", "", line) for line in found]


def first_mentions() -> Iterator[tuple[str, list[str], list[str]]]:
    """Of each document its name, the commands that no earlier one has, and its Python."""
    seen: set[str] = set()
    for document in DOCUMENTS:
        commands = [line for line in dict.fromkeys(lines(document, "goniometer")) if line not in seen]
        seen.update(commands)
        snippets = [text for text in blocks(document, "python") if SERVICE not in text]
        if commands or (snippets and document.name != "simulated-laboratory.md"):  # whose own test is below
            yield document.name, commands, snippets


@pytest.fixture
def folder(small: tuple[Path, dict[str, Any]]) -> Path:
    """A folder with a measured campaign and the documents, as a reader has who followed the README so far."""
    shutil.copytree(ROOT / "docs", small[0] / "docs")
    return small[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("commands", "snippets"), [pytest.param(*found[1:], id=found[0]) for found in first_mentions()]
)
def test_what_the_documents_tell_people_to_type_works(
    cli: Any,
    folder: Path,
    commands: list[str],
    snippets: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for line in commands:
        arguments = shlex.split(line)[1:]
        asked = ("--help",) if ONLY_READ.match(line.removeprefix("goniometer ")) else ()
        done = cli(*arguments, *asked, cwd=folder, typed="correct horse battery\n" * 2)
        assert done.returncode == (0 if asked else ENDS_WITH.get(line, 0)), f"{line}\n{done.stdout}{done.stderr}"
    monkeypatch.chdir(folder)
    for snippet in snippets:
        exec(snippet, {})
        assert capsys.readouterr().out


@pytest.mark.slow
def test_what_the_documents_ask_of_the_service_is_answered(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    urls = [shlex.split(line)[-1] for document in DOCUMENTS for line in lines(document, "curl")]
    snippets = [text for document in DOCUMENTS for text in blocks(document, "python") if SERVICE in text]
    assert urls
    assert snippets
    with served(folder) as service:
        monkeypatch.setenv("GONIOMETER_TOKEN", service.client.headers["Authorization"].removeprefix("Bearer "))
        for url in urls:
            assert service.client.get(url.removeprefix(SERVICE)).status_code == 200, url
        for snippet in snippets:
            exec(snippet.replace(SERVICE, service.url), {})
            assert capsys.readouterr().out


def test_every_piece_of_a_campaign_in_the_documents_is_accepted() -> None:
    pieces = blocks(ROOT / "docs" / "writing-a-campaign.md", "yaml")
    assert pieces
    for piece in pieces:
        Campaign.model_validate(
            {"name": "Any", "samples": [{"name": "Any", "material": "mirror"}]} | yaml.safe_load(piece)
        )


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.name)
def test_no_link_leads_nowhere_and_every_benchmark_that_is_named_is_there(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if not target.startswith("https://"):
            assert (document.parent / target).exists(), target
    for name in re.findall(r"python -m (tests\.[\w.]*\w)", text):
        assert importlib.util.find_spec(name) is not None, name


def test_the_certificate_in_the_documents_is_one() -> None:
    (text,) = blocks(ROOT / "docs" / "writing-a-campaign.md", "csv")
    shown = parse_certificate(text, "panel.csv")
    assert isinstance(shown, Certificate)
    assert shown.reflectance_8h.tolist() == [0.981, 0.991, 0.990]


def test_every_document_stands_in_the_index() -> None:
    index = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    pages = [path.name for path in (ROOT / "docs").glob("*.*") if path.suffix in {".md", ".yaml", ".toml", ".py"}]
    assert {name for name in pages if f"]({name})" not in index} == {"README.md"}


@pytest.mark.slow
def test_the_picture_of_the_readme_can_be_drawn_anew(folder: Path) -> None:
    command = [sys.executable, "docs/picture.py", "goniometer.db", "Sample 1", "picture.svg"]
    subprocess.run(command, cwd=folder, capture_output=True, timeout=300, check=True)
    drawn, kept = (
        ElementTree.parse(path).getroot() for path in (folder / "picture.svg", ROOT / "docs" / "picture.svg")
    )
    assert "Sample 1: colour of each direction" in ElementTree.tostring(drawn, encoding="unicode")
    assert len(drawn) == len(kept) == 4


def test_the_campaign_in_the_documents_shows_the_defaults() -> None:
    shown = load_campaign(ROOT / "docs" / "campaign.yaml")
    default = Campaign(name=shown.name, samples=(Sample(name="Sample 1", material="sample-1"),))
    assert shown.model_dump(exclude={"samples"}) == default.model_dump(exclude={"samples"})
    assert shown.samples[0].material == "sample-1"


def test_the_instrument_in_the_documents_is_accepted() -> None:
    shown = load_instrument(ROOT / "docs" / "instrument.toml")
    assert shown.bench == BENCH
    assert (shown.stages.sample.driver, shown.stages.detector.driver) == ("smc100", "oriental-az")
    assert (shown.geometry.u_angle, shown.geometry.aperture, shown.spectrometer.gain) == (0.005, 1.0, 5.0)


def test_the_script_in_the_documents_breaks_a_stage_and_the_driver_survives() -> None:
    code, _, _ = blocks(ROOT / "docs" / "simulated-laboratory.md", "python")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    *moves, happened = done.stdout.splitlines()
    assert [line.split() for line in moves] == [[str(angle), f"{angle}.0"] for angle in range(0, 90, 10)]
    assert "LOSE_REPLY" in happened
    assert "CORRUPT" in happened
    assert "asking again" in done.stderr


def test_a_script_of_ones_own_runs_on_the_bench_of_the_documents_though_its_devices_fail(
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, code, _ = blocks(ROOT / "docs" / "simulated-laboratory.md", "python")
    exec(code, {})
    here, *rest = capsys.readouterr().out.splitlines()
    assert here == "Geometry(theta_in=20.0, theta_out=40.0)"
    assert rest == ["(1044,)", "['lose-reply']", "['duplicate']"]


@pytest.mark.slow
def test_the_campaign_script_in_the_documents_measures_again_where_the_budget_says_so(tmp_path: Path) -> None:
    command = [sys.executable, "-W", "error::RuntimeWarning", str(ROOT / "docs" / "scripted_campaign.py")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=True)
    printed = done.stdout.splitlines()
    scans = [line.rsplit(":", 1)[0] for line in printed if not line.startswith(" ")]
    assert scans == ["Sheet, Sheet #1", "Sheet, Sheet #2", "Sheet, finer, Sheet"]
    worst = [float(re.findall(r"up to ([\d.]+)%", line)[0]) for line in printed if line.startswith(" ")]
    assert max(worst[-2:]) < 0.5 * min(worst[:2])
    assert len(list(tmp_path.glob("results/*/*/report.html"))) == 3
    with sqlite3.connect(tmp_path / "scripted.db") as database:  # the bench was opened once
        assert database.execute("SELECT count(DISTINCT session) FROM exposures").fetchone() == (1,)
    database.close()


def test_every_dependency_is_told_with_its_job_and_what_would_replace_it() -> None:
    told = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8").lower()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = [wanted for name, wanted in project["optional-dependencies"].items() if name != "dev"]
    names = [re.split(r"[\[>=<;]", wanted)[0].lower() for wanted in sum(extras, project["dependencies"])]
    assert [name for name in names if not re.search(rf"^\|.*\b{name}\b", told, re.MULTILINE)] == []
