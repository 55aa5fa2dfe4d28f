"""The stages that an instrument file asks for: their drivers, and which of them are not plugged in."""

import re

from serial.tools import list_ports

from api.settings import Family, K10CR1Settings, OrientalAZSettings, OwisSettings, SMC100Settings
from drivers.clock import Clock
from drivers.errors import DeviceNotFound, DriverError
from drivers.interfaces import RotationStage
from drivers.k10cr1 import K10CR1
from drivers.oriental_az import OrientalAZ
from drivers.owis import OwisPS, ReferenceMode
from drivers.smc100 import SMC100


def make_stage(name: str, settings: Family, limits: tuple[float, float], clock: Clock) -> RotationStage:
    """The driver that `settings` asks for, which can go to all of `limits` where they name none; it is not yet open.

    A serial number is looked up by pyserial whenever the driver opens its port, so that a stage is found again when
    the hub has given it another one.
    """
    url = settings.url or rf"hwgrep://SER={re.escape(settings.serial_number or '')}(?!\S)"
    mounting, timeout = settings.mounting, settings.timeout
    limits = settings.standing(limits)
    match settings:
        case SMC100Settings(address=address):
            return SMC100(name, url, clock, address=address, limits=limits, mounting=mounting, timeout=timeout)
        case OrientalAZSettings(velocity=velocity, acceleration=acceleration):
            return OrientalAZ(
                name,
                settings.url or f"rtu+{url}",
                clock,
                unit=settings.unit,
                baudrate=settings.baudrate,
                parity=settings.parity,
                degrees_per_step=settings.degrees_per_step,
                velocity=velocity,
                acceleration=acceleration,
                limits=limits,
                mounting=mounting,
                timeout=timeout,
            )
        case OwisSettings():
            return OwisPS(
                name,
                url,
                clock,
                axis=settings.axis,
                counts_per_degree=settings.counts_per_degree,
                reference_mode=ReferenceMode(settings.reference_mode),
                velocity=settings.velocity,
                acceleration=settings.acceleration,
                velocity_unit=settings.velocity_unit,
                acceleration_unit=settings.acceleration_unit,
                limits=limits,
                mounting=mounting,
                timeout=timeout,
                baudrate=settings.baudrate,
            )
        case K10CR1Settings(velocity=velocity, acceleration=acceleration, serial_number=number):
            return K10CR1(
                name,
                url,
                clock,
                # the mount's own number is that of its USB adapter, and it is asked for it
                serial_number=int(number) if number is not None and number.isdecimal() else None,
                velocity=velocity,
                acceleration=acceleration,
                limits=limits,
                mounting=mounting,
                timeout=timeout,
            )


def not_plugged_in(stages: dict[str, Family]) -> dict[str, DriverError]:
    """For each of the named stages whose serial number is not plugged in: an error that lists what is there."""
    present = {port.serial_number: port.device for port in list_ports.comports() if port.serial_number}
    there = ", ".join(f"{number} at {port}" for number, port in sorted(present.items())) or "none"
    return {
        name: DeviceNotFound(
            f"{name}: no USB serial adapter {settings.serial_number} is plugged in (there are: {there}); "
            f"check its cable, its power and the instrument file"
        )
        for name, settings in stages.items()
        if settings.serial_number is not None and settings.serial_number not in present
    }
