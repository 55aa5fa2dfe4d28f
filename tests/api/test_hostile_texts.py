"""Names and notes made to harm who looks at them: on a terminal, in a browser, in a log."""

import io
import json
import logging
import re
import sys
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from rich.table import Table
from typer.testing import CliRunner

from analysis.mitsuba.scene import read_mitsuba
from api.commands.main import app
from api.exports.formats import Options, export_dataset
from api.inert_console import InertConsole
from api.jobs.foreign_scene import check_foreign_scene
from api.logs import log_to_stderr
from api.results.imports import Request, imported_file
from api.results.products import report_dataset
from goniometer.campaigns.campaign_file import read_campaign
from goniometer.datasets.dataset import Check, Dataset
from goniometer.errors import DataFileError, InputError
from goniometer.files.dataset_file import reloaded
from goniometer.files.dataset_hdf5 import dataset_to_hdf5
from goniometer.storage.store import Store
from tests.drawn_dataset import drawn_dataset

COMMANDS = {
    "title of the window": "\x1b]0;owned\x07",
    "screen cleared": "\x1b[2J\x1b[H",
    "eight-bit command": "\x9b2J",
    "line written over": "all is well\r",
    "backspaces": "ok\x08\x08",
    "other direction": "\u202egpj.exe",
    "nothing to be seen": "a\u200b\u2060b",
}
MARKUP = (
    "<script>alert(1)</script><img src=x onerror=alert(1)>\"'><svg/onload=alert(1)> $x^$ $\\frac$ {{7*7}} [red]&amp;"
)


def hostile(text: str) -> Dataset:
    """A dataset that says `text` wherever it can."""
    return replace(
        drawn_dataset("sample-2", seed=5),
        sample=text,
        checks=(Check("energy", False, text), Check(text, None, text)),
        lineage={"imported": text, "notes": [text], "certificate_override": text, "simulated": text},
    )


@pytest.mark.parametrize("name", COMMANDS)
def test_nothing_that_is_printed_commands_the_terminal(name: str, tmp_path: Path) -> None:
    text = COMMANDS[name]
    Store.open(tmp_path / "bench.db").add_dataset(None, hostile(text))
    for command in (["status"], ["check", "1"], ["budget", "1", "--theta-in", "40", "--theta-out", "20"]):
        told = CliRunner().invoke(app, [*command, "-d", str(tmp_path / "bench.db")]).output
        assert told
        assert not [c for c in told if c != "\n" and not c.isprintable() and c in text]
    table = Table(text)
    table.add_row(text, text)
    terminal = InertConsole(force_terminal=False)
    with terminal.capture() as printed:
        terminal.print(text, markup=False)
        terminal.print(table)
    assert not [c for c in text if not c.isprintable() and c in printed.get()]


@pytest.mark.parametrize("name", [*COMMANDS.values(), "two\nlines", "a\ttab", "x" * 201])
def test_a_name_that_no_list_can_show_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a name is one line"):
        reloaded(Path("a.h5"), dataset_to_hdf5(replace(drawn_dataset("sample-2", seed=5), sample=name)))
    file = tmp_path / "a.csv"
    file.write_text("theta_in,theta_out,500,510,520,530,540\n20,20,1,2,3,4,5\n")
    stated = Request(
        file, name, 0.1, 0.1, aperture=1, angle_uncertainty=1, quantity="brdf", angles="deg", wavelengths="nm"
    )
    with pytest.raises(DataFileError, match="--sample"):
        imported_file(stated)
    with pytest.raises(InputError, match="a name is one line"):
        read_campaign({"name": "a", "samples": [{"name": name, "material": "sample-1"}]}, tmp_path)


