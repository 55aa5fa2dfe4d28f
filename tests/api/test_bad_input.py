"""Whatever is wrong with what the user gave: one line that says what and where, and the right exit code."""

import json
from pathlib import Path
from typing import Any

import pytest

from goniometer.campaigns.campaign import Campaign, Sample
from goniometer.storage.store import Store

SAMPLE = "samples: [{name: A, material: sample-1}]\n"

CAMPAIGNS = {
    "name: t\nsamples: [{name: A, materiel: sample-1}]\n": ["samples[0].materiel", 'did you mean "material"'],
    f"name: t\n{SAMPLE}incident: [10 nm]\n": ["incident[0]", "nm", "deg"],
    f"name: t\n{SAMPLE}incident: [95]\n": ["incident", "95 deg", "between 0 and 85"],
    f"name: t\n{SAMPLE}outgoing: {{start: -100}}\n": ["outgoing.start", "-85"],
    f"name: t\n{SAMPLE}integration: {{maximum: 3 deg}}\n": ["integration.maximum", "deg", "ms"],
    "name: t\nsamples: [{name: A, material: sample-9}]\n": ["sample-9", "sample-1", "mirror"],
    f"name: t\n{SAMPLE}reference: {{certificate: panel.csv}}\n": ["panel.csv"],
    "name: t\nsamples: [{name: A+, material: sample-1}, {name: A-, material: sample-2}]\n": ["A+", "A-", "folder"],
    "name: [t\n": ["not valid YAML", "line"],
    "": ["mapping"],
}


@pytest.mark.parametrize("content", CAMPAIGNS, ids=range(len(CAMPAIGNS)))
def test_a_wrong_campaign_is_refused_in_one_line_before_anything_moves(cli: Any, tmp_path: Path, content: str) -> None:
    (tmp_path / "c.yaml").write_text(content)
    done = cli("run", "c.yaml", cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    for part in CAMPAIGNS[content]:
        assert part in done.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["run"], 2, ["campaign", "--help"]),
        (["frobnicate"], 2, ["frobnicate"]),
        (["run", "nowhere.yaml"], 2, ["nowhere.yaml", "cannot be read"]),
        (["status"], 2, ["goniometer.db", "goniometer run"]),
        (["run", "c.yaml", "--instrument", "nowhere.toml"], 2, ["nowhere.toml"]),
        (["run", "c.yaml", "--database", "no/such/folder/x.db"], 1, ["no/such/folder"]),
        (["run", "c.yaml", "--database", "c.yaml"], 1, ["c.yaml", "not a database"]),
    ],
)
def test_a_wrong_command_is_refused_in_one_line(
    cli: Any, tmp_path: Path, arguments: list[str], code: int, words: list[str]
) -> None:
    (tmp_path / "c.yaml").write_text(f"name: t\n{SAMPLE}")
    done = cli(*arguments, cwd=tmp_path)
    assert done.returncode == code, done.stderr
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    for word in words:
        assert word in done.stderr


INSTRUMENT = """
[stages.sample]
driver = "smc100"
url = "socket://127.0.0.1:9"
[stages.detector]
driver = "oriental-az"
url = "tcp://127.0.0.1:9"
"""


