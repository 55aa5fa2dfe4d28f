"""The camera driver: against libgphoto2 without a camera, and with its directory driver behind a camera's settings."""

import asyncio
from pathlib import Path
from typing import Any

import gphoto2
import pytest

from drivers.errors import DeviceDisconnected, DeviceFault, DeviceNotFound, DeviceRefused, DeviceTimeout
from drivers.gphoto2_camera import GPhoto2Camera, nearest_shutter, nikon_settings
from drivers.interfaces import Camera

CHOICES = {
    "capturetarget": ["Internal RAM", "Memory card"],
    "expprogram": ["M", "P", "A", "S"],
    "autoiso": ["On", "Off"],
    "iso": ["64", "100", "200"],
    "f-number": ["f/5.6", "f/8", "f/11", "f/16"],
    "imagequality": ["JPEG Fine", "NEF (Raw)"],
    "shutterspeed2": ["1/8000", "1/60", "1/50", "1", "30", "Bulb"],
}
"""Settings of a Nikon, as libgphoto2 names them, and some of their values."""
IDENTITY = {"manufacturer": "Nikon Corporation", "cameramodel": "D810", "serialnumber": "0000000003012345"}


class Setting:
    def __init__(self, value: str, choices: list[str]) -> None:
        self.value, self.choices = value, choices

    def get_value(self) -> str:
        return self.value

    def set_value(self, value: str) -> None:
        self.value = value

    def get_choices(self) -> list[str]:
        return list(self.choices)


class Nikon:
    """A camera whose files come through libgphoto2's directory driver from a real folder; only settings are played."""

    def __init__(self, card: Path) -> None:
        ports, models = gphoto2.PortInfoList(), gphoto2.CameraAbilitiesList()
        ports.load()
        models.load()
        self.directory = _CAMERA()
        self.directory.set_abilities(models.get_abilities(models.lookup_model("Directory Browse")))
        self.directory.set_port_info(ports.get_info(ports.lookup_path(f"disk:{card}")))
        self.card = card
        self.values = {name: choices[-1] for name, choices in CHOICES.items()} | IDENTITY
        self.stuck: str | None = None
        self.fails: int | None = None
        self.taken = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.directory, name)

    def get_single_config(self, name: str) -> Setting:
        if name not in self.values:
            raise gphoto2.GPhoto2Error(gphoto2.GP_ERROR_BAD_PARAMETERS)
        return Setting(self.values[name], CHOICES.get(name, []))

    def set_single_config(self, name: str, setting: Setting) -> None:
        if name != self.stuck:
            self.values[name] = setting.value

    def capture(self, kind: int) -> Any:
        if self.fails is not None:
            raise gphoto2.GPhoto2Error(self.fails)
        assert kind == gphoto2.GP_CAPTURE_IMAGE
        self.taken += 1
        file = self.card / f"capt{self.taken:04}.NEF"
        file.write_bytes(b"raw " + self.values["shutterspeed2"].encode())
        place = type("CameraFilePath", (), {})()
        place.folder, place.name = "/", file.name
        return place


_CAMERA = gphoto2.Camera


@pytest.fixture
def nikon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Nikon:
    card = tmp_path / "card"
    card.mkdir()
    camera = Nikon(card)
    monkeypatch.setattr(gphoto2, "Camera", lambda: camera)
    return camera


def driver(**options: Any) -> GPhoto2Camera:
    return GPhoto2Camera("macro camera", nikon_settings(iso=64, f_number=11), **options)


def test_without_a_camera_the_operator_is_told_to_look_for_it() -> None:
    camera: Camera = driver()
    with pytest.raises(DeviceNotFound, match=r"macro camera: cannot connect: .*check its cable and power"):
        asyncio.run(camera.open())
    with pytest.raises(DeviceDisconnected, match="open it first"):
        asyncio.run(camera.identity())
    asyncio.run(camera.close())


def test_a_port_that_is_none_is_refused_by_its_name() -> None:
    with pytest.raises(DeviceNotFound, match="look for nowhere:7"):
        asyncio.run(driver(port="nowhere:7").open())


def test_a_device_that_libgphoto2_cannot_set_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bare = Nikon(tmp_path).directory
    monkeypatch.setattr(gphoto2, "Camera", lambda: bare)
    with pytest.raises(DeviceRefused, match="cannot tell capturetarget"):
        asyncio.run(driver().open())


def test_a_raw_file_comes_with_all_settings_made_and_the_camera_keeps_no_copy(nikon: Nikon, tmp_path: Path) -> None:
    async def session() -> tuple[str, Any]:
        camera = driver(serial_number="3012345")
        await camera.open()
        told = await camera.identity()
        taken = await camera.capture(tmp_path / "plus-20", 1 / 60)
        await camera.close()
        return told, taken

    told, taken = asyncio.run(session())
    assert told == "Nikon Corporation D810, serial number 0000000003012345"
    assert taken.path == tmp_path / "plus-20.nef"
    assert taken.path.read_bytes() == b"raw 1/60"
    assert taken.exposure == pytest.approx(1 / 60)
    assert {name: nikon.values[name] for name in nikon_settings(64, 11)} == nikon_settings(64, 11)
    assert list(nikon.card.iterdir()) == []


@pytest.mark.usefixtures("nikon")
def test_no_picture_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "plus-20.nef").write_bytes(b"yesterday")

    async def session() -> None:
        camera = driver()
        await camera.open()
        await camera.capture(tmp_path / "plus-20", 1 / 60)

    with pytest.raises(FileExistsError, match="another name"):
        asyncio.run(session())
    assert (tmp_path / "plus-20.nef").read_bytes() == b"yesterday"


def test_what_the_camera_does_not_have_or_does_not_do_is_said(nikon: Nikon, tmp_path: Path) -> None:
    with pytest.raises(DeviceNotFound, match="serial number 0000000003012345, not 999"):
        asyncio.run(driver(serial_number="999").open())
    with pytest.raises(DeviceRefused, match=r"has no f-number f/9; it has f/5\.6"):
        asyncio.run(GPhoto2Camera("macro camera", nikon_settings(64, 9)).open())
    nikon.stuck, nikon.values["expprogram"] = "expprogram", "S"
    with pytest.raises(DeviceFault, match="was told expprogram M but has S"):
        asyncio.run(driver().open())
    nikon.stuck = None

    async def expose(seconds: float) -> None:
        camera = driver()
        await camera.open()
        await camera.capture(tmp_path / "x", seconds)

    with pytest.raises(DeviceRefused, match=r"has no shutterspeed2 0\.019 s"):
        asyncio.run(expose(0.019))
    for code, kind in (
        (gphoto2.GP_ERROR_TIMEOUT, DeviceTimeout),
        (gphoto2.GP_ERROR_IO, DeviceDisconnected),
        (gphoto2.GP_ERROR_CAMERA_ERROR, DeviceFault),
    ):
        nikon.fails = code
        with pytest.raises(kind, match="cannot take a picture"):
            asyncio.run(expose(1.0))
    assert not (tmp_path / "x.nef").exists()


def test_bulb_is_no_exposure_time() -> None:
    found = nearest_shutter(["Bulb", "Time", "1/60", "0.0125s"], 1 / 60)
    assert found is not None
    choice, seconds = found
    assert choice == "1/60"
    assert seconds == pytest.approx(1 / 60)
    assert nearest_shutter(["Bulb"], 1.0) is None
