"""What many gratings of different spacing do to a spectrum (paper, section 5.2), and how it is told."""

from dataclasses import dataclass
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from analysis.figures.gratings import binned_spectra_figure, orders_over_spacing, slopes_over_angle
from analysis.figures.page import figure
from drivers.arrays import FloatArray
from simulators.choices import Spread
from simulators.computed import Computed
from simulators.waves.gratings import (
    Lines,
    binned_spectra,
    grating_brdf,
    order_angles,
    ring,
    spread_periods,
    straight_lines,
)

WAVELENGTHS = np.arange(400.0, 801.0, 10.0)
LAMBDA_N = float(WAVELENGTHS.mean())
EDGES = np.arange(0.0, 11.0)
"""Of the bins of diffraction angle, degrees."""

CONVERGED = 0.01
"""Change of a slope, over that of a spectrum proportional to the wavelength, up to which gratings are enough."""

_FEWEST, _MOST = 1000, 512_000
_OF_THE_DATASET = 2**22
"""Gratings for the BRDF, where few lie in a bin far from the mirror direction."""

_DRAWN = (400.0, 500.0, 600.0, 700.0, 800.0)
_INCIDENT, _REFLECTED, _APERTURE = np.arange(10.0, 81.0, 10.0), np.arange(-85.0, 86.0), 1.0
"""Directions and aperture of the dataset, degrees; the BRDF depends on the distance from the mirror direction alone."""


@dataclass(frozen=True)
class Binned:
    """Spectra of bins of diffraction angle under one way to spread the spacings."""

    gratings: int
    spectra: FloatArray
    """[bins, wavelengths] share of the gratings."""
    lines: Lines
    steps: list[tuple[int, float]]
    """Number of gratings, and how much the slopes change when half of them are left out, as `CONVERGED` counts it."""


def binned(incident: float, spread: Spread, smallest_um: float, largest_um: float) -> Binned:
    """With so many gratings that the slopes change by less than `CONVERGED` when they are halved, and halved again."""
    steps: list[tuple[int, float]] = []
    count, before = _FEWEST, None
    while True:
        periods = spread_periods(spread, smallest_um, largest_um, count)
        # with m = 1 the first order goes from the mirror direction towards the normal and beyond
        spectra = binned_spectra(incident, 1, periods, WAVELENGTHS, incident - EDGES[::-1])[::-1]
        lines = straight_lines(spectra, WAVELENGTHS)
        if before is not None:
            change = np.abs(np.nan_to_num(lines.slope) - np.nan_to_num(before))
            steps.append((count, float(change.max() * 1e-3 * LAMBDA_N)))
            # twice running, because a bin of few gratings may be right by chance
            if count >= _MOST or (len(steps) > 1 and max(change for _, change in steps[-2:]) < CONVERGED):
                return Binned(count, spectra, lines, steps)
        count, before = 2 * count, lines.slope


def computed(spread: Spread, smallest_um: float, largest_um: float) -> Computed:
    """The in-plane BRDF of such gratings.

    Its errors are what leaving out half of the gratings changes, in each wavelength, and what half the aperture
    changes, in all of them: the ring that is averaged over is no round aperture.
    """
    theta_in, theta_out = (grid.ravel() for grid in np.meshgrid(_INCIDENT, _REFLECTED, indexing="ij"))
    periods = spread_periods(spread, smallest_um, largest_um, _OF_THE_DATASET)
    inner, outer = ring(theta_in, theta_out, _APERTURE)
    brdf = grating_brdf(inner, outer, periods, WAVELENGTHS)
    fewer = grating_brdf(inner, outer, periods[::2], WAVELENGTHS)
    narrower = grating_brdf(*ring(theta_in, theta_out, _APERTURE / 2), periods, WAVELENGTHS)
    one = 1 / (_OF_THE_DATASET * np.pi * (outer**2 - inner**2))
    return Computed(
        sample="gratings",
        theta_in=theta_in,
        theta_out=theta_out,
        wavelengths=WAVELENGTHS,
        brdf=brdf,
        u_level=np.abs(brdf - narrower),
        u_spectral=np.maximum(np.abs(brdf - fewer), one[:, None]),
        aperture=_APERTURE,
        lineage={
            "simulated": f"gratings of {smallest_um:g} to {largest_um:g} µm",
            "spacings_um": [smallest_um, largest_um],
            "even_in": spread.value,
            "gratings": _OF_THE_DATASET,
            "scale": "all light of a grating goes into its two first orders, and all azimuths are equally frequent",
        },
    )


def _as_the_paper(lines: Lines) -> bool:
    """Whether the first two bins fall with the wavelength and all others rise."""
    return bool((lines.slope[:2] < 0).all() and (lines.slope[2:] > 0).all())