class Page(HTMLParser):
    """The elements of a page, and their attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))


def check_page(text: str) -> None:
    """Nothing in a page runs or is fetched, and what somebody wrote is text."""
    for tag, attributes in Page(text).found:
        assert tag not in {"script", "iframe", "object", "embed", "base", "form", "foreignobject"}
        assert not [name for name in attributes if name.startswith("on")]
        for name in ("src", "href", "xlink:href"):
            assert (attributes.get(name) or "#").startswith(("#", "data:image/", "https://")) or re.fullmatch(
                r"[\w.-]+", attributes[name] or ""
            )


@pytest.mark.slow
def test_nothing_in_a_report_runs(tmp_path: Path) -> None:
    store = Store.open(tmp_path / "bench.db")
    made = store.add_dataset(None, hostile(MARKUP))
    text = report_dataset(store, made, tmp_path / "report.html").path.read_text()
    check_page(text)
    assert "&lt;script&gt;" in text
    for svg in re.findall(r"<svg.*?</svg>", text, re.S):
        ET.fromstring(svg)
    terms = Options(license="CC0-1.0", creators=("=1, <script>\n- [x](javascript:alert(1))",))
    folder = export_dataset(store, made, "package", tmp_path / "package", terms).path
    check_page((folder / "report.html").read_text())
    odd = export_dataset(store, made, "package", tmp_path / "...zip", terms).path
    with zipfile.ZipFile(odd) as archive:
        assert all(".." not in name and not name.startswith("/") for name in archive.namelist())
    for file in folder.rglob("*"):
        assert file.resolve().is_relative_to(folder.resolve())
        assert re.fullmatch(r"[\w.-]+", file.name)
    json.loads((folder / "datapackage.json").read_text())


def test_an_attached_file_is_one_line_of_the_checksums(tmp_path: Path) -> None:
    store = Store.open(tmp_path / "bench.db")
    made = store.add_dataset(None, drawn_dataset("sample-2", seed=5))
    file = tmp_path / "a\n0000  README.md"
    file.write_text("1")
    terms = Options(license="CC0-1.0", creators=("A",), attached=(file,))
    with pytest.raises(InputError, match="attached file"):
        export_dataset(store, made, "package", tmp_path / "package", terms)


@pytest.mark.parametrize(
    "name", ["../../etc/passwd", "/etc/passwd", "..", ".", "a/b", "C:\\x", 'a"b', "a\nb", "con", "é ü 漢", "$x^$"]
)
def test_the_name_of_a_sample_leads_to_no_other_folder(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    store = Store.open(tmp_path / "bench.db")
    made = store.add_dataset(None, replace(drawn_dataset("sample-2", seed=5), sample=name))
    written = export_dataset(store, made, "hdf5").path.resolve()
    assert written.parent == tmp_path.resolve()
    assert re.fullmatch(r"[\w-]+\.h5", written.name)


def test_a_line_of_the_log_stays_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    before = logging.getLogger().handlers[:], logging.getLogger().level
    try:
        log_to_stderr()
        text = 'a\n{"level": "CRITICAL", "message": "forged"}\r\n\x1b[2J\u2028'
        logging.getLogger("test").error("%s %s", text, text, exc_info=ValueError(text))
    finally:
        logging.getLogger().handlers[:], level = before
        logging.getLogger().setLevel(level)
    line, rest = capsys.readouterr().err.split("\n", 1)
    assert rest == ""
    assert json.loads(line)["message"] == f"{text} {text}"
    assert line.isprintable()


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_who_sits_at_a_terminal_reads_sentences_that_command_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    before = logging.getLogger().handlers[:], logging.getLogger().level
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    try:
        log_to_stderr()
        logging.getLogger("test").error("a\n12:00:00 CRITICAL: forged\x1b[2J")
    finally:
        logging.getLogger().handlers[:], level = before
        logging.getLogger().setLevel(level)
    assert re.fullmatch(r"\d\d:\d\d:\d\d ERROR: a\\n12:00:00 CRITICAL: forged\\x1b\[2J\n", terminal.getvalue())


LAUGHS = (
    '<!DOCTYPE scene [<!ENTITY a "ha">'
    + "".join(f'<!ENTITY {n} "{10 * f"&{m};"}">' for m, n in zip("abcdefgh", "bcdefghi", strict=True))
    + "]><scene>&i;</scene>"
)
SCENES = {
    "laughs": (LAUGHS, "entities"),
    "quadratic": (f'<!DOCTYPE s [<!ENTITY a "{50_000 * "x"}">]><s>{50_000 * "&a;"}</s>', "entities"),
    "a file": ('<!DOCTYPE s [<!ENTITY a SYSTEM "file:///etc/passwd">]><s>&a;</s>', "entities"),
    "a parameter": ('<!DOCTYPE s [<!ENTITY % a SYSTEM "http://127.0.0.1/x"> %a;]><s/>', "entities"),
    "nested": (100_000 * "<a>" + 100_000 * "</a>", "nested deeper"),
    "no end": (100_000 * "<a>", "not valid XML"),
    "twice": ('<scene a="1" a="2"/>', "not valid XML"),
    "a null character": ("<scene>\0</scene>", "not valid XML"),
}


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_neither_grows_nor_reads_other_files(name: str, tmp_path: Path) -> None:
    text, told = SCENES[name]
    file = tmp_path / "scene.xml"
    file.write_text(text)
    readers: list[Callable[[], object]] = [lambda: check_foreign_scene(text), lambda: read_mitsuba(file)]
    for read in readers:
        with pytest.raises(InputError, match=told) as refused:
            read()
        assert str(refused.value).isprintable()
        assert len(str(refused.value)) < 500
