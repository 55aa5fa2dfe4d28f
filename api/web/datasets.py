"""Datasets: lists of them, and everything that a person is shown of one."""

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query, Request, Response

from api.bodies.base import Page
from api.bodies.datasets import Checks, DatasetDetail, DatasetRow, Lineage, UncertaintyBudget
from api.bodies.fits import Ladder
from api.bodies.plots import SHOWN_AT, Distributions, InPlaneMap, PointSpectrum, Slopes
from api.views import curves, in_plane_map, ladder, lineage, listing, quality, slopes, spectra
from api.web.access import Viewer
from api.web.context import Here, Number
from api.web.instrument import BINARY
from api.web.paging import DEFAULT_LIMIT, After, Limit, after_number, page
from api.web.shown import shown
from goniometer.datasets.dataset import Kind
from goniometer.errors import InputError
from goniometer.storage.catalogue import Order, Wanted

router = APIRouter(prefix="/api/datasets", tags=["datasets"])

Time = Annotated[str | None, Query(pattern=r"^\d{4}-\d\d-\d\d([T ][\d:.+-]{1,24}Z?)?$", examples=["2026-01-31"])]
Degrees = Annotated[float | None, Query(ge=-90, le=90, description="Degrees.")]
Nanometres = Annotated[float | None, Query(gt=0, lt=1e5, description="nm")]
OCTETS: dict[int | str, dict[str, Any]] = {
    200: {"content": {BINARY: {"schema": {"type": "string", "format": "binary"}}}}
}


@router.get("")
def datasets(
    live: Here,
    caller: Viewer,
    sample: Annotated[str | None, Query(max_length=200, description="Only of this sample.")] = None,
    campaign: Annotated[int | None, Query(ge=1, lt=2**63, description="Only of this campaign.")] = None,
    kind: Kind | None = None,
    flag: Annotated[str | None, Query(max_length=40, description="Only those with a point of this flag.")] = None,
    since: Time = None,
    until: Time = None,
    operator: Annotated[str | None, Query(max_length=64, description="Only of campaigns that they queued.")] = None,
    passed: Annotated[
        bool | None, Query(description="Only those whose checks all passed, or (false) of which any failed.")
    ] = None,
    order: Order = "newest",
    limit: Limit = DEFAULT_LIMIT,
    after: After = None,
) -> Page[DatasetRow]:
    """All datasets, or those that are asked for."""
    if flag is not None and flag not in listing.FLAG_NAMES:
        raise InputError(f'flag: there is no flag "{flag}"; there are {", ".join(listing.FLAG_NAMES)}.')
    of_flag = None if flag is None else listing.FLAG_NAMES[flag]
    wanted = Wanted(sample, campaign, kind, of_flag, since, until, operator, passed)
    rows = live.store.entries(wanted, limit + 1, None if after is None else after_number(after), order)
    return page(rows, limit, listing.row, lambda entry: entry.id)


@router.get("/{number}", response_model=DatasetDetail)
def dataset(number: Number, request: Request, live: Here, caller: Viewer) -> Response:
    """A dataset as it opens."""
    return shown(request, live, number, listing.detail)


@router.get("/{number}/map", response_model=InPlaneMap)
def colour_map(
    number: Number,
    request: Request,
    live: Here,
    caller: Viewer,
    filled: Annotated[bool, Query(description="Tell what was not measured, too; takes longer the first time.")] = True,
) -> Response:
    """The in-plane map: every measured direction as a cell in its own colour."""
    return shown(
        request,
        live,
        number,
        lambda opened: in_plane_map.in_plane_map(opened, live.datasets.filled(opened) if filled else None),
        filled,
    )


@router.get("/{number}/points/{point}", response_model=PointSpectrum)
def point(
    number: Number,
    point: Annotated[int, Path(ge=0, lt=2**31, description="Number of the point in the dataset, from 0.")],
    request: Request,
    live: Here,
    caller: Viewer,
) -> Response:
    """The spectrum of a point with its uncertainty, its fits and its flags."""
    return shown(request, live, number, lambda opened: spectra.point_spectrum(live.store, opened, point), point)


@router.get("/{number}/slopes", response_model=Slopes)
def slopes_of(number: Number, request: Request, live: Here, caller: Viewer) -> Response:
    """How the colour changes with direction: slopes of the spectra and of the models."""
    return shown(request, live, number, slopes.slopes)


@router.get("/{number}/distributions", response_model=Distributions)
def distributions(
    number: Number,
    request: Request,
    live: Here,
    caller: Viewer,
    quantity: Annotated[
        Literal["wavelength", "luminance"], Query(description="The BRDF at a wavelength, or as the eye weighs it.")
    ] = "wavelength",
    wavelength: Annotated[float, Query(gt=0, lt=1e5, description="nm")] = SHOWN_AT,
    filled: Annotated[bool, Query(description="Tell what was not measured, too.")] = True,
) -> Response:
    """The BRDF over the reflected angle, one curve an incident angle."""
    at = wavelength if quantity == "wavelength" else None
    return shown(
        request,
        live,
        number,
        lambda opened: curves.distributions(opened, at, live.datasets.filled(opened) if filled else None),
        at,
        filled,
    )


@router.get("/{number}/models", response_model=Ladder)
def models(number: Number, request: Request, live: Here, caller: Viewer) -> Response:
    """The newest fit of every model, simplest first, with what it costs, its error and its verdict."""
    return shown(request, live, number, ladder.ladder)


@router.get("/{number}/checks", response_model=Checks)
def checks(number: Number, request: Request, live: Here, caller: Viewer) -> Response:
    """Sanity checks and flags."""
    return shown(request, live, number, lambda opened: quality.checks(live.store, opened))


@router.get("/{number}/budget", response_model=UncertaintyBudget)
def budget(
    number: Number,
    request: Request,
    live: Here,
    caller: Viewer,
    theta_in: Degrees = None,
    theta_out: Degrees = None,
    wavelength: Nanometres = None,
) -> Response:
    """The uncertainty budget of the value nearest to a direction; without one, of the mirror direction near 45 deg."""
    at = theta_in, theta_out, wavelength
    return shown(request, live, number, lambda opened: quality.uncertainty_budget(opened, *at), *at)


@router.get("/{number}/lineage")
def lineage_of(number: Number, live: Here, caller: Viewer) -> Lineage:
    """Where it comes from, and what was made of it."""
    return lineage.lineage(live.store, live.datasets.open(number))


@router.get("/{number}/spectra", response_class=Response, responses=OCTETS)
def all_spectra(number: Number, request: Request, live: Here, caller: Viewer) -> Response:
    """All spectra as little-endian numbers: two uint32, points P and wavelengths W; then float64.

    W wavelengths (nm), P theta_in, P theta_out (degrees), P x W BRDF, P x W combined standard uncertainty (k = 1),
    both in 1/sr; NaN where there is no value.
    """
    return shown(request, live, number, lambda opened: spectra.packed_spectra(opened.dataset), media_type=BINARY)