def test_a_missing_device_is_named_in_one_line(cli: Any, tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(f"name: t\n{SAMPLE}\nreference: {{override: {{name: me, reason: a test}}}}\n")
    (tmp_path / "i.toml").write_text(INSTRUMENT)
    done = cli("run", "c.yaml", "--instrument", "i.toml", cwd=tmp_path)
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert "spectrometer" in done.stderr


SHORT = """
[stages.sample]
driver = "smc100"
url = "socket://127.0.0.1:9"
limits = [0, 40]
[stages.detector]
driver = "smc100"
url = "socket://127.0.0.1:8"
"""


@pytest.mark.parametrize(
    ("content", "instrument", "words"),
    [
        ("name: t\nsamples: [{name: A, material: sample-9}]\n", None, [["sample-9"]]),
        ("name: t\nsamples: [{name: A, material: 'file:nosuch.npz'}]\n", None, [["nosuch.npz"]]),
        (f"name: t\n{SAMPLE}reference: {{certificate: nosuch.csv}}\n", None, [["nosuch.csv"]]),
        (f"name: t\n{SAMPLE}incident: [80]\n", SHORT, [["nobody has measured this panel"], ["80", "40"]]),
        (f"name: t\n{SAMPLE}", None, []),
    ],
)
def test_a_plan_ends_with_a_line_for_each_reason_for_which_a_run_would_be_refused(
    cli: Any, tmp_path: Path, content: str, instrument: str | None, words: list[list[str]]
) -> None:
    (tmp_path / "c.yaml").write_text(content)
    bench: list[str] = []
    if instrument is not None:
        (tmp_path / "i.toml").write_text(instrument)
        bench = ["--instrument", "i.toml"]
    done = cli("plan", "c.yaml", *bench, cwd=tmp_path)
    assert done.returncode == (2 if words else 0)
    assert "Campaign t" in done.stdout
    lines = done.stderr.strip().splitlines()
    assert len(lines) == len(words), done.stderr
    for line, parts in zip(lines, words, strict=True):
        assert line.startswith("goniometer: ")
        assert all(part in line for part in parts), line
    as_json = cli("plan", "c.yaml", *bench, "--json", cwd=tmp_path)
    assert as_json.returncode == done.returncode
    assert [f"goniometer: {finding}" for finding in json.loads(as_json.stdout)["findings"]] == lines
    assert not list(tmp_path.glob("*.db"))


def test_a_plan_reads_a_database_that_is_named_and_makes_none(cli: Any, tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text(f"name: t\n{SAMPLE}")
    for refused in (["-d", "nosuch.db"], ["--bench", "second"]):
        done = cli("plan", "c.yaml", *refused, cwd=tmp_path)
        assert done.returncode == 2
        assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert not list(tmp_path.glob("*.db"))
    store = Store.open(tmp_path / "some.db")
    store.add_campaign(Campaign(name="T", samples=(Sample(name="A", material="sample-1"),)))
    store.close()
    done = cli("plan", "c.yaml", "-d", "some.db", cwd=tmp_path)
    assert done.returncode == 2
    assert 'The campaigns "T" and "t" would both be kept in the folder t' in done.stderr


@pytest.mark.parametrize("command", [["run", "c.yaml"], ["serve", "--port", "0"]])
def test_results_that_would_have_no_place_are_refused_before_the_bench_moves(
    cli: Any, tmp_path: Path, command: list[str]
) -> None:
    (tmp_path / "c.yaml").write_text(f"name: t\n{SAMPLE}")
    done = cli(*command, "--output", "c.yaml", cwd=tmp_path)
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert "c.yaml" in done.stderr
    assert "cannot be made" in done.stderr
    assert done.stdout == ""
    assert Store.open(tmp_path / "goniometer.db").campaigns() == {}  # one is begun once the bench answers


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (INSTRUMENT.replace("tcp://127.0.0.1:9", "tcp://h:99999"), ["stages.detector", "tcp://host:port"]),
        (INSTRUMENT.replace("smc100", "smc1000"), ["stages.sample.driver", "smc100"]),
        (INSTRUMENT.replace("url", "port", 1), ["stages.sample", "url"]),
        (INSTRUMENT.replace("tcp://127.0.0.1:9", "COM3"), ["stages.detector", "tcp://host:port"]),
        ("[stages.sample", ["TOML"]),
    ],
)
def test_a_wrong_instrument_file_is_refused_in_one_line(cli: Any, tmp_path: Path, wrong: str, words: list[str]) -> None:
    (tmp_path / "c.yaml").write_text(f"name: t\n{SAMPLE}")
    (tmp_path / "i.toml").write_text(wrong)
    done = cli("run", "c.yaml", "--instrument", "i.toml", cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    for word in words:
        assert word in done.stderr


def test_a_real_bench_without_a_certificate_measures_nothing_until_somebody_answers_for_it(
    cli: Any, tmp_path: Path
) -> None:
    (tmp_path / "c.yaml").write_text(f"name: t\n{SAMPLE}")
    (tmp_path / "i.toml").write_text(INSTRUMENT)
    done = cli("run", "c.yaml", "--instrument", "i.toml", cwd=tmp_path)
    assert done.returncode == 2
    assert "nobody has measured this panel" in done.stderr
    assert "override" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