def told(found: dict[Spread, Binned], incident: float, smallest_um: float, largest_um: float) -> list[str]:
    """What was computed, and what to make of it."""
    agree = [spread for spread, binned in found.items() if _as_the_paper(binned.lines)]
    straight = [
        f"So do spacings even in {_QUANTITY[spread]}; a line explains {100 * r2[0]:.0f} and {100 * r2[1]:.0f} % of the "
        f"variance in these two bins and at least {100 * r2[2:].min():.2f} % in the others."
        for spread, r2 in ((spread, found[spread].lines.r2) for spread in agree)
    ]
    text = [
        f"Gratings of {smallest_um:g} to {largest_um:g} µm at an incident angle of {incident:g}°, first order; slopes "
        f"in 1/µm at {LAMBDA_N:g} nm, from {WAVELENGTHS[0]:g} to {WAVELENGTHS[-1]:g} nm.",
        "The paper finds linear spectra that fall in the first two bins and rise in all others, and does not state its "
        "spacings d. " + (" ".join(straight) or "None of the spreads here does so."),
        f"Where no end of the spacings is in view, spacings even in d give spectra proportional to the wavelength "
        f"({1e3 / LAMBDA_N:.3f}/µm), in log d constant ones, in 1/d inversely proportional ones: it is the spread that "
        "decides, not diffraction alone.",
        "All gratings count alike here, at all wavelengths, as amplitude gratings do; shallow phase gratings send "
        "light into their first orders as the inverse square of the wavelength, and then those even in d are blue.",
    ]
    for spread, binned in found.items():
        count, change = binned.gratings, max(change for _, change in binned.steps[-2:])
        verdict = "enough" if change < CONVERGED else "not enough"
        text.append(
            f"Even in {_QUANTITY[spread]}: {count} gratings are {verdict}; with a half and a quarter of them slopes "
            f"change by at most {100 * change:.2g} % of {1e3 / LAMBDA_N:.3f}/µm."
        )
    return text


_QUANTITY = {Spread.SPACING: "d", Spread.LOGARITHM: "log d", Spread.FREQUENCY: "1/d"}
_HEADS = ("angle", "paper", *(head for name in _QUANTITY.values() for head in (name, "r²")))
_TITLE = "Slopes, 1/µm, of spacings that are even in d, log d and 1/d, and r² of the lines"


def _rows(found: dict[Spread, Binned]) -> list[list[str]]:
    """Slope and r2 of each bin; a spectrum that is constant within the convergence has no r2."""
    rows = []
    for i, (low, high) in enumerate(pairwise(EDGES)):
        row = [f"{low:g}° to {high:g}°", "falls" if i < 2 else "rises"]
        for binned in found.values():
            slope, r2 = binned.lines.slope[i], binned.lines.r2[i]
            constant = abs(slope) * 1e-3 * LAMBDA_N < CONVERGED
            row += ["no light", ""] if np.isnan(slope) else [f"{slope:+.3f}", "constant" if constant else f"{r2:.4f}"]
        rows.append([cell.replace("-", "−") for cell in row])
    return rows


def table(found: dict[Spread, Binned]) -> Table:
    table = Table(title=_TITLE, title_justify="left", box=None, pad_edge=False)
    for heading in _HEADS:
        table.add_column(heading, justify="right", no_wrap=True)
    for row in _rows(found):
        table.add_row(*row)
    return table


def body(
    found: dict[Spread, Binned], incident: float, smallest_um: float, largest_um: float, even_in: Spread
) -> list[str]:
    """Pieces of HTML with Fig. 7 of the paper and what it depends on."""
    periods = np.geomspace(smallest_um, largest_um, 400)
    drawn = np.array(_DRAWN)
    angles = incident - order_angles(incident, np.array(1.0), periods, drawn[:, None])
    head = "".join(f'<th class="number">{escape(text)}</th>' for text in _HEADS)
    rows = "".join(
        "<tr>" + "".join(f'<td class="number">{escape(cell)}</td>' for cell in row) + "</tr>" for row in _rows(found)
    )
    caption = f"<caption>{_TITLE}; in bins of diffraction angle.</caption>"
    return [
        "".join(f"<p>{escape(line)}</p>" for line in told(found, incident, smallest_um, largest_um)),
        figure(
            [
                orders_over_spacing(periods, angles, drawn, 45.0, "orders"),
                binned_spectra_figure(WAVELENGTHS, found[even_in].spectra, EDGES, "binned"),
            ],
            "Left: where the first order goes, as an angle from the mirror direction (paper, Eq. 1 and Fig. 7a). "
            f"Right: spectra of gratings whose spacings are even in {_QUANTITY[even_in]}, binned over 1° of "
            "diffraction angle, each over its maximum (Fig. 7b); lines may lie upon each other.",
        ),
        figure(
            [
                slopes_over_angle(
                    EDGES, {f"even in {_QUANTITY[s]}": b.lines.slope for s, b in found.items()}, LAMBDA_N, "tilt"
                )
            ],
            "Slopes of straight lines through the binned spectra. Small angles see the end of the largest spacings: "
            "long waves are missing there, whatever the spread.",
            "alone",
        ),
        f'<div class="wide"><table>{caption}<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>',
    ]


def content(
    found: dict[Spread, Binned],
    incident: float,
    smallest_um: float,
    largest_um: float,
    even_in: Spread,
    dataset: int | None,
    written: Path | None,
) -> dict[str, Any]:
    """For JSON."""
    return {
        "theta_in": incident,
        "spacings_um": [smallest_um, largest_um],
        "wavelengths": WAVELENGTHS.tolist(),
        "edges": EDGES.tolist(),
        "even_in": even_in.value,
        "spreads": {
            spread.value: {
                "gratings": binned.gratings,
                "spectra": binned.spectra.tolist(),
                "slope_per_um": _numbers(binned.lines.slope),
                "r2": _numbers(binned.lines.r2),
                "as_the_paper": _as_the_paper(binned.lines),
                "convergence": [{"gratings": n, "change": change} for n, change in binned.steps],
            }
            for spread, binned in found.items()
        },
        "dataset": dataset,
        "page": None if written is None else str(written),
    }


def _numbers(values: FloatArray) -> list[float | None]:
    return [None if np.isnan(value) else float(value) for value in values]
