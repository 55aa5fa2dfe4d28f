"""The simulated laboratory: three devices that answer on the wire and one optical bench behind them.

Its stages may be of any family. The demo bench has a Newport SMC100 as sample stage, an Oriental AZ as detector
stage and a QE Pro.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from usb.backend import IBackend

from goniometer.constants import BenchData
from simulators.bench.imperfections import Imperfections, drawn
from simulators.bench.optics import STATED, OpticalBench, positioning_error
from simulators.devices.clock import SimulatedClock
from simulators.devices.k10cr1 import SimulatedK10CR1
from simulators.devices.motion import Axis
from simulators.devices.oriental_az import SimulatedOrientalAZ
from simulators.devices.owis import SimulatedOwisPS
from simulators.devices.qepro import SimulatedQEPro
from simulators.devices.smc100 import SimulatedSMC100

SERIAL_NUMBER = "QEP00001"
STAGES = ("smc100", "oriental-az")
"""Families of the sample and of the detector stage of the demo bench."""
COUNTS_PER_DEGREE = 1000.0
"""Of a simulated OWIS stage."""
MOUNT_TIME = 120.0
"""Seconds that it takes to exchange what lies on the sample stage."""

SimulatedStage = SimulatedSMC100 | SimulatedOrientalAZ | SimulatedOwisPS | SimulatedK10CR1

FAMILIES: dict[str, Callable[[Axis, SimulatedClock], SimulatedStage]] = {
    "smc100": lambda axis, _: SimulatedSMC100(axis),
    "oriental-az": lambda axis, _: SimulatedOrientalAZ(axis),
    "owis": lambda axis, clock: SimulatedOwisPS([axis], clock, counts_per_degree=COUNTS_PER_DEGREE),
    "k10cr1": lambda axis, _: SimulatedK10CR1(axis),
}
"""What makes a stage of each family, as an instrument file calls its driver."""


@dataclass(frozen=True)
class Laboratory:
    """Where the simulated devices answer, and the bench on which samples are mounted."""

    clock: SimulatedClock
    bench: OpticalBench
    families: tuple[str, str]
    """Of the sample and of the detector stage, as an instrument file calls their drivers."""
    sample_stage: SimulatedStage
    """With its fault script."""
    detector_stage: SimulatedStage
    """With its fault script."""
    spectrometer: SimulatedQEPro
    """With its fault script."""
    sample_stage_url: str
    """For its driver."""
    detector_stage_url: str
    """For its driver."""
    data: BenchData
    """What its operator believes of the bench; the truth are `bench.imperfections`."""

    @property
    def usb_backend(self) -> IBackend:
        """A pyusb backend on which the QE Pro is plugged in."""
        return self.spectrometer

    def mount(self, material: str, spot: int = 0) -> None:
        """Lay a material on the sample stage as `OpticalBench.mount` does, which takes `MOUNT_TIME`."""
        self.clock.advance_to(self.clock.now() + MOUNT_TIME)
        self.bench.mount(material, spot)


@contextmanager
def simulated_laboratory(
    seed: int, stages: tuple[str, str] = STAGES, imperfections: Imperfections | None = None
) -> Iterator[Laboratory]:
    """Switch on the simulated devices; they are gone when the context ends.

    The same `seed` gives the same noise and the same errors, whatever happened before. `stages` are the families of the
    sample and of the detector stage, keys of `FAMILIES`. `imperfections` of None are drawn from what the operator
    states of the bench, without any that depends on time; `IDEAL` is an ideal bench.
    """
    if imperfections is None:
        imperfections = drawn(seed, STATED)
    clock = SimulatedClock()
    sample_error, detector_error = (positioning_error(seed, f"{stage} stage") for stage in ("sample", "detector"))
    sample_axis = Axis(
        clock,
        velocity=20.0,
        acceleration=80.0,
        limits=(-5.0, 95.0),
        # Errors depend on what is measured and not on time, so that a resumed scan repeats those of a killed one; a
        # move that is made again for another sample or direction has another error, as on a real stage.
        positioning_error=lambda target: sample_error(target, *bench.circumstances),
    )
    detector_axis = Axis(
        clock,
        velocity=30.0,
        acceleration=60.0,
        limits=(-95.0, 180.0),
        positioning_error=lambda target: detector_error(target, *bench.circumstances, round(sample_axis.position(), 4)),
    )
    bench = OpticalBench(
        clock, seed=seed, sample_axis=sample_axis, detector_axis=detector_axis, imperfections=imperfections
    )
    spectrometer = SimulatedQEPro(bench, clock, serial_number=SERIAL_NUMBER)
    spectrometer.faults.ripple = imperfections.cooler_ripple
    with ExitStack() as switched_on:
        sample_stage, detector_stage = (
            FAMILIES[family](axis, clock) for family, axis in zip(stages, (sample_axis, detector_axis), strict=True)
        )
        switched_on.callback(sample_stage.close)
        switched_on.callback(detector_stage.close)
        yield Laboratory(
            clock=clock,
            bench=bench,
            families=stages,
            sample_stage=sample_stage,
            detector_stage=detector_stage,
            spectrometer=spectrometer,
            sample_stage_url=sample_stage.start(),
            detector_stage_url=detector_stage.start(),
            data=STATED,
        )
