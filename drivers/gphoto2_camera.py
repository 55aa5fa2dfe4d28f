"""Cameras on a USB cable, through libgphoto2 (extra `photo`).

The names and values of settings are libgphoto2's for the maker; `nikon_settings` gives those of a Nikon, from memory:
what libgphoto2 publishes of a D810 and a D850 lists numbers of properties and not these names. The way that a file
takes was tried with its directory driver. No camera was ever connected: unchecked are those names, whether a D810 takes
each of the settings in this order, whether it names its files so, how long it needs, and which errors it gives when it
is switched off. A lens without contacts has no aperture to be set.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from drivers.device_thread import DeviceThread
from drivers.errors import (
    DeviceDisconnected,
    DeviceFault,
    DeviceNotFound,
    DeviceRefused,
    DeviceTimeout,
    DriverError,
    ProtocolError,
)
from drivers.interfaces import Photograph

Result = TypeVar("Result")

SAME_EXPOSURE = 0.03
"""Relative difference between the exposure time asked for and the camera's, which are a third of a stop apart."""

_SHUTTER = re.compile(r"(\d+(?:\.\d+)?)(?:/(\d+(?:\.\d+)?))?\s*s?")

_KINDS: dict[str, type[DriverError]] = {
    "GP_ERROR_TIMEOUT": DeviceTimeout,
    "GP_ERROR_MODEL_NOT_FOUND": DeviceNotFound,
    "GP_ERROR_UNKNOWN_PORT": DeviceNotFound,
    "GP_ERROR_IO_INIT": DeviceNotFound,
    "GP_ERROR_IO_USB_FIND": DeviceNotFound,
    "GP_ERROR_IO_USB_CLAIM": DeviceNotFound,
    "GP_ERROR_IO_LOCK": DeviceNotFound,
    "GP_ERROR_IO": DeviceDisconnected,
    "GP_ERROR_IO_READ": DeviceDisconnected,
    "GP_ERROR_IO_WRITE": DeviceDisconnected,
    "GP_ERROR_CORRUPTED_DATA": ProtocolError,
    "GP_ERROR_CAMERA_BUSY": DeviceRefused,
    "GP_ERROR_NOT_SUPPORTED": DeviceRefused,
    "GP_ERROR_BAD_PARAMETERS": DeviceRefused,
}
"""What libgphoto2's errors are here; all others are faults of the camera."""


def nikon_settings(iso: int, f_number: float) -> dict[str, str]:
    """Settings of a Nikon for pictures that can be compared: manual exposure, raw files, nothing left on the card."""
    return {
        "capturetarget": "Internal RAM",
        "expprogram": "M",
        "autoiso": "Off",
        "iso": f"{iso:d}",
        "f-number": f"f/{f_number:g}",
        "imagequality": "NEF (Raw)",
    }


