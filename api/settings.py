"""The instrument file: which devices stand on the bench, where they answer, and how they are mounted.

A TOML file such as docs/instrument.toml, which shows every key. Without a file the simulated bench is used, which
fills in the same settings with the addresses at which its simulators answer.
"""

import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, get_args
from urllib.parse import urlsplit

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails

from drivers.stage import Mounting
from goniometer.bench.route import Motion, StageMotion
from goniometer.bench.safety import Forbidden
from goniometer.constants import BenchData
from goniometer.errors import ConfigurationError
from goniometer.scans.duration import DEAD_TIME
from goniometer.storage.tables import BENCH
from goniometer.wording import key_path, nearest


def _ascends(ends: tuple[float, float]) -> tuple[float, float]:
    if not ends[0] < ends[1]:
        raise ValueError(f"[{ends[0]:g}, {ends[1]:g}] is no range; give the lower angle first")
    return ends


Range = Annotated[tuple[float, float], AfterValidator(_ascends)]
"""Lowest and highest angle, degrees."""
SerialNumber = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")]
BenchName = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9-]{0,31}$")]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Uncertainty = NotNegative


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _Stage(_Strict):
    """What the settings of all stages have in common."""

    forms: ClassVar[str] = 'a port such as "/dev/ttyUSB0" or "COM3", or "socket://host:port"'
    schemes: ClassVar[tuple[str, ...]] = ("", "socket", "rfc2217", "spy")

    url: str | None = Field(default=None, min_length=1, description="where the device answers")
    serial_number: SerialNumber | None = Field(
        default=None, description="of the USB serial adapter or the stage; it is looked up each time the port is opened"
    )
    limits: Range | None = Field(default=None, description="degrees on the bench; None is all that geometry asks for")
    zero: float = Field(default=0.0, description="reading of the stage where the bench calls the angle 0, degrees")
    direction: Literal[1, -1] = Field(default=1, description="-1 where reading and angle grow in opposite directions")
    scale: Positive = Field(default=1.0, description="degrees that the stage reads per degree that it turns")
    backlash: NotNegative = Field(
        default=0.0, description="degrees by which a target is passed on the way down, to be approached upwards"
    )
    settling: NotNegative = Field(default=0.0, description="for which the arm swings after a move, seconds")
    timeout: Positive = Field(default=1.0, description="longest wait for a reply, seconds")

    @model_validator(mode="after")
    def _is_somewhere(self) -> Self:
        if (self.url is None) == (self.serial_number is None):
            raise ValueError("give either url or serial_number")
        if self.url is not None and not _has_form(self.url, self.schemes):
            raise ValueError(f"url = {self.url!r} is no address of this driver; write {self.forms}")
        return self

    @property
    def mounting(self) -> Mounting:
        """How the stage sits on the bench."""
        return Mounting(self.zero, self.direction, self.scale)

    def standing(self, needed: tuple[float, float]) -> tuple[float, float]:
        """Where the stage may stand if it must go to all of `needed`: its limits, or just so far; degrees."""
        return self.limits or (needed[0] - self.backlash, needed[1])

    @property
    def own_number(self) -> int | None:
        """What tells the stage from others on the same line; None where there can be no others."""
        return None


class SMC100Settings(_Stage):
    """A stage on a Newport SMC100. It moves as fast as its controller is configured."""

    driver: Literal["smc100"]
    address: int = Field(default=1, ge=1, le=31, description="of the controller on its chain")

    @property
    def own_number(self) -> int | None:
        """The address on the chain."""
        return self.address


class OrientalAZSettings(_Stage):
    """A stage on an Oriental Motor AZ."""

    forms: ClassVar[str] = '"tcp://host:port" or "rtu:///dev/ttyUSB0"'
    schemes: ClassVar[tuple[str, ...]] = ("tcp", "rtu", "rtu+socket", "rtu+rfc2217", "rtu+spy")

    driver: Literal["oriental-az"]
    unit: int = Field(default=1, ge=1, le=247, description="Modbus unit")
    baudrate: int = Field(default=115200, gt=0, description="of a serial line")
    parity: Literal["E", "O", "N"] = Field(default="E", description="of a serial line: even, odd or none")
    degrees_per_step: Positive = Field(default=0.01, description="of the table, as the driver is configured")
    velocity: Positive = Field(default=30.0, description="degrees/s")
    acceleration: Positive = Field(default=60.0, description="degrees/s^2")

    @property
    def own_number(self) -> int | None:
        """The unit behind a gateway; two drivers cannot open one serial line."""
        return self.unit if self.url is not None and self.url.startswith("tcp://") else None


