"""The simulated laboratory: three devices that answer on the wire and one optical bench behind them.

The demo bench has a Newport SMC100 as sample stage, an Oriental AZ as detector stage and a QE Pro.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from usb.backend import IBackend

from simulators.bench import GAIN, OpticalBench, positioning_error
from simulators.clock import SimulatedClock
from simulators.motion import Axis
from simulators.oriental_az import SimulatedOrientalAZ
from simulators.qepro import SimulatedQEPro
from simulators.smc100 import SimulatedSMC100

SERIAL_NUMBER = "QEP00001"


@dataclass(frozen=True)
class Laboratory:
    """Where the simulated devices answer, and the bench on which samples are mounted."""

    clock: SimulatedClock
    bench: OpticalBench
    sample_stage_url: str
    """Of the SMC100, for `serial.serial_for_url`."""
    detector_stage_url: str
    """Of the Oriental AZ, tcp://host:port."""
    usb_backend: IBackend
    """A pyusb backend on which the QE Pro is plugged in."""
    gain: float
    """Electrons per count of the QE Pro, as its data sheet would say."""


@contextmanager
def simulated_laboratory(seed: int) -> Iterator[Laboratory]:
    """Switch on the simulated devices; they are gone when the context ends.

    The same `seed` gives the same noise and the same positioning errors, whatever happened before.
    """
    clock = SimulatedClock()
    sample_error, detector_error = (positioning_error(seed, f"{stage} stage") for stage in ("sample", "detector"))
    sample_axis = Axis(
        clock,
        velocity=20.0,
        acceleration=80.0,
        limits=(-5.0, 95.0),
        # Errors depend on what is measured and not on time, so that a resumed scan repeats those of a killed one; a
        # move that is made again for another sample or direction has another error, as on a real stage.
        positioning_error=lambda target: sample_error(target, bench.mounted),
    )
    detector_axis = Axis(
        clock,
        velocity=30.0,
        acceleration=60.0,
        limits=(-95.0, 180.0),
        positioning_error=lambda target: detector_error(target, bench.mounted, round(sample_axis.position(), 4)),
    )
    bench = OpticalBench(clock, seed=seed, sample_axis=sample_axis, detector_axis=detector_axis)
    sample_stage = SimulatedSMC100(sample_axis)
    detector_stage = SimulatedOrientalAZ(detector_axis)
    spectrometer = SimulatedQEPro(bench, clock, serial_number=SERIAL_NUMBER)
    url = sample_stage.start()
    try:
        host, port = detector_stage.start()
        try:
            yield Laboratory(clock, bench, url, f"tcp://{host}:{port}", spectrometer, GAIN)
        finally:
            detector_stage.close()
    finally:
        sample_stage.close()
