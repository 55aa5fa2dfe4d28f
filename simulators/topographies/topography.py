"""Surfaces by name: synthesised ones, and those that a microscope measured."""

from dataclasses import dataclass
from pathlib import Path

from goniometer.errors import InputError
from simulators.choices import PITCH_UM, SIZE
from simulators.materials.materials import SAMPLES
from simulators.topographies.heights import HeightField
from simulators.topographies.synthesis import (
    brushed,
    gaussian,
    gaussian_correlation,
    polished_sample,
    sandblasted_sample,
    with_micro_roughness,
)
from simulators.topographies.topography_file import read_topography

MEASURED_AREA_RATIOS = {
    "sample-1": 1.0915,
    "sample-2": 1.0587,
    "sample-3": 1.0372,
    "sample-4": 1.0327,
    "sample-5": 1.0209,
    "sample-6": 1.0197,
}
"""Area of the paper's samples over the area below them, from confocal maps with 0.625 um between points (Sdr + 1)."""


@dataclass(frozen=True)
class Topography:
    """A surface and where it came from."""

    name: str
    field: HeightField
    origin: dict[str, object]
    """How it was made or read, for the lineage of what is computed from it."""


def topography(what: str, size: int | None, pitch_um: float | None, seed: int, *, micro: bool) -> Topography:
    """The surface that `what` names, synthesised on `size` x `size` points of `pitch_um`, or read from a file.

    "sample-1" to "sample-8" are the paper's, sandblasted or polished as Table 1 says; "gaussian:RMS:LENGTH" has a
    Gaussian autocorrelation and "brushed:RMS:ACROSS:ALONG" strokes, all lengths in um. Anything else is a file, which
    is taken as it is (`simulators.topographies.topography_file.read_topography`): a size or a pitch is refused. For
    others None is the usual one. `micro` puts the usual roughness below the wavelength on it
    (`simulators.topographies.synthesis.with_micro_roughness`).
    Raises `InputError` for what is none of these.
    """
    kind, *numbers = what.split(":")
    if kind in SAMPLES or kind in _FORMS:
        made = _synthesised(what, kind, numbers, size or SIZE, pitch_um or PITCH_UM, seed)
    elif Path(what).is_file():
        if size is not None or pitch_um is not None:
            raise InputError(f"The map in {what} has a size and a pitch of its own; leave out --size and --pitch.")
        made = Topography(Path(what).name, *read_topography(Path(what)))
    else:
        raise InputError(
            f"There is no surface and no file '{what}'; name a sample, e.g. sample-1, {' or '.join(_FORMS.values())} "
            f"with lengths in um, or a topography file."
        )
    field = with_micro_roughness(made.field, seed + 1) if micro else made.field
    return Topography(made.name, field, made.origin | {"micro_roughness": micro})


_FORMS = {"gaussian": "gaussian:RMS:LENGTH", "brushed": "brushed:RMS:ACROSS:ALONG"}


def _synthesised(what: str, kind: str, numbers: list[str], size: int, pitch_um: float, seed: int) -> Topography:
    """The surface of this kind."""
    origin: dict[str, object] = {"surface": what, "size": size, "pitch_um": pitch_um, "seed": seed}
    if kind == "gaussian":
        rms, length = _lengths(what, numbers, _FORMS[kind])
        return Topography(what, gaussian(rms, gaussian_correlation(length), size, pitch_um, seed), origin)
    if kind == "brushed":
        rms, across, along = _lengths(what, numbers, _FORMS[kind])
        return Topography(what, brushed(rms, across, along, size, pitch_um, seed), origin)
    if numbers:
        raise InputError(f"The surface '{what}' should read {kind}, without numbers.")
    if SAMPLES[kind].abrasive_um is None:
        made_as = "waviness with facets as flat as its alpha says, without the scratches of the paper's mirror"
        return Topography(what, polished_sample(SAMPLES[kind], size, pitch_um, seed), origin | {"made_as": made_as})
    made = sandblasted_sample(SAMPLES[kind], size, pitch_um, seed)
    facts = {"deepest_dent_um": made.depth_um, "dents": made.dents, "bare_share": made.bare}
    return Topography(what, made.field, origin | facts)


def _lengths(what: str, numbers: list[str], form: str) -> list[float]:
    """The positive numbers of `what`, as many as `form` has."""
    try:
        found = [float(number) for number in numbers]
    except ValueError:
        found = []
    if len(found) != form.count(":") or not all(0 < number < float("inf") for number in found):
        raise InputError(f"The surface '{what}' should read {form}, with positive lengths in um.")
    return found
