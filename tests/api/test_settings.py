"""The instrument file: what it may say, and that a wrong one is explained in one line."""

import asyncio
import re
import sys
from dataclasses import fields
from pathlib import Path

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from api.settings import FAMILIES, InstrumentSettings, load_instrument
from api.stages import make_stage, not_plugged_in
from drivers.clock import WallClock
from drivers.errors import DeviceNotFound
from drivers.stage import Mounting
from goniometer.constants import BenchData
from goniometer.errors import ConfigurationError
from simulators.devices.clock import SimulatedClock
from simulators.devices.motion import Axis
from simulators.devices.smc100 import SimulatedSMC100

SHOWN = Path(__file__).parents[2] / "docs" / "instrument.toml"

BENCH = """
[stages.sample]
driver = "smc100"
url = "/dev/ttyUSB0"
[stages.detector]
driver = "oriental-az"
url = "tcp://192.168.0.20:502"
"""

TWO = """
[stages.sample]
{0}
url = "/dev/ttyUSB0"
[stages.detector]
{0}
url = "/dev/ttyUSB0"
"""


def loaded(folder: Path, text: str) -> InstrumentSettings:
    file = folder / "i.toml"
    file.write_text(text)
    return load_instrument(file)


def test_the_instrument_in_the_documents_is_accepted_with_all_that_it_hints_at(tmp_path: Path) -> None:
    text = SHOWN.read_text()
    assert load_instrument(SHOWN).forbidden == ()
    hinted = text.replace("# [[forbidden]]", "[[forbidden]]").replace("# sample =", "sample =")
    (region,) = loaded(tmp_path, hinted.replace("# detector =", "detector =")).forbidden
    assert (region.sample, region.detector) == ((60.0, 90.0), (-85.0, -60.0))
    by_number = re.sub(r'^url = "/dev.*\n# serial', "serial", text, flags=re.MULTILINE)
    assert loaded(tmp_path, by_number).stages.sample.serial_number == "A10K3XYZ"


def test_the_instrument_in_the_documents_shows_every_key() -> None:
    text = SHOWN.read_text()
    keys = set(re.findall(r"^#? *(\w+) = ", text, flags=re.MULTILINE))
    models = [field.annotation for field in InstrumentSettings.model_fields.values()]
    known = {key for family in FAMILIES.values() for key in family.model_fields}
    known |= {key for model in models if hasattr(model, "model_fields") for key in model.model_fields} - {"sample"}
    assert known <= keys | {"detector", "sample"}, known - keys


@pytest.mark.parametrize("family", FAMILIES)
def test_a_stage_of_any_family_is_mounted_and_limited_as_the_file_says(tmp_path: Path, family: str) -> None:
    url = "tcp://h:502" if family == "oriental-az" else "socket://h:4001"
    more = "counts_per_degree = 2000\n" if family == "owis" else ""
    text = BENCH.replace('"smc100"', f'"{family}"').replace("/dev/ttyUSB0", url)
    text = text.replace(
        "[stages.detector]", f"zero = 12.5\ndirection = -1\nscale = 2\nlimits = [3, 80]\n{more}[stages.detector]"
    )
    stage = make_stage("sample stage", loaded(tmp_path, text).stages.sample, (0.0, 90.0), WallClock())
    assert stage.limits == (3.0, 80.0)
    assert getattr(stage, "_mounting") == Mounting(12.5, -1, 2.0)  # noqa: B009


