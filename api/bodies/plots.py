"""What is drawn of a dataset: maps, distributions, slopes and spectra."""

from typing import Literal

from pydantic import Field

from api.bodies.base import Body, Number

SHOWN_AT = 600.0
"""Wavelength, nm, at which hue and fillings are judged."""


class Edges(Body):
    """A rectangle of the map, degrees."""

    left: float = Field(description="Smallest theta_out.")
    right: float = Field(description="Largest theta_out.")
    bottom: float = Field(description="Smallest theta_in.")
    top: float = Field(description="Largest theta_in.")


class MapCell(Body):
    """A measured direction."""

    point: int = Field(description="Number of the point in the dataset, from 0.")
    theta_in_deg: float
    theta_out_deg: float
    edges: Edges = Field(description="What the cell covers: halfway to its neighbours.")
    colour: str | None = Field(description="sRGB as #rrggbb under D65, exposed as `exposure` says; null: no colour.")
    hue: str | None = Field(description="The same at one luminance for all; null where the hue is noise.")
    luminance: Number = Field(description="Y under D65 of cos(theta_in) f; 1 is f cos(theta_in) = 1.")
    flags: list[str]
    flag_words: str = Field(description="What the flags mean; empty without any.")
    # the field's own spelling
    dE00: Number = Field(description="CIEDE2000 between measurement and `difference_model`.")  # noqa: N815


class FilledCell(Body):
    """A direction that was not measured, and what can be said of it."""

    theta_in_deg: float
    theta_out_deg: float
    edges: Edges
    by: Literal["reciprocity", "interpolation"]
    colour: str | None
    hue: str | None
    brdf: Number = Field(description=f"At {SHOWN_AT:g} nm, 1/sr.")
    u: Number = Field(description="Standard uncertainty (k = 1), 1/sr.")
    points: list[int] = Field(description="Measured points that it comes from.")


class InPlaneMap(Body):
    """All cells of a dataset; theta_out goes to the right, theta_in up."""

    dataset: int
    sample: str
    exposure: Number = Field(description="Linear RGB of f cos(theta_in) was multiplied by it; null: no colours.")
    clipped: int = Field(description="Cells brighter than the display.")
    difference_model: str | None = Field(description="The fit that `dE00` is of; null where there is none.")
    cells: list[MapCell]
    filled: list[FilledCell] = Field(description="Known well enough to say anything; never a measurement.")
    not_filled: int = Field(description="Directions known to no better than 30 %, which are absent.")
    blocked: list[Edges] = Field(description="Where the detector stands in the way of the source.")
    blocked_half_width_deg: float


class FilledCurve(Body):
    """Directions that were not measured and can be told; never a measurement."""

    theta_out_deg: list[float]
    brdf: list[Number]
    u: list[Number]


class Distribution(Body):
    """One incident angle; the lists run over its points by theta_out."""

    theta_in_deg: float
    points: list[int] = Field(description="Numbers of the points in the dataset.")
    theta_out_deg: list[float]
    brdf: list[Number] = Field(description="1/sr.")
    u: list[Number] = Field(description="Combined standard uncertainty (k = 1), 1/sr.")
    log10_brdf: list[Number] = Field(description="Null where the value is not positive.")
    filled: FilledCurve | None


class Distributions(Body):
    """All incident angles of a dataset."""

    dataset: int
    wavelength_nm: float | None = Field(description="Null: as bright as the eye sees it under D65.")
    coverage_factor: int = Field(description="By which bands are drawn; `u` itself has coverage factor 1.")
    curves: list[Distribution]


class LocalPoint(Body):
    """Eq. 2 of the paper fitted to one spectrum; every u_ is a standard uncertainty (k = 1)."""

    point: int = Field(description="Number of the point in the dataset, from 0.")
    theta_in_deg: float
    theta_out_deg: float
    slope_per_um: Number = Field(description="m, 1/um.")
    u_slope_per_um: Number
    exponent: Number = Field(description="p, a pure number.")
    u_exponent: Number
    scale_per_sr: Number = Field(description="a, the BRDF at lambda_n, 1/sr.")
    r2: Number
    reliable: bool = Field(description="False where the point is flagged, drowned in noise or oddly fitted.")


class SlopeCurve(Body):
    """The slope of a model at one incident angle."""

    theta_in_deg: float
    slope_per_um: list[Number] = Field(description="At `theta_out_deg` of the whole answer, 1/um.")


class SlopeModel(Body):
    """The slopes of a model."""

    model: str
    fit: int = Field(description="Id of the fit.")
    trusted: bool
    curves: list[SlopeCurve]


class Slopes(Body):
    """All slopes of a dataset; points and models are empty where it was not analysed."""

    dataset: int
    lambda_n_nm: float = Field(description="Wavelength at which the shift is one, nm.")
    doubts: list[str] = Field(description="What speaks against all spectra together.")
    points: list[LocalPoint]
    theta_out_deg: list[float] = Field(description="Where the curves are told, degrees.")
    models: list[SlopeModel]


class LocalCurve(Body):
    """Eq. 2 of the paper, fitted to this spectrum alone."""

    parameters: LocalPoint
    fitted: list[Number] = Field(description="[wavelengths] 1/sr.")


class PointSpectrum(Body):
    """A point of a dataset."""

    dataset: int
    point: int
    theta_in_deg: float
    theta_out_deg: float
    wavelengths_nm: list[float]
    brdf: list[Number] = Field(description="[wavelengths] 1/sr; null where there is no value.")
    u: list[Number] = Field(description="[wavelengths] combined standard uncertainty (k = 1), 1/sr.")
    u_counts: list[Number] = Field(description="[wavelengths] the part of `u` that wavelengths do not share, 1/sr.")
    local: LocalCurve | None = Field(description="Null where the dataset was not analysed.")
    model: str | None = Field(description="The fit that `modelled` and `dE00` are of.")
    modelled: list[Number] | None = Field(description="[wavelengths] the model as the instrument would read it, 1/sr.")
    # the field's own spelling
    dE00: Number = Field(description="CIEDE2000 between measurement and `model`.")  # noqa: N815
    dE00_chromatic: Number = Field(  # noqa: N815
        description="The same of both spectra at one level; null where the hue is noise."
    )
    flags: list[str]
    flag_words: str
    point_id: int | None = Field(description="The measured point; null of no scan of this database.")
    exposures: list[int] = Field(description="Raw exposures that it comes from.")
