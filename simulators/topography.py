"""Surfaces by name: synthesised ones, and those that a microscope measured."""

from dataclasses import dataclass

from goniometer.errors import InputError
from simulators.heights import HeightField
from simulators.materials import SAMPLES
from simulators.synthesis import (
    brushed,
    gaussian,
    gaussian_correlation,
    sandblasted_sample,
    with_micro_roughness,
)

SIZE, PITCH_UM = 1024, 0.5
"""Usual points along each side of a synthesised surface, and their distance, um."""


@dataclass(frozen=True)
class Topography:
    """A surface and where it came from."""

    name: str
    field: HeightField
    origin: dict[str, object]
    """How it was made or read, for the lineage of what is computed from it."""


def topography(what: str, size: int | None, pitch_um: float | None, seed: int, *, micro: bool) -> Topography:
    """The surface that `what` names, synthesised on `size` x `size` points of `pitch_um`.

    "sample-1" to "sample-8" are the paper's, sandblasted as Table 1 says; "gaussian:RMS:LENGTH" has a Gaussian
    autocorrelation and "brushed:RMS:ACROSS:ALONG" strokes, all lengths in um. A size or a pitch of None is the usual
    one. `micro` puts the usual roughness below the wavelength on it (`simulators.synthesis.with_micro_roughness`).
    Raises `InputError` for anything else.
    """
    kind, *numbers = what.split(":")
    size, pitch_um = size or SIZE, pitch_um or PITCH_UM
    origin: dict[str, object] = {"surface": what, "size": size, "pitch_um": pitch_um, "seed": seed}
    if kind in SAMPLES:
        field = sandblasted_sample(SAMPLES[kind], size, pitch_um, seed).field
    elif kind == "gaussian":
        rms, length = _lengths(what, numbers, "gaussian:RMS:LENGTH")
        field = gaussian(rms, gaussian_correlation(length), size, pitch_um, seed)
    elif kind == "brushed":
        rms, across, along = _lengths(what, numbers, "brushed:RMS:ACROSS:ALONG")
        field = brushed(rms, across, along, size, pitch_um, seed)
    else:
        raise InputError(
            f"There is no surface '{what}'; name a sample, e.g. sample-1, gaussian:RMS:LENGTH or "
            f"brushed:RMS:ACROSS:ALONG with lengths in um."
        )
    if micro:
        field = with_micro_roughness(field, seed + 1)
    return Topography(what, field, origin | {"micro_roughness": micro})


def _lengths(what: str, numbers: list[str], form: str) -> list[float]:
    """The positive numbers of `what`, as many as `form` has."""
    try:
        found = [float(number) for number in numbers]
    except ValueError:
        found = []
    if len(found) != form.count(":") or not all(0 < number < float("inf") for number in found):
        raise InputError(f"The surface '{what}' should read {form}, with positive lengths in um.")
    return found