WRONG = {
    BENCH.replace(
        "url", "directon = 1\nurl", 1
    ): 'stages.sample.directon: there is no such key; did you mean "direction"?',
    BENCH.replace("url", "xyz = 1\nurl", 1): "stages.sample.xyz: there is no such key; known here: url, ",
    BENCH.replace("url", "counts_per_degree = 1\nurl", 1): "stages.sample.counts_per_degree: there is no such key",
    BENCH.replace("url", "direction = 0\nurl", 1): "stages.sample.direction: 0 is not possible",
    BENCH.replace("url", "scale = 0\nurl", 1): "stages.sample.scale: 0 is not possible",
    BENCH.replace("url", "zero = nan\nurl", 1): "stages.sample.zero: nan is not possible",
    BENCH.replace("url", "limits = [10, -10]\nurl", 1): "stages.sample.limits: [10, -10] is no range",
    BENCH.replace("url", "limits = [10]\nurl", 1): "stages.sample.limits",
    BENCH.replace("url", 'serial_number = "A"\nurl', 1): "stages.sample: give either url or serial_number",
    BENCH.replace('url = "/dev/ttyUSB0"', ""): "stages.sample: give either url or serial_number",
    BENCH.replace('url = "/dev/ttyUSB0"', 'serial_number = "A&n=2"'): "stages.sample.serial_number: 'A&n=2'",
    BENCH.replace(
        '"smc100"', '"smc1000"'
    ): "stages.sample.driver: there is no driver 'smc1000'; did you mean \"smc100\"?",
    BENCH.replace('"smc100"', "3"): "stages.sample.driver",
    BENCH.replace('driver = "smc100"', ""): "stages.sample.driver: this key is missing; give one of smc100, ",
    BENCH.replace('"smc100"', '"owis"'): "stages.sample.counts_per_degree: this key is missing; give the steps",
    BENCH.replace("/dev/ttyUSB0", "sockets://h:1"): "stages.sample: url = 'sockets://h:1' is no address",
    BENCH.replace("/dev/ttyUSB0", "socket://h"): "stages.sample: url = 'socket://h' is no address",
    BENCH.replace(
        "tcp://192.168.0.20:502", "COM3"
    ): "stages.detector: url = 'COM3' is no address of this driver; write \"tcp:",
    BENCH.replace(
        "[stages.detector]", "[stages.detektor]"
    ): 'stages.detektor: there is no such key; did you mean "detector"?',
    BENCH.split("[stages.detector]", maxsplit=1)[0]: "stages.detector: this key is missing",
    TWO.format('driver = "smc100"'): "stages: both stages answer at '/dev/ttyUSB0' with the address 1; they are two",
    TWO.format('driver = "owis"\ncounts_per_degree = 9'): "with the axis 1; they are two, so give each its own axis",
    TWO.format('driver = "k10cr1"'): "stages: both stages answer at '/dev/ttyUSB0'; only two of smc100, of owis or ",
    TWO.replace("/dev", "rtu:///dev").format('driver = "oriental-az"'): "ttyUSB0'; only two of smc100, of owis or ",
    TWO.format('driver = "smc100"').replace(
        "smc100", "k10cr1", 1
    ): "only two of smc100, of owis or of oriental-az on tcp",
    BENCH + "[geometry]\napperture = 1\n": 'geometry.apperture: there is no such key; did you mean "aperture"?',
    BENCH + "[[forbidden]]\nsample = [1, 2]\n": "forbidden[0].detector: this key is missing",
    BENCH + "[[forbidden]]\nsample = [1, 2]\ndetector = [2, 1]\n": "forbidden[0].detector: [2, 1] is no range",
    BENCH + "[spectrometer]\ngain = 0\n": "spectrometer.gain: 0 is not possible",
    BENCH + "[spectrometer]\ngian = 1\n": 'spectrometer.gian: there is no such key; did you mean "gain"?',
    BENCH + "[light]\nu_lamp = -1\n": "light.u_lamp: -1 is not possible",
    BENCH + "[light]\nu_lamb = 1\n": 'light.u_lamb: there is no such key; did you mean "u_lamp"?',
    "": "stages: this key is missing",
    "stages = 3": "stages: 3 is not possible",
    "[stages]\nsample = 3\ndetector = 3": "stages.sample",
    BENCH + "forbidden = 3": "stages.detector.forbidden: there is no such key",
    "forbidden = [3]\n" + BENCH: "forbidden[0]: 3 is not possible",
}