class GPhoto2Camera:
    """A `Camera` that libgphoto2 knows.

    `settings` are made in this order when it is opened, see `nikon_settings`; `shutter` is the setting of the exposure
    time. `port` is libgphoto2's address, e.g. "usb:001,004", without which the first camera is taken; `serial_number`,
    if given, must be the end of the camera's own.
    """

    def __init__(
        self,
        name: str,
        settings: Mapping[str, str],
        *,
        shutter: str = "shutterspeed2",
        port: str | None = None,
        serial_number: str | None = None,
    ) -> None:
        self.name = name
        self._settings = dict(settings)
        self._shutter = shutter
        self._port = port
        self._serial_number = serial_number
        self._thread = DeviceThread(name)
        self._camera: Any = None

    async def open(self) -> None:
        """Connect to the camera, check its serial number and make all settings, each read back.

        Raises `DeviceNotFound` when none answers, another program holds it or libgphoto2 is not installed, and
        `DeviceRefused` for a setting that it does not have.
        """
        try:
            await self._thread.run(self._open)
        except DriverError:
            await self.close()
            raise

    async def close(self) -> None:
        """Disconnect; harmless when not connected."""
        await self._thread.finish(self._close)

    async def identity(self) -> str:
        """Maker, model and serial number."""
        return await self._thread.run(self._identity)

    async def capture(self, path: Path, exposure: float) -> Photograph:
        """Expose once and fetch the file; see `Camera.capture`. The camera keeps no copy."""
        return await self._thread.run(self._capture, path, exposure)

    def _open(self) -> None:
        try:
            import gphoto2  # noqa: PLC0415  (an optional extra)
        except ImportError:
            message = f"{self.name}: needs gphoto2, which is not installed; run: pip install goniometer[photo]"
            raise DeviceNotFound(message) from None
        camera = gphoto2.Camera()
        if self._port is not None:
            ports = gphoto2.PortInfoList()
            ports.load()
            where = self._port
            camera.set_port_info(self._asked(lambda: ports.get_info(ports.lookup_path(where)), f"look for {where}"))
        self._asked(camera.init, "connect")
        self._camera = camera
        if self._serial_number is not None:
            found = self._read("serialnumber")
            if not found.endswith(self._serial_number):
                raise DeviceNotFound(
                    f"{self.name}: the camera that answers has the serial number {found}, not {self._serial_number}; "
                    f"connect the right one or name its port"
                )
        for setting, value in self._settings.items():
            if value not in (choices := self._choices(setting)):
                raise self._refused(setting, value, choices)
            self._set(setting, value)

    def _close(self) -> None:
        camera, self._camera = self._camera, None
        if camera is not None:
            import gphoto2  # noqa: PLC0415

            try:
                camera.exit()
            except gphoto2.GPhoto2Error:
                return  # it is gone already

    def _identity(self) -> str:
        maker, model, serial = (self._read(entry) for entry in ("manufacturer", "cameramodel", "serialnumber"))
        return f"{maker} {model}, serial number {serial}"

    def _capture(self, path: Path, exposure: float) -> Photograph:
        camera, before = self._opened(), sorted(path.parent.glob(f"{path.stem}.*"))
        if before:
            raise FileExistsError(f"{before[0]} exists already; give the photograph another name.")
        choices = self._choices(self._shutter)
        nearest = nearest_shutter(choices, exposure)
        if nearest is None:
            raise self._refused(self._shutter, f"{exposure:g} s", choices)
        choice, seconds = nearest
        self._set(self._shutter, choice)
        import gphoto2  # noqa: PLC0415

        taken = self._asked(lambda: camera.capture(gphoto2.GP_CAPTURE_IMAGE), "take a picture")
        target = path.with_suffix(Path(taken.name).suffix.lower())
        part = target.with_name(target.name + ".part")
        kind = gphoto2.GP_FILE_TYPE_NORMAL
        try:
            self._asked(lambda: camera.file_get(taken.folder, taken.name, kind).save(str(part)), "send the picture")
            part.replace(target)
        finally:
            part.unlink(missing_ok=True)
        self._asked(lambda: camera.file_delete(taken.folder, taken.name), "delete its copy of the picture")
        return Photograph(target, seconds)

    def _opened(self) -> Any:
        if self._camera is None:
            raise DeviceDisconnected(f"{self.name}: is not connected; open it first")
        return self._camera

    def _read(self, entry: str) -> str:
        """Value of a setting, as text."""
        camera = self._opened()
        return str(self._asked(lambda: camera.get_single_config(entry).get_value(), f"tell {entry}"))

    def _choices(self, setting: str) -> list[str]:
        camera = self._opened()
        return [str(c) for c in self._asked(lambda: camera.get_single_config(setting).get_choices(), f"tell {setting}")]

    def _set(self, setting: str, value: str) -> None:
        """Give `setting` one of its choices, and read it back."""
        camera = self._opened()

        def change() -> None:
            widget = camera.get_single_config(setting)
            widget.set_value(value)
            camera.set_single_config(setting, widget)

        self._asked(change, f"set {setting} to {value}")
        now = self._read(setting)
        if now != value:
            raise DeviceFault(f"{self.name}: was told {setting} {value} but has {now}; check its dials and its lens")

    def _refused(self, setting: str, wanted: str, choices: list[str]) -> DeviceRefused:
        shown = ", ".join(choices[:40]) + (", ..." if len(choices) > 40 else "")
        return DeviceRefused(f"{self.name}: has no {setting} {wanted}; it has {shown}")

    def _asked(self, call: Callable[[], Result], what: str) -> Result:
        """What `call` returns; libgphoto2's errors become ours, with `what` the camera was to do."""
        import gphoto2  # noqa: PLC0415

        try:
            return call()
        except gphoto2.GPhoto2Error as error:
            known = {getattr(gphoto2, code): kind for code, kind in _KINDS.items()}
            kind = known.get(error.code, DeviceFault)
            advice = {
                DeviceNotFound: "check its cable and power, and close other programs that use it",
                DeviceDisconnected: "check its cable and power, and open it again",
                DeviceTimeout: "wake it up and check that it can focus",
            }.get(kind, "check what its display says")
            raise kind(f"{self.name}: cannot {what}: {error.string}; {advice}") from error


def shutter_seconds(choice: str) -> float | None:
    """Exposure time of a camera's choice such as "1/60", "0.0166s" or "30"; None of "Bulb" and the like.

    >>> shutter_seconds("1/60"), shutter_seconds("2.5s"), shutter_seconds("Bulb")
    (0.016666666666666666, 2.5, None)
    """
    match = _SHUTTER.fullmatch(choice.strip())
    if match is None or (match[2] and float(match[2]) == 0):
        return None
    return float(match[1]) / float(match[2] or 1)


def nearest_shutter(choices: Iterable[str], exposure: float) -> tuple[str, float] | None:
    """The choice within `SAME_EXPOSURE` of `exposure` seconds, and what it is in seconds; or None."""
    known = {choice: seconds for choice in choices if (seconds := shutter_seconds(choice))}
    nearest = min(known, key=lambda choice: abs(known[choice] - exposure), default=None)
    if nearest is None or abs(known[nearest] / exposure - 1) > SAME_EXPOSURE:
        return None
    return nearest, known[nearest]
