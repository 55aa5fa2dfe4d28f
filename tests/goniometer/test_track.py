"""What a sweep saw, from tracks that were worked out by hand."""

import numpy as np
import pytest

from drivers.errors import DeviceFault, ProtocolError
from drivers.interfaces import Spectrum
from goniometer.bench.track import passages


def spectra(moments, seconds=0.5):
    return [Spectrum(np.zeros(3, dtype=np.uint32), seconds, i, -10.0, moment) for i, moment in enumerate(moments)]


TRACK = [(10.0, 0.0), (10.2, 0.0), (11.2, 4.0), (12.7, 10.0), (13.7, 10.0)]
"""At rest for 0.2 s, then 4 degrees/s over 10 degrees, then at rest again."""


def test_each_spectrum_gets_the_way_that_the_arm_made_meanwhile_and_those_at_rest_are_left_out():
    found = passages("arm", spectra(9.5 + 0.5 * np.arange(9)), TRACK, 2.0)
    assert [(p.start, p.stop) for p in found] == [
        pytest.approx(way) for way in [(0, 1.2), (1.2, 3.2), (3.2, 5.2), (5.2, 7.2), (7.2, 9.2), (9.2, 10)]
    ]
    assert [p.moment for p in found] == pytest.approx([10.25, 10.75, 11.25, 11.75, 12.25, 12.75])
    assert [p.spectrum.count for p in found] == [1, 2, 3, 4, 5, 6]


def test_a_sweep_may_go_either_way():
    back = [(moment, -angle) for moment, angle in TRACK]
    found = passages("arm", spectra(10 + 0.5 * np.arange(8)), back, 2.0)
    assert (found[1].start, found[1].stop) == pytest.approx((-1.2, -3.2))


@pytest.mark.parametrize(
    ("moments", "words"),
    [
        (10 + 0.5 * np.arange(4), r"from 7\.20° to 10\.00°"),  # the arm came too late
        (10.8 + 0.5 * np.arange(6), r"from 0\.00° to 2\.40°"),  # the spectra did
        ([10.0, 10.5, 11.3, 11.8, 12.3, 12.8], r"from 3\.20° to 4\.40°"),  # one took its time
        ([], r"from 0\.00° to 10\.00°"),
    ],
)
def test_a_way_that_no_spectrum_saw_is_not_taken_for_searched(moments, words):
    with pytest.raises(ProtocolError, match=words):
        passages("arm", spectra(moments), TRACK, 2.0)


def test_an_arm_that_runs_away_is_no_pre_scan():
    with pytest.raises(DeviceFault, match=r"moved by 2\.00° in 0\.5 s where 1° were wanted"):
        passages("arm", spectra(10 + 0.5 * np.arange(8)), TRACK, 1.0)


def test_a_spectrometer_that_does_not_tell_when_it_began_cannot_serve_a_moving_arm():
    with pytest.raises(ProtocolError, match="does not tell when"):
        passages("arm", spectra([None]), TRACK, 2.0)
