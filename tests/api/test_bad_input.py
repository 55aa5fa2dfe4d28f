"""Whatever is wrong with what the user gave: one line that says what and where, and the right exit code."""

from pathlib import Path
from typing import Any

import pytest

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
