"""The optical bench with hands and without devices: set angles, read the mean of some exposures."""

from typing import Any

import numpy as np

from simulators.bench.imperfections import Imperfections
from simulators.bench.optics import OpticalBench
from simulators.devices.clock import SimulatedClock


class Standing:
    """An axis that stands where it was put."""

    def __init__(self) -> None:
        self.angle = 0.0

    def true_positions(self, moments: np.ndarray) -> np.ndarray:
        return np.full(moments.shape, self.angle)


class Bench:
    """An optical bench on which something lies; `errors` are those of its `Imperfections` that it has."""

    def __init__(
        self,
        material: str = "spectralon",
        seed: int = 1,
        sensor_temperature: float = -10.0,
        spot: int = 0,
        **errors: Any,
    ) -> None:
        self.sensor_temperature = sensor_temperature
        self.clock = SimulatedClock()
        self.sample, self.detector = Standing(), Standing()
        self.optics = OpticalBench(
            self.clock,
            seed=seed,
            sample_axis=self.sample,
            detector_axis=self.detector,
            imperfections=Imperfections(**errors),
        )
        self.optics.mount(material, spot)
        self.wavelengths = np.polynomial.polynomial.polyval(np.arange(1044), self.optics.wavelength_coefficients)
        """[pixels] as the spectrometer says, nm."""

    def turn(self, theta_in: float, theta_out: float) -> "Bench":
        self.sample.angle, self.detector.angle = theta_in, theta_in + theta_out
        return self

    def read(self, seconds: float, light: bool = True) -> np.ndarray:
        return self.optics.read_out(
            seconds, shutter_open=light, lamp_on=True, sensor_temperature=self.sensor_temperature
        )

    def mean(self, seconds: float, light: bool = True, times: int = 40) -> np.ndarray:
        return np.mean([self.read(seconds, light) for _ in range(times)], axis=0)

    def signal(self, seconds: float, times: int = 40) -> np.ndarray:
        """Dark-subtracted mean counts, divided by the device's own polynomial."""
        x = self.mean(seconds, times=times) - self.mean(seconds, light=False, times=times)
        return x / np.polynomial.polynomial.polyval(x, self.optics.nonlinearity_coefficients)
