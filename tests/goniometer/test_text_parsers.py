"""Whatever somebody writes into a file, it is read or refused in one line."""

import json
import math
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import strategies as st

from api.settings import load_instrument
from goniometer.campaigns.campaign_file import load_campaign
from goniometer.certificates.certificate import Certificate
from goniometer.certificates.certificate_file import certificate_csv, parse_certificate, read_certificate
from goniometer.errors import CampaignError, CertificateError, ConfigurationError, GoniometerError
from tests.bombarded import bombarded

SHOWN = Path(__file__).parents[2] / "docs"


@pytest.fixture
def file() -> Iterator[Path]:
    """A file in memory where there is such a folder."""
    memory = Path("/dev/shm")
    folder = Path(tempfile.mkdtemp(dir=memory if memory.is_dir() else None))
    yield folder / "file"
    shutil.rmtree(folder)


def refusal(read: Callable[[], object], kind: type[GoniometerError], names: str) -> str:
    """What `read` refuses its file with, which must be one line that names it; empty when it takes the file."""
    try:
        read()
    except kind as error:
        message = str(error)
    else:
        return ""
    assert message.startswith(names)
    assert message.isprintable()
    return message.removeprefix(names).strip(": ") or "nothing"


too_much = st.sampled_from(["[" * 400, "{" * 400, "- " * 400, "9" * 5000, "1e999", "2020-13-45", "\0", "\ufeff"])
odd_values: list[Any] = [
    None, True, False, 0, -1, 1, 7, 90, 1e308, -1e308, math.inf, math.nan, 10**400, "", "x", "10 deg", "nan", "inf",
    "1e999 s", "a\0b", "a\nb", "\x1b[31m", "\ud800", [], [1], [1, 2], [2, 1], ["a", "b"], {}, {"x": 1}, {"start": 1},
    [[]], [{}], "/dev/ttyUSB0", "socket://h", "socket://h:99999", "socket://[", "tcp://h:1", "smc100", "owis", "k10cr1",
    "oriental-az", "x" * 300,
]  # fmt: skip
values = st.sampled_from(odd_values)


def replaced(content: Any, path: list[int], value: Any, key: str | None) -> Any:
    """`content` with what stands at the end of `path` replaced by `value`, or renamed to `key`."""
    if not path or not isinstance(content, dict | list) or not content:
        return value
    if isinstance(content, list):
        at = path[0] % len(content)
        return [*content[:at], replaced(content[at], path[1:], value, key), *content[at + 1 :]]
    name = list(content)[path[0] % len(content)]
    if len(path) == 1 and key is not None:
        return {key if other == name else other: inner for other, inner in content.items()}
    return content | {name: replaced(content[name], path[1:], value, key)}


paths = st.lists(st.integers(0, 11), min_size=1, max_size=4)
keys = st.sampled_from([None, None, None, "x", "stepp", "", "1", "driver", "steps", "a\nb"])


def spoilt(text: str, alphabet: str) -> st.SearchStrategy[str]:
    """A file in which a few characters were replaced."""
    return st.builds(
        lambda at, length, other: text[:at] + other + text[at + length :],
        st.integers(0, len(text)),
        st.integers(0, 12),
        st.one_of(st.text(alphabet=alphabet, max_size=8), st.text(max_size=4), too_much),
    )


CAMPAIGN = {
    "name": "First light",
    "seed": 3,
    "samples": [{"name": "Sample 1", "material": "sample-1"}, {"name": "b", "material": "c", "description": "d"}],
    "incident": {"start": 0, "stop": "80 deg", "step": 20},
    "outgoing": {"start": -80, "stop": 80},
    "resolution": {"tolerance": 0.02, "step": 10, "minimum_step": "0.5 deg", "time": "2 min"},
    "integration": {"minimum": "8 ms", "maximum": 30, "fill": 0.7, "scans": 1},
    "reference": {"certificate": "panel.csv", "step": 10, "scans": 2},
}
SHORT_CAMPAIGN = """name: a
samples: [{name: s, material: m}]
incident: {start: 0, stop: 0.5 rad, step: 10}
"""
campaigns = st.one_of(
    st.builds(lambda path, value, key: json.dumps(replaced(CAMPAIGN, path, value, key)), paths, values, keys),
    spoilt(SHORT_CAMPAIGN, "{}[]:,-&*!|>'\"#% \n\t0123456789.eax<"),
    spoilt(SHORT_CAMPAIGN, "{}[]:,-&*!|>'\"#% \n\t0123456789.eax<").map(lambda text: text.encode("utf-8", "replace")),
    st.binary(max_size=20),
)


def written(file: Path, content: str | bytes) -> Path:
    file.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))
    return file


@bombarded(campaigns)
def test_any_campaign_file_is_a_campaign_or_refused_in_one_line(file: Path, content: str | bytes) -> None:
    campaign = None

    def read() -> None:
        nonlocal campaign
        campaign = load_campaign(written(file, content))

    if not refusal(read, CampaignError, str(file)):
        assert campaign is not None
        assert all(0 <= angle <= 85 for angle in campaign.theta_in)
        assert 0 < campaign.integration.minimum <= campaign.integration.maximum < math.inf
        assert len(campaign.hash) == 64


