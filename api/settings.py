"""The instrument file: which devices stand on the bench and where they answer.

A TOML file such as

    [sample_stage]
    driver = "smc100"
    url = "/dev/ttyUSB0"          # or "COM3", or "socket://host:port"

    [detector_stage]
    driver = "oriental-az"
    url = "tcp://192.168.0.20:502"

    [spectrometer]
    serial_number = "QEP01234"    # leave out to take the only QE Pro that is plugged in

Without a file the simulated bench is used, which fills in the same settings with the addresses at which its
simulators answer.
"""

import tomllib
from pathlib import Path
from typing import Literal
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.clock import Clock
from drivers.interfaces import RotationStage
from drivers.oriental_az import OrientalAZ
from drivers.smc100 import SMC100
from goniometer.errors import ConfigurationError


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class StageSettings(_Strict):
    """One rotation stage."""

    driver: Literal["smc100", "oriental-az"]
    url: str = Field(description="serial port or socket://host:port for the SMC100, tcp://host:port for the AZ")
    address: int = Field(default=1, ge=1, le=247, description="controller address on its bus")


class SpectrometerSettings(_Strict):
    """The QE Pro."""

    serial_number: str | None = Field(default=None, description="None takes the only QE Pro that is plugged in")
    gain: float = Field(default=5.0, gt=0, description="electrons per count, for the shot noise")


class InstrumentSettings(_Strict):
    """The whole bench."""

    sample_stage: StageSettings
    detector_stage: StageSettings
    spectrometer: SpectrometerSettings = SpectrometerSettings()
    u_angle: float = Field(default=0.005, ge=0, description="standard uncertainty of one stage position, degrees")
    aperture: float = Field(default=1.0, gt=0, lt=10, description="full angle of the detector aperture, degrees")


def load_instrument(path: Path) -> InstrumentSettings:
    """Read an instrument file; raises `ConfigurationError` with one line that says what to mend."""
    try:
        with path.open("rb") as file:
            return InstrumentSettings.model_validate(tomllib.load(file))
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read ({error.strerror}); name an existing file.") from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{path}: is not UTF-8 text; save it as such.") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"{path}: is not valid TOML: {error}.") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "top level"
        raise ConfigurationError(f"{path}: {where}: {first['msg'].lower()} (got {first['input']!r}).") from error


def make_stage(name: str, settings: StageSettings, limits: tuple[float, float], clock: Clock) -> RotationStage:
    """The driver that `settings` asks for; nothing is opened yet.

    Raises `ConfigurationError` where the address cannot be one of that driver's.
    """
    if settings.driver == "smc100":
        return SMC100(name, settings.url, clock, address=settings.address, limits=limits)
    try:
        address = urlsplit(settings.url)
        host, port = address.hostname, address.port
    except ValueError:
        host = port = None
    if host is None or port is None or address.scheme != "tcp":
        raise ConfigurationError(
            f"{name}: {settings.url!r} is no address of an Oriental AZ; write it as tcp://host:port."
        )
    return OrientalAZ(name, host, port, clock, unit=settings.address, limits=limits)
