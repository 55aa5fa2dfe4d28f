"""Exposure is judged on a detector of known brightness, saturation and darkness that lives in memory."""

import asyncio
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from drivers.clock import WallClock
from drivers.interfaces import Spectrum
from goniometer.bench.instrument import Instrument
from goniometer.campaigns.campaign import Integration
from goniometer.constants import BenchData, Constants
from goniometer.errors import CampaignError
from goniometer.scans.exposure import (
    BIN,
    DIM,
    MOST_SPECTRA,
    Brightness,
    DarkSignal,
    check_limits,
    choose,
    detector_of,
    ladder,
    predict,
    take,
)

POLICY = Integration()
SATURATION = 200_000
OFFSET = 1500
READ_NOISE = 6.0


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
        light = random.poisson(5.0 * light) / 5.0
        counts = np.clip(light + OFFSET + random.normal(0, READ_NOISE, 1044), 0, SATURATION)
        self.taken.append(integration_time)
        return Spectrum(np.rint(counts).astype(np.uint32), integration_time, len(self.taken), -10.0)

    async def sequence(self, integration_time, scans):
        return [await self.expose(integration_time) for _ in range(scans)]


CONSTANTS = Constants("detector", {}, np.linspace(250, 1050, 1044), np.array([1.0]), SATURATION, BenchData(gain=5.0))
DETECTOR = detector_of(CONSTANTS)


def instrument_of(detector):
    return Instrument(None, None, detector, detector, WallClock())


def seen(rate):
    """What a spectrum looks like that is `rate` counts per second bright in its brightest pixel."""
    light = rate * np.linspace(0, 1, 1044)
    bins = light[DETECTOR.bins].sum(axis=1)
    return Brightness(rate, float(np.median(bins)), float(np.quantile(bins, DIM)), READ_NOISE**2)


def exposed(rate, predicted=None, policy=POLICY):
    """What `take` gives, and the integration times of all light exposures."""
    detector = Detector(rate)

    async def dark(integration_time, temperature):
        assert temperature == -10.0
        return DarkSignal(np.full(1044, float(OFFSET)), READ_NOISE**2, temperature)

    expected = None if predicted is None else seen(predicted)
    return asyncio.run(take(instrument_of(detector), DETECTOR, policy, expected, dark)), detector.taken


def expose(rate, predicted=None, scans=1):
    """Spectra that `take` accepts, and the integration times of all light exposures."""
    taken, times = exposed(rate, predicted, Integration(scans=scans))
    assert taken.reason == ""
    return taken.spectra, times


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
        time, scans = choose(seen(float(rate)), POLICY, DETECTOR)
        assert scans == 1
        assert rate * time + OFFSET <= POLICY.fill * SATURATION or time == POLICY.minimum
        assert rate * time > 0.3 * POLICY.fill * SATURATION or time == POLICY.maximum or rate * POLICY.minimum > 7e4


def test_neighbours_predict_only_what_lies_between_two_that_are_alike():
    neighbours = [(-10.0, seen(100.0)), (0.0, seen(150.0)), (10.0, seen(4000.0))]
    assert predict(-5, neighbours) == seen(150.0)
    assert predict(5, neighbours) is None
    assert predict(20, neighbours) is None
    assert predict(0, []) is None


def test_times_that_the_spectrometer_cannot_take_are_refused_before_the_scan():
    detector = Detector(1.0)
    instrument = instrument_of(detector)
    check_limits(POLICY, instrument)
    check_limits(Integration(maximum=1599.0), instrument)
    with pytest.raises(CampaignError, match=r"0\.001 to 30 s"):
        check_limits(Integration(minimum=0.001), instrument)
    with pytest.raises(CampaignError, match=r"less than 1600 s"):
        check_limits(Integration(maximum=1600.0), instrument)  # the driver takes everything below, and not this


# A wanted signal-to-noise ratio


def expected_ratio(taken, rate):
    """Signal-to-noise ratio of the median bin by the closed form of Poisson and read-out noise."""
    (time,) = {s.integration_time for s in taken.spectra}
    signal = np.median((rate * np.linspace(0, 1, 1044))[DETECTOR.bins].sum(axis=1)) * time
    return signal * np.sqrt(len(taken.spectra)) / np.sqrt(signal / 5.0 + BIN * READ_NOISE**2)


