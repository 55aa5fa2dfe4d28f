"""Where the arm was while it moved, and what of a range each spectrum saw that was taken meanwhile."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.errors import DeviceFault, ProtocolError
from drivers.interfaces import Spectrum

SWEEP_MARGIN = 1.0
"""Seconds of spectra beyond those that a sweep should need: a controller may take that long to begin a motion."""

MOVED = 0.1
"""Degrees that an arm must have moved during a spectrum that belongs to a sweep; less it may read amiss at rest."""

UNSEEN = 0.25
"""The part of a reading's interval that may be missing between two of them, and at the ends of a range."""

TOO_WIDE = 1.5
"""How many times as far as it should the arm must not have moved during a spectrum."""


@dataclass(frozen=True)
class Passage:
    """A spectrum that was taken while the arm moved."""

    spectrum: Spectrum
    start: float
    """Where the detector stage was when its integration began, degrees."""
    stop: float
    """Where it was when it ended."""
    moment: float
    """Of its middle, seconds on the clock of the bench."""


def passages(
    name: str, spectra: Sequence[Spectrum], track: Sequence[tuple[float, float]], step: float
) -> list[Passage]:
    """Those of `spectra` during which the arm moved, in the order of time, each with the way that it made.

    `name` is the detector stage's, for messages. `track` are moments, seconds and ascending, and the angles that the
    arm read then, degrees, the first before it moved and the last after; between them it is taken to move evenly. It
    should move by `step` degrees during a spectrum. Raises `ProtocolError` where the spectrometer does not say when a
    spectrum began, or where part of the way was not seen; `DeviceFault` where the arm was too quick.
    """
    moments, angles = np.array(track).T
    found = []
    for spectrum in spectra:
        if spectrum.began is None:
            raise ProtocolError("The spectrometer does not tell when it took a spectrum, which a moving arm needs")
        start, stop = np.interp([spectrum.began, spectrum.began + spectrum.integration_time], moments, angles).tolist()
        if abs(stop - start) > TOO_WIDE * step:
            raise DeviceFault(
                f"{name}: moved by {abs(stop - start):.2f}° in {spectrum.integration_time:g} s where {step:g}° were "
                f"wanted; check its velocity"
            )
        if abs(stop - start) >= MOVED:
            found.append(Passage(spectrum, start, stop, spectrum.began + spectrum.integration_time / 2))
    _check_whole(name, found, float(angles[0]), float(angles[-1]), step)
    return found


def _check_whole(name: str, found: Sequence[Passage], start: float, stop: float, step: float) -> None:
    """Raise `ProtocolError` where more than `UNSEEN` of a reading's interval is missing of the way."""
    seen = start
    allowed = UNSEEN * step + MOVED
    for here, there in [*((p.start, p.stop) for p in found), (stop, stop)]:
        if abs(here - seen) > allowed:
            raise ProtocolError(
                f"{name}: no spectrum saw the way from {seen:.2f}° to {here:.2f}° of a sweep; was the arm held up, or "
                f"the spectrometer?"
            )
        seen = there
