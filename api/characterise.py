"""The bench measures itself: what is run, kept, told, drawn, and proposed for the instrument file."""

from collections.abc import Awaitable, Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from analysis.figures.characterisation import (
    alignment_panels,
    noise_panels,
    repeatability_panels,
    signature_panels,
    wavelength_panels,
)
from analysis.figures.notation import with_uncertainty
from analysis.figures.svg import side_by_side
from analysis.strict_json import strict_json
from api.service import open_instrument, simulated_settings
from api.settings import Family, InstrumentSettings
from api.written import Export, write_text
from goniometer.bench.instrument import Instrument
from goniometer.characterisation.alignment import Alignment
from goniometer.characterisation.characterise import Mount, Piece
from goniometer.characterisation.evaluation import FAR, Noise, Repeatability, Signature, StageRepeatability
from goniometer.characterisation.lines import WavelengthScale
from goniometer.constants import BenchData
from goniometer.errors import InputError
from goniometer.storage.store import Store

Result = Signature | Noise | Alignment | Repeatability | WavelengthScale
Found = TypeVar("Found", bound=Result)
Proposals = dict[str, dict[str, float]]
"""Values for the instrument file, by table and key."""

KINDS: dict[type, str] = {
    Signature: "signature",
    Noise: "noise",
    Alignment: "alignment",
    Repeatability: "repeatability",
    WavelengthScale: "wavelength",
}
"""How each result is called in the database."""

STATED = "Uncertainties in brackets are standard uncertainties (coverage factor k = 1)."

_DIGITS = 7


async def characterise(
    store: Store,
    settings: InstrumentSettings | None,
    seed: int,
    ask: Callable[[Piece], Awaitable[None]],
    measure: Callable[[Instrument, Mount], Awaitable[Found]],
) -> tuple[Found, Proposals]:
    """Open the bench, or the simulated one without `settings`, let it `measure` itself, and keep the result.

    `ask` asks a person to put a piece on the sample stage of a real bench. Returns what was found and what the
    instrument file should say. Raises what `open_instrument` and `measure` raise, and `StoreBusy`.
    """
    with store.exclusive():
        async with open_instrument(settings, seed) as (instrument, laboratory):

            async def mount(piece: Piece) -> None:
                if laboratory is None:
                    await ask(piece)
                else:
                    laboratory.mount(piece)

            found = await measure(instrument, mount)
            if settings is None:
                assert laboratory is not None  # without settings there is nothing else
                settings = simulated_settings(laboratory)
        proposed = proposals(found, settings)
        store.add_characterisation(KINDS[type(found)], strict_json(content(found, proposed)))
    return found, proposed


def content(found: Result, proposed: Proposals) -> dict[str, Any]:
    """A result as JSON content."""
    return {
        "kind": KINDS[type(found)],
        "result": _plain(found),
        "proposed": proposed,
        "units": {"angles": "deg", "wavelengths": "nm", "brdf": "1/sr", "rates": "counts/s", "times": "s"},
        "uncertainties": "standard, k = 1",
    }


def _plain(value: Any) -> Any:
    """Dataclasses as dictionaries and arrays as lists, with as many digits as counts have."""
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value


def proposals(found: Result, settings: InstrumentSettings) -> Proposals:
    """What the instrument file should say after a measurement."""
    match found:
        case Alignment():
            stages = settings.stages
            return {
                "stages.sample": {"zero": _zero(stages.sample, found.sample_zero)},
                "stages.detector": {"zero": _zero(stages.detector, found.detector_zero)},
                "geometry": {"u_zero": _two_digits(max(found.u_sample_zero, found.u_detector_zero))},
            }
        case Repeatability():
            # none beyond the noise is no proof of none
            return {"geometry": {"u_angle": _two_digits(found.u_angle)}} if found.u_angle > 0 else {}
        case WavelengthScale():
            scale = {"wavelength_offset": round(found.offset, 4), "u_wavelength": _two_digits(found.u_wavelength)}
            return {"spectrometer": scale}
        case Noise():
            # what is not measured is not subtracted, and then the whole of it is the error
            return {"light": {"u_stray_light": _two_digits(float(np.hypot(found.stray_level, found.u_stray_level)))}}
        case Signature():
            return {}


def _zero(stage: Family, error: float) -> float:
    """The reading at which the bench truly stands at 0, where the true angle is larger than the read one by `error`."""
    return round(stage.mounting.reading(-error), 4)


def _two_digits(value: float) -> float:
    return float(f"{value:.2g}")


def instrument_lines(proposed: Proposals) -> list[str]:
    """Lines of the instrument file, ready to be pasted."""
    lines = []
    for table, values in proposed.items():
        lines += [f"[{table}]", *(f"{key} = {np.format_float_positional(v, trim='0')}" for key, v in values.items())]
    return lines


def check_figure(path: Path) -> None:
    """Raise `InputError` where no figure can be drawn to `path`."""
    if path.suffix != ".svg":
        raise InputError(f'The figure cannot be drawn to "{path}"; end its name in .svg.')