@pytest.mark.parametrize("rate", [40.0, 400.0, 3e4, 1e6])
@pytest.mark.parametrize("predicted", [None, 0.5, 1.0, 30.0])
@pytest.mark.parametrize("wanted", [20.0, 150.0, 1000.0])
def test_the_wanted_ratio_is_reached_and_hardly_more_is_spent(rate, predicted, wanted):
    policy = Integration(signal_to_noise=wanted, time_limit=3000.0)
    taken, times = exposed(rate, None if predicted is None else predicted * rate, policy)
    assert taken.reason == ""
    assert max(s.counts.max() for s in taken.spectra) < SATURATION
    assert expected_ratio(taken, rate) > 0.95 * wanted
    (time,) = {s.integration_time for s in taken.spectra}
    fewer = replace(taken, spectra=taken.spectra[1:])
    assert len(fewer.spectra) == 0 or expected_ratio(fewer, rate) < 1.05 * wanted
    # what was discarded on the way cost less than what was kept, or was the probe
    assert sum(times) <= 2 * len(taken.spectra) * time + POLICY.maximum / 256


def test_a_bright_point_is_not_exposed_until_it_is_full_where_less_is_enough():
    _, times = exposed(2000.0, 2000.0, Integration(signal_to_noise=50.0))
    assert sum(times) < 0.3
    full, _ = exposed(2000.0, 2000.0, Integration())
    assert full.spectra[0].integration_time == 30.0


def test_a_point_that_is_too_dark_keeps_what_the_time_limit_allows_and_says_how_far_it_came():
    taken, _ = exposed(2.0, None, Integration(signal_to_noise=500.0, time_limit=100.0))
    kept = [s.integration_time for s in taken.spectra]
    assert 85.0 <= sum(kept) <= 100.0
    said = re.fullmatch(r"reached a signal-to-noise ratio of ([\d.]+) of 500 within 100 s", taken.reason)
    assert said is not None
    assert float(said[1]) == pytest.approx(expected_ratio(taken, 2.0), rel=0.1)


def test_a_direction_without_any_light_ends_at_the_time_limit():
    taken, times = exposed(0.0, None, Integration(signal_to_noise=10.0, time_limit=60.0))
    assert sum(s.integration_time for s in taken.spectra) <= 60.0
    assert sum(times) < 130.0
    assert taken.reason.endswith("of 10 within 60 s")


def test_no_point_costs_thousands_of_spectra():
    policy = Integration(minimum=0.008, maximum=0.01, signal_to_noise=1e5, time_limit=1000.0)
    taken, _ = exposed(1000.0, None, policy)
    assert len(taken.spectra) == MOST_SPECTRA
    assert taken.reason.endswith(f"of 100000 with {MOST_SPECTRA} spectra")


@pytest.mark.parametrize("wanted", [None, 100.0])
@pytest.mark.parametrize("rate", [1e4, 1e5, 1e6, 6e6, 1.5e7])
def test_two_or_three_times_span_more_than_one_spectrum_can(rate, wanted):
    spread = {}
    for exposures in (1, 2, 3):
        policy = Integration(exposures=exposures, signal_to_noise=wanted)
        taken, _ = exposed(rate, None, policy)
        times = sorted({s.integration_time for s in taken.spectra})
        assert len(times) <= exposures
        assert [s.integration_time for s in taken.spectra] == sorted(s.integration_time for s in taken.spectra)
        shortest = [s for s in taken.spectra if s.integration_time == times[0]]
        assert max(s.counts.max() for s in shortest) < SATURATION
        # at the longest time the dim bins still tell something
        longest = np.stack([s.counts for s in taken.spectra if s.integration_time == times[-1]])
        assert np.quantile(longest[:, DETECTOR.bins].max(axis=(0, 2)), DIM) < SATURATION
        spread[exposures] = times
    if wanted is None:
        assert spread[2][-1] > 2 * spread[1][-1]
        assert [spread[3][0], spread[3][-1]] == spread[2]
        assert len(spread[3]) == 3


def test_the_stored_time_of_a_point_lies_in_the_middle_of_its_exposures():
    class Ticking:
        now_is = 1000.0

        def now(self):
            return self.now_is

    clock = Ticking()
    detector = Detector(400.0)
    expose = detector.expose

    async def passing(integration_time):
        clock.now_is += integration_time
        return await expose(integration_time)

    detector.expose = passing

    async def dark(integration_time, temperature):
        clock.now_is += 500.0
        return DarkSignal(np.full(1044, float(OFFSET)), READ_NOISE**2, temperature)

    instrument = Instrument(None, None, detector, detector, clock)
    taken = asyncio.run(take(instrument, DETECTOR, Integration(), seen(400.0), dark))
    assert taken.moment == 1015.0