@pytest.mark.parametrize("text", WRONG, ids=range(len(WRONG)))
def test_a_wrong_key_is_explained_in_one_line(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        loaded(tmp_path, text)
    message = str(refused.value)
    assert WRONG[text] in message
    assert "\n" not in message


def test_two_stages_may_share_a_line_when_something_tells_them_apart(tmp_path: Path) -> None:
    for family, key in (("smc100", "address"), ("owis", "counts_per_degree = 9\naxis"), ("oriental-az", "unit")):
        text = TWO.replace("{0}", f'driver = "{family}"\n{key} = 1', 1).format(f'driver = "{family}"\n{key} = 2')
        if family == "oriental-az":
            text = text.replace("/dev/ttyUSB0", "tcp://192.168.0.20:502")
        stages = loaded(tmp_path, text).stages
        assert (stages.sample.own_number, stages.detector.own_number) == (1, 2)


def port(path: str, serial_number: str) -> ListPortInfo:
    """A USB serial adapter as pyserial lists it."""
    info = ListPortInfo(path)
    info.vid, info.pid, info.serial_number, info.location = 0x0403, 0x6001, serial_number, "1-1"
    info.hwid = info.usb_info()
    return info


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals")
def test_a_stage_is_found_by_its_serial_number_wherever_the_hub_puts_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = BENCH.replace('url = "/dev/ttyUSB0"', 'serial_number = "A10K"')
    settings = loaded(tmp_path, text).stages.sample
    clock = SimulatedClock()
    simulators = [
        SimulatedSMC100(Axis(clock, start=start, velocity=20, acceleration=80, limits=(-5, 95))) for start in (1, 2)
    ]
    plugged: list[ListPortInfo] = []
    monkeypatch.setattr(list_ports, "comports", lambda include_links=False: plugged)

    async def scenario() -> None:
        stage = make_stage("sample stage", settings, (0.0, 90.0), clock)
        for simulator in simulators:
            # another adapter whose number begins alike comes first
            plugged[:] = [port("/dev/null", "A10K2"), port(simulator.start_pty(), "A10K")]
            assert not_plugged_in({"sample stage": settings}) == {}
            await stage.open()
            assert "SMC100" in await stage.identity()
            await stage.close()
        plugged[:] = plugged[:1]
        with pytest.raises(DeviceNotFound):
            await stage.open()
        await stage.close()

    try:
        asyncio.run(scenario())
    finally:
        for simulator in simulators:
            simulator.close()


def test_a_serial_number_that_is_not_plugged_in_is_answered_with_those_that_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = BENCH.replace('url = "/dev/ttyUSB0"', 'serial_number = "A10K"')
    stages = loaded(tmp_path, text).stages
    monkeypatch.setattr(list_ports, "comports", lambda include_links=False: [port("/dev/ttyUSB7", "B22")])
    errors = not_plugged_in({"sample stage": stages.sample, "detector stage": stages.detector})
    assert list(errors) == ["sample stage"]
    for word in ("sample stage: ", "A10K", "B22 at /dev/ttyUSB7"):
        assert word in str(errors["sample stage"])


def test_every_figure_of_the_bench_in_the_file_reaches_calibration_and_is_left_at_its_default_without(
    tmp_path: Path,
) -> None:
    assert loaded(tmp_path, BENCH).bench_data == BenchData() == load_instrument(SHOWN).bench_data
    values = {each.name: round(0.01 * (number + 1), 2) for number, each in enumerate(fields(BenchData))}
    tables = {
        "geometry": ("aperture", "u_aperture", "field_of_view", "u_field_of_view", "u_angle", "u_zero"),
        "spectrometer": ("gain", "u_nonlinearity", "wavelength_offset", "u_wavelength"),
        "light": ("u_lamp", "u_stray_light"),
    }
    text = BENCH
    for table, names in tables.items():
        text += f"[{table}]\n" + "".join(f"{name} = {values[name]}\n" for name in names)
    assert loaded(tmp_path, text).bench_data == BenchData(**values)


def test_backlash_and_settling_reach_the_plan_and_leave_room_below_what_is_measured(tmp_path: Path) -> None:
    text = BENCH.replace("[stages.detector]", "backlash = 0.5\nsettling = 0.25\n[stages.detector]\nbacklash = 2.0")
    settings = loaded(tmp_path, text + "[spectrometer]\ndead_time = 1.5\n")
    motion = settings.motion
    assert (motion.sample.backlash, motion.sample.settling) == (0.5, 0.25)
    assert (motion.detector.backlash, motion.detector.velocity) == (2.0, 30.0)
    assert settings.spectrometer.dead_time == 1.5
    assert make_stage("detector", settings.stages.detector, (-85.0, 170.0), WallClock()).limits == (-87.0, 170.0)
    limited = loaded(tmp_path, text + "limits = [-85.0, 170.0]\n")
    assert make_stage("detector", limited.stages.detector, (-85.0, 170.0), WallClock()).limits == (-85.0, 170.0)
    with pytest.raises(ConfigurationError, match="backlash"):
        loaded(tmp_path, text.replace("2.0", "-2.0"))