def toml(value: Any) -> str:
    """A value as TOML writes it; what TOML does not have, as something that it must refuse."""
    match value:
        case dict():
            return "{" + ", ".join(f"{json.dumps(key)} = {toml(inner)}" for key, inner in value.items()) + "}"
        case list():
            return "[" + ", ".join(map(toml, value)) + "]"
        case float() if not math.isfinite(value):
            return "nan" if math.isnan(value) else "inf"
    return (
        json.dumps(value, ensure_ascii=False) if isinstance(value, str) and value.isprintable() else json.dumps(value)
    )


INSTRUMENT = {
    "stages": {
        "sample": {
            "driver": "smc100",
            "url": "/dev/ttyUSB0",
            "address": 1,
            "limits": [0, 80],
            "direction": -1,
            "scale": 1.0,
        },
        "detector": {"driver": "oriental-az", "serial_number": "A10K3XYZ", "unit": 2, "velocity": 30, "zero": 1.5},
    },
    "spectrometer": {"gain": 5, "cooler_set_point": -10, "serial_number": "QEP1"},
    "geometry": {"u_angle": 0.005, "aperture": 1.0},
    "forbidden": [{"sample": [60, 90], "detector": [-85, -60]}],
}
SHORT_INSTRUMENT = """[stages.sample]
driver = "owis"
url = "COM3"
counts_per_degree = 1e3
[stages.detector]
driver = "k10cr1"
url = "COM4"
"""
instruments = st.one_of(
    st.builds(
        lambda path, value, key: (
            "\n".join(f"{json.dumps(k)} = {toml(v)}" for k, v in changed.items())
            if isinstance(changed := replaced(INSTRUMENT, path, value, key), dict)
            else toml(changed)
        ),
        paths,
        values,
        keys,
    ),
    spoilt(SHORT_INSTRUMENT, "{}[]=,\"'#\n\t0123456789.e-:TZ_ax"),
    spoilt(SHORT_INSTRUMENT, "{}[]=,\"'#\n\t0123456789.e-:TZ_ax").map(lambda text: text.encode("utf-8", "replace")),
    st.binary(max_size=20),
)


@bombarded(instruments)
def test_any_instrument_file_describes_a_bench_or_is_refused_in_one_line(file: Path, content: str | bytes) -> None:
    bench = None

    def read() -> None:
        nonlocal bench
        bench = load_instrument(written(file, content))

    if not refusal(read, ConfigurationError, str(file)):
        assert bench is not None
        for stage in (bench.stages.sample, bench.stages.detector):
            assert math.isfinite(stage.mounting.angle(1.0))
            assert stage.limits is None or -math.inf < stage.limits[0] < stage.limits[1] < math.inf


CERTIFICATE = """# serial_number: 99AA-1
# calibrated: 2024-02-29
# valid_until: 2026-02-28
wavelength_nm,reflectance,standard_uncertainty
400,0.987,0.003
700,0.988,0.003
1000,0.990,0.004
"""
TABLE = """# serial_number: 99AA-1
# calibrated: never
theta_in,theta_out,wavelength_nm,brdf,standard_uncertainty
0,-60,400,0.30,0.003
0,60,400,0.31,0.003
0,-60,800,0.32,0.003
0,60,800,0.33,0.003
50,-60,400,0.34,0.003
50,60,400,0.35,0.003
50,-60,800,0.36,0.003
50,60,800,0.37,0.003
"""
cells = st.sampled_from(["nan", "inf", "-1", "0", "1e999", "", "0.5", "1_0", "\u0663", "9" * 5000, "x", "1e-400"])
certificates = st.one_of(
    spoilt(CERTIFICATE, "0123456789.,-+einfa#: \n\r\x0b_"),
    spoilt(TABLE, "0123456789.,-+einfa#: \t\n\r\x0b_"),
    st.builds(lambda row: CERTIFICATE + ",".join(row) + "\n", st.lists(cells, max_size=4)),
    st.builds(lambda row: TABLE + ",".join(row) + "\n", st.lists(cells, max_size=6)),
    st.builds(
        lambda day: CERTIFICATE.replace("2024-02-29", day),
        st.one_of(st.text(max_size=10), st.from_regex(r"\A\d{4}-\d\d-\d\d\Z")),
    ),
    st.text(max_size=40),
    st.binary(max_size=20),
)


@bombarded(certificates)
def test_any_certificate_is_a_certificate_or_refused_in_one_line(file: Path, content: str | bytes) -> None:
    certificate = None

    def read() -> None:
        nonlocal certificate
        certificate = parse_certificate(read_certificate(written(file, content)), str(file))

    if not refusal(read, CertificateError, str(file)):
        assert certificate is not None
        assert 0 < certificate.wavelengths[0] < math.inf
        assert (certificate.wavelengths[1:] > certificate.wavelengths[:-1]).all()
        if isinstance(certificate, Certificate):
            assert ((certificate.reflectance_8h > 0) & (certificate.reflectance_8h <= 1.05)).all()
            assert ((certificate.u_reflectance >= 0) & (certificate.u_reflectance < 1)).all()
        else:
            assert ((certificate.values > 0) & (certificate.values < math.inf)).all()
            assert ((certificate.u_values >= 0) & (certificate.u_values < certificate.values)).all()
        assert (certificate.calibrated is None) == (certificate.valid_until is None)
        text = certificate_csv(certificate)
        assert certificate_csv(parse_certificate(text, str(file))) == text