def write_figure(found: Result, path: Path) -> Export:
    """Draw a result into an SVG file; raises `StoreFull` where the disk refuses."""
    return write_text("svg", path, side_by_side(panels(found)))


def panels(found: Result) -> list[str]:
    """The figure of a result as SVG panels."""
    match found:
        case Signature():
            return signature_panels(found)
        case Noise():
            return noise_panels(found)
        case Alignment():
            return alignment_panels(found)
        case Repeatability():
            return repeatability_panels(found)
        case WavelengthScale():
            return wavelength_panels(found)


def lines(found: Result, stated: BenchData) -> list[str]:
    """A result in words; `stated` is what the instrument file says now."""
    match found:
        case Signature():
            told = _signature_lines(found)
        case Noise():
            told = _noise_lines(found)
        case Alignment():
            told = _alignment_lines(found)
        case Repeatability():
            told = _repeatability_lines(found, stated)
        case WavelengthScale():
            told = _wavelength_lines(found)
    return [*told, STATED]


def _signature_lines(found: Signature) -> list[str]:
    shortest, longest = found.wavelengths[0], found.wavelengths[-1]
    return [
        f"Mirror at θ in = {found.theta_in:.2f}°, mean over {shortest:.0f} to {longest:.0f} nm:",
        f"  full width at half maximum  {with_uncertainty(found.width, found.u_width)}°",
        f"  middle of the peak          {with_uncertainty(found.centre, found.u_centre)}° from the mirror direction",
        f"  floor beyond {FAR:.0f}°            {with_uncertainty(found.floor_level, found.u_floor_level)} of the peak",
    ]


def _noise_lines(found: Noise) -> list[str]:
    rows = [f"{'wavelength':>12} {'noise-equivalent':>18} {'predicted':>12} {'stray-light-equivalent':>24}"]
    rows.append(f"{'nm':>12} {'BRDF / (1/sr)':>18} {'1/sr':>12} {'BRDF / (1/sr)':>24}")
    for wavelength in (400, 450, 500, 550, 600, 700, 800, 900, 980):
        i = int(np.argmin(np.abs(found.wavelengths - wavelength)))
        stray = with_uncertainty(float(found.stray[i]), float(found.u_stray[i]))
        rows.append(f"{found.wavelengths[i]:12.1f} {found.brdf[i]:18.2g} {found.predicted[i]:12.2g} {stray:>24}")
    return [
        f"One exposure of {found.integration_time:g} s at normal incidence, from {found.scans} of them; at another "
        f"angle divide by cos(θ in).",
        *rows,
        f"Noise over its prediction: {with_uncertainty(found.ratio, found.u_ratio)}; a noise in the table is known "
        f"within {100 * found.u_relative:.0f} % (k = 1).",
        f"Stray light, mean: {with_uncertainty(found.stray_level, found.u_stray_level)} 1/sr.",
    ]


def _alignment_lines(found: Alignment) -> list[str]:
    verdict = (
        "the sweeps agree as well as the stages repeat"
        if found.consistent
        else "the sweeps disagree more than u_angle allows; measure the repeatability, and look for a loose mirror"
    )
    return [
        "True minus read angle:",
        f"  sample stage    {with_uncertainty(found.sample_zero, found.u_sample_zero)}°",
        f"  detector stage  {with_uncertainty(found.detector_zero, found.u_detector_zero)}°",
        f"Chi-square {found.chi_square:.1f} with {found.degrees_of_freedom} degrees of freedom: {verdict}.",
    ]


def _repeatability_lines(found: Repeatability, stated: BenchData) -> list[str]:
    return [
        *(line for stage in (found.sample, found.detector) for line in _stage_lines(stage)),
        f"The instrument file states u_angle = {stated.u_angle:g}°.",
        f"Signal of a band on the flank, as the detector returns: {100 * float(np.median(found.band_scatter)):.2g} % "
        f"(k = 1, median).",
    ]


def _stage_lines(found: StageRepeatability) -> list[str]:
    return [
        f"{found.stage.capitalize()} stage, {len(found.signal)} returns:",
        f"  scatter of the true angle  {with_uncertainty(found.scatter, found.u_scatter)}°",
        f"  from above minus below     {with_uncertainty(found.backlash, found.u_backlash)}°",
        f"  read minus wanted angle    {found.read_back:.4f}° (root mean square)",
    ]


def _wavelength_lines(found: WavelengthScale) -> list[str]:
    told = [
        f"{line.element} {line.known:9.4f} nm: found at {with_uncertainty(line.found, line.u)} nm, "
        f"{line.width:.2f} nm wide at half maximum"
        for line in found.lines
    ]
    told.append(
        f"To be added to the wavelengths: {with_uncertainty(found.offset, found.u_offset)} nm; the lines scatter by "
        f"{found.scatter:.2g} nm around it."
    )
    if abs(found.slope) > 3 * found.u_slope:
        told.append(
            f"It changes by {with_uncertainty(1000 * found.slope, 1000 * found.u_slope)} nm over 1000 nm, which no "
            f"offset mends; have the spectrometer's coefficients determined anew."
        )
    return told