class OwisSettings(_Stage):
    """A stage on an OWIS PS 10 or PS 90."""

    driver: Literal["owis"]
    axis: int = Field(default=1, ge=1, le=9, description="of the controller")
    counts_per_degree: Positive = Field(description="steps or encoder counts per degree that the stage turns")
    velocity: Positive = Field(default=10.0, description="degrees/s")
    acceleration: Positive = Field(default=20.0, description="degrees/s^2")
    velocity_unit: Positive = Field(default=1.0, description="counts/s of one unit in which the controller counts")
    acceleration_unit: Positive = Field(default=1.0, description="counts/s^2 of one unit in which it counts")
    reference_mode: int = Field(default=4, ge=3, le=7, description="how it searches its reference, the number of REF")
    baudrate: int = Field(default=9600, gt=0, description="of the serial line")

    @property
    def own_number(self) -> int | None:
        """The axis of the controller."""
        return self.axis


class K10CR1Settings(_Stage):
    """A Thorlabs K10CR1."""

    driver: Literal["k10cr1"]
    velocity: Positive = Field(default=10.0, le=10, description="degrees/s")
    acceleration: Positive = Field(default=10.0, le=20, description="degrees/s^2")


Family = SMC100Settings | OrientalAZSettings | OwisSettings | K10CR1Settings
StageSettings = Annotated[Family, Field(discriminator="driver")]
FAMILIES: dict[str, type[_Stage]] = {
    get_args(family.model_fields["driver"].annotation)[0]: family for family in get_args(Family)
}
"""Settings of each driver, by its name in the file."""


class StagesSettings(_Strict):
    """Both stages."""

    sample: StageSettings
    detector: StageSettings

    @model_validator(mode="after")
    def _are_two(self) -> Self:
        sample, detector = self.sample, self.detector
        if (sample.url, sample.serial_number) != (detector.url, detector.serial_number):
            return self
        where = f"both stages answer at {sample.url or sample.serial_number!r}"
        if sample.driver != detector.driver or sample.own_number is None:
            raise ValueError(f"{where}; only two of smc100, of owis or of oriental-az on tcp:// can share a line")
        if sample.own_number == detector.own_number:
            key = {"smc100": "address", "owis": "axis"}.get(sample.driver, "unit")
            raise ValueError(f"{where} with the {key} {sample.own_number}; they are two, so give each its own {key}")
        return self


class GeometrySettings(_Strict):
    """What is known of the bench's geometry; every u_ is a standard uncertainty."""

    aperture: float = Field(
        default=BenchData.aperture, gt=0, lt=10, description="full angle of the detector aperture, degrees"
    )
    u_aperture: Uncertainty = Field(default=BenchData.u_aperture, description="of aperture, degrees")
    field_of_view: Positive = Field(
        default=BenchData.field_of_view, description="diameter of what the detector sees of the sample, mm"
    )
    u_field_of_view: Uncertainty = Field(default=BenchData.u_field_of_view, description="of field_of_view, mm")
    u_angle: Uncertainty = Field(default=BenchData.u_angle, description="how well one stage position repeats, degrees")
    u_zero: Uncertainty = Field(default=BenchData.u_zero, description="of the zero of each stage, degrees")


class ForbiddenSettings(_Strict):
    """A rectangle of stage angles in which the arm would hit something."""

    sample: Range
    detector: Range

    @property
    def region(self) -> Forbidden:
        """The region that is checked before every motion."""
        return Forbidden(sample=self.sample, detector=self.detector)


class SpectrometerSettings(_Strict):
    """The QE Pro."""

    serial_number: SerialNumber | None = Field(default=None, description="None takes the only QE Pro plugged in")
    gain: Positive = Field(default=BenchData.gain, description="electrons per count, for the shot noise")
    u_nonlinearity: Uncertainty = Field(
        default=BenchData.u_nonlinearity, description="relative, at full scale: what the device's polynomial leaves"
    )
    wavelength_offset: float = Field(
        default=BenchData.wavelength_offset, description="added to the wavelengths that the device tells, nm"
    )
    u_wavelength: Uncertainty = Field(default=BenchData.u_wavelength, description="of the wavelength scale, nm")
    cooler_set_point: float = Field(default=-10.0, ge=-40, le=30, description="degrees Celsius")
    temperature_tolerance: Positive = Field(
        default=0.5, description="by which the detector may be off, degrees Celsius"
    )
    dead_time: NotNegative = Field(
        default=DEAD_TIME, description="at each point for commands, shutter and read-out, seconds; for the preview only"
    )
    timeout: Positive = Field(default=2.0, description="longest wait for a reply beyond the integration time, seconds")


class LightSettings(_Strict):
    """What is known of lamp and stray light; every u_ is a standard uncertainty."""

    u_lamp: Uncertainty = Field(
        default=BenchData.u_lamp, description="relative drift over a scan, where no monitor exposures tell"
    )
    u_stray_light: Uncertainty = Field(
        default=BenchData.u_stray_light, description="BRDF times cos(theta_in), where none was measured, 1/sr"
    )


