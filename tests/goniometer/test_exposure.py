"""Exposure is judged on a detector of known brightness, saturation and darkness that lives in memory."""

import asyncio
from itertools import pairwise

import numpy as np
import pytest

from drivers.clock import WallClock
from drivers.interfaces import Spectrum
from goniometer.campaign import Integration
from goniometer.errors import CampaignError
from goniometer.exposure import Brightness, check_limits, choose, ladder, predict, take
from goniometer.instrument import Instrument

POLICY = Integration()
SATURATION = 200_000
OFFSET = 1500


class Detector:
    """A spectrometer and light that see `rate` counts per second in their brightest pixel."""

    name = "detector"
    integration_limits = (0.008, 1600.0)
    saturation = SATURATION

    def __init__(self, rate):
        self.rate = rate
        self.is_open = False
        self.taken = []

    async def set_lamp(self, on):
        pass

    async def set_shutter(self, is_open):
        self.is_open = is_open

    async def wavelengths(self):
        return np.linspace(250, 1050, 1044)

    async def expose(self, integration_time):
        random = np.random.default_rng(len(self.taken))
        light = self.rate * integration_time * np.linspace(0, 1, 1044) if self.is_open else np.zeros(1044)
        counts = np.clip(light + OFFSET + random.normal(0, 6, 1044), 0, SATURATION)
        self.taken.append(integration_time)
        return Spectrum(np.rint(counts).astype(np.uint32), integration_time, len(self.taken), -10.0)

    async def sequence(self, integration_time, scans):
        return [await self.expose(integration_time) for _ in range(scans)]


def expose(rate, predicted=None, scans=1, policy=POLICY):
    """Spectra that `take` accepts, and the integration times of all light exposures."""
    detector = Detector(rate)
    instrument = Instrument(None, None, detector, detector, WallClock(), gain=5.0)

    async def dark(_):
        return np.full(1044, float(OFFSET))

    return asyncio.run(take(instrument, policy, scans, predicted, dark)), detector.taken


@pytest.mark.parametrize("rate", [0.0, 3.0, 400.0, 4e3, 3e4, 2e5, 1e6, 6e6, 1.5e7])
@pytest.mark.parametrize("predicted", [None, 1.0, 400.0, 1e6])
def test_a_spectrum_is_as_bright_as_it_may_be_and_not_saturated_whatever_was_expected(rate, predicted):
    spectra, taken = expose(rate, predicted)
    (spectrum,) = spectra
    assert spectrum.counts.max() < SATURATION
    assert spectrum.counts.max() > 0.1 * SATURATION or spectrum.integration_time == POLICY.maximum
    assert len(taken) <= 6


def test_a_surface_that_saturates_at_the_shortest_time_is_accepted_and_ends_there():
    spectra, _ = expose(1e8)
    assert spectra[0].integration_time == POLICY.minimum
    assert spectra[0].counts.max() == SATURATION


def test_a_good_prediction_costs_no_extra_exposure():
    _, taken = expose(400.0, 410.0, scans=3)
    assert taken == [30.0] * 3


def test_the_probe_is_short_so_that_an_unknown_direction_costs_little():
    _, taken = expose(400.0)
    assert taken[0] < 0.2
    assert taken[1:] == [30.0]


def test_all_spectra_of_a_point_have_one_integration_time():
    spectra, _ = expose(5e4, scans=4)
    assert len(spectra) == 4
    assert len({s.integration_time for s in spectra}) == 1


def test_a_scan_needs_few_different_times_and_so_few_darks():
    times = ladder(POLICY)
    assert times[0] == POLICY.minimum
    assert times[-1] == POLICY.maximum
    assert len(times) <= 13
    assert all(round(t * 1e6) == pytest.approx(t * 1e6, abs=1e-6) for t in times)
    assert max(b / a for a, b in pairwise(times)) <= 2.0001


def test_the_chosen_time_keeps_to_the_wanted_fill():
    for rate in np.geomspace(1, 1e7, 50):
        time = choose(float(rate), SATURATION, POLICY)
        assert rate * time + OFFSET <= POLICY.fill * SATURATION or time == POLICY.minimum
        assert rate * time > 0.3 * POLICY.fill * SATURATION or time == POLICY.maximum or rate * POLICY.minimum > 7e4


def test_neighbours_predict_only_what_lies_between_two_that_are_alike():
    seen = [Brightness(-10, 100.0), Brightness(0, 150.0), Brightness(10, 4000.0)]
    assert predict(-5, seen) == 150.0
    assert predict(5, seen) is None
    assert predict(20, seen) is None
    assert predict(0, []) is None


def test_times_that_the_spectrometer_cannot_take_are_refused_before_the_scan():
    detector = Detector(1.0)
    instrument = Instrument(None, None, detector, detector, WallClock(), gain=5.0)
    check_limits(POLICY, instrument)
    check_limits(Integration(maximum=1599.0), instrument)
    with pytest.raises(CampaignError, match=r"0\.001 to 30 s"):
        check_limits(Integration(minimum=0.001), instrument)
    with pytest.raises(CampaignError, match=r"less than 1600 s"):
        check_limits(Integration(maximum=1600.0), instrument)  # the driver takes everything below, and not this
