"""What is told of a topography: where it comes from, its roughness, and how far that depends on its sampling."""

from dataclasses import asdict, dataclass

import numpy as np

from simulators.materials.materials import SAMPLES
from simulators.topographies.heights import FALLEN_TO, every_second, quarters, roughness
from simulators.topographies.topography import MEASURED_AREA_RATIOS, Topography

CONVERGED = 0.01
"""Relative change at twice the pitch up to which a parameter counts as independent of it."""

MEANINGS = {
    "sq_um": ("Sq", "µm", "root mean square height about the mean"),
    "sdq": ("Sdq", "", "root mean square slope of the facets, on which the width of the reflected lobe depends"),
    "sdr": ("Sdr", "", "area of the facets over that of the plane below them, less one"),
    "sal_um": ("Sal", "µm", f"shortest way on which the autocorrelation falls to {FALLEN_TO:g}"),
}
"""Symbol after ISO 25178-2, unit and meaning of each field of `Roughness`."""


@dataclass(frozen=True)
class Parameter:
    """One roughness parameter of a surface, and how far it can be relied on."""

    symbol: str
    unit: str
    meaning: str
    value: float
    paper: float | None
    """What the paper's topography of this sample has."""
    at_twice_the_pitch: float
    """Relative change if every second point along x and y is left out."""
    relative_error: float
    """Relative standard error that a patch of this size leaves, from the spread of its quarters."""


@dataclass(frozen=True)
class Described:
    """A surface and what is told of it."""

    surface: Topography
    parameters: dict[str, Parameter]
    """By the fields of `Roughness`, in their order."""


def described(surface: Topography) -> Described:
    """Roughness of a surface with its dependence on pitch and size."""
    field = surface.field
    here, coarser = asdict(roughness(field)), asdict(roughness(every_second(field)))
    parts = [asdict(roughness(part)) for part in quarters(field)]
    sample, ratio = SAMPLES.get(surface.name), MEASURED_AREA_RATIOS.get(surface.name)
    paper = {
        "sq_um": None if sample is None else sample.roughness_rms_um,
        "sdr": None if ratio is None else ratio - 1,
    }
    found = {
        key: Parameter(
            *meaning,
            here[key],
            paper.get(key),
            coarser[key] / here[key] - 1 if here[key] else 0.0,
            # the whole patch is the mean of four
            float(np.std([part[key] for part in parts], ddof=1)) / 2 / here[key] if here[key] else 0.0,
        )
        for key, meaning in MEANINGS.items()
    }
    return Described(surface, found)


def how_made(surface: Topography) -> list[str]:
    """Sentences on where a surface comes from."""
    rows, columns = surface.field.heights_um.shape
    pitch, origin = surface.field.pitch_um, surface.origin
    tiled = ", without a seam where it is repeated." if surface.field.periodic else "."
    text = [f"{columns} x {rows} points {pitch:.4g} µm apart, {columns * pitch:.4g} x {rows * pitch:.4g} µm{tiled}"]
    if isinstance(steps := origin.get("steps"), list):
        text.append(f"Read from {origin['file']}: {'; '.join(steps)}.")
    else:
        to = " to the rms roughness of the paper's Table 1" if surface.name in SAMPLES else ""
        text.append(f"Synthesised{to} with seed {origin['seed']}, not measured.")
    if isinstance(made_as := origin.get("made_as"), str):
        text.append(f"Made as {made_as}.")
    if isinstance(deepest := origin.get("deepest_dent_um"), float) and isinstance(bare := origin["bare_share"], float):
        text.append(
            f"{origin['dents']} dents up to {deepest:.3g} µm deep; {100 * bare:.2g} % of the polished surface are left."
        )
    if origin["micro_roughness"]:
        text.append("Roughness below the wavelength was put on it.")
    return text


def remark(found: Described) -> str:
    """Whether the sampling is fine enough for what is told."""
    coarse = [
        f"{row.symbol} {100 * row.at_twice_the_pitch:+.1f} %".replace("-", "−")
        for row in found.parameters.values()
        if abs(row.at_twice_the_pitch) > CONVERGED
    ]
    if not coarse:
        return f"At twice the pitch no parameter is more than {100 * CONVERGED:g} % different."
    cure = "no finer grid was measured" if "file" in found.surface.origin else "a smaller --pitch shows how far it goes"
    return f"Depends on the pitch: at twice the pitch {', '.join(coarse)}; {cure}."


def shown(value: float, unit: str) -> str:
    """A value with four digits and its unit."""
    return f"{value:.4g} {unit}".strip()