_TABLES: dict[str, type[_Strict]] = {
    "spectrometer": SpectrometerSettings,
    "geometry": GeometrySettings,
    "light": LightSettings,
}


ORDINARY = StageMotion()
"""A stage of ordinary speed."""


class InstrumentSettings(_Strict):
    """The whole bench."""

    bench: BenchName = Field(default=BENCH, description="its name, which tells it from others on the same database")
    stages: StagesSettings
    spectrometer: SpectrometerSettings = SpectrometerSettings()
    geometry: GeometrySettings = GeometrySettings()
    light: LightSettings = LightSettings()
    forbidden: tuple[ForbiddenSettings, ...] = ()

    @property
    def motion(self) -> Motion:
        """How the stages move where the file says it; one that moves as its controller is configured is ordinary."""
        sample, detector = (
            StageMotion(
                getattr(stage, "velocity", ORDINARY.velocity),
                getattr(stage, "acceleration", ORDINARY.acceleration),
                stage.backlash,
                stage.settling,
            )
            for stage in (self.stages.sample, self.stages.detector)
        )
        return Motion(sample, detector)

    @property
    def backlash(self) -> tuple[float, float]:
        """Of the sample and of the detector stage, degrees."""
        return self.stages.sample.backlash, self.stages.detector.backlash

    @property
    def settling(self) -> tuple[float, float]:
        """Seconds for which the arm swings after a move of the sample and of the detector stage."""
        return self.stages.sample.settling, self.stages.detector.settling

    @property
    def bench_data(self) -> BenchData:
        """What calibration needs to know of the bench beyond what the devices say."""
        known = self.geometry.model_dump() | self.spectrometer.model_dump() | self.light.model_dump()
        return BenchData(**{each.name: known[each.name] for each in fields(BenchData)})


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
    except RecursionError as error:
        raise ConfigurationError(f"{path}: is nested too deeply; an instrument file needs three levels.") from error
    except ValidationError as error:
        # a misspelt key explains the missing one
        first = min(error.errors(), key=lambda fault: fault["type"] != "extra_forbidden")
        raise ConfigurationError(f"{path}: {_sentence(first)}") from error
    except ValueError as error:  # a number of thousands of digits
        raise ConfigurationError(f"{path}: holds a value that is not possible ({error}).") from error


def _has_form(url: str, schemes: tuple[str, ...]) -> bool:
    """Whether `url` has one of `schemes` ("" for a plain port), and a host and port number where it must."""
    try:
        parts = urlsplit(url)
        scheme = parts.scheme if "://" in url else ""
        is_network = scheme.removeprefix("rtu+") in {"socket", "tcp", "rfc2217"}
        return scheme in schemes and (not is_network or (parts.hostname is not None and parts.port is not None))
    except ValueError:  # a port that is no number, or too large
        return False


def _sentence(fault: ErrorDetails) -> str:
    """One pydantic error: where, what is wrong, what would be right."""
    parts = list(fault["loc"])
    model = _model_at(parts)
    # behind the name of a stage stands the driver that it was read for, which is no key of the file
    shown = [part for index, part in enumerate(parts) if not (index == 2 and parts[0] == "stages" and part in FAMILIES)]
    where = key_path(shown) or "top level"
    given = fault["input"]
    match fault["type"]:
        case "extra_forbidden":
            text = "there is no such key; " + nearest(str(parts[-1]), model.model_fields)
        case "missing" if isinstance(parts[-1], int):  # an end of a range
            text = "is missing; give two angles, [lowest, highest]"
        case "missing":
            what = model.model_fields[str(parts[-1])].description
            text = "this key is missing" + (f"; give the {what}" if what else "")
        case "union_tag_not_found":
            where += ".driver"
            text = f"this key is missing; give one of {', '.join(FAMILIES)}"
        case "union_tag_invalid":
            where += ".driver"
            text = f"there is no driver {given['driver']!r}; {nearest(str(given['driver']), FAMILIES)}"
        case "value_error":
            text = str(fault["ctx"]["error"])
        case "model_type" | "model_attributes_type":
            text = f"{given!r} is not possible: it must be a table of keys"
        case _:
            told = fault["msg"].replace("String should match pattern", "it must match")
            text = f"{given!r} is not possible: {told}".replace("Input should", "it must").replace("Tuple", "it")
    return f"{where}: {text}"


def _model_at(parts: list[Any]) -> type[BaseModel]:
    """The settings that hold the key to which the path of an error leads."""
    match parts:
        case ["stages", _, family, _, *_]:
            return FAMILIES[family]
        case ["stages", _, *_]:
            return StagesSettings
        case [("spectrometer" | "geometry" | "light") as table, _, *_]:
            return _TABLES[table]
        case ["forbidden", _, _, *_]:
            return ForbiddenSettings
        case _:
            return InstrumentSettings
