"""Writes a fitted Cook-Torrance model with its shift as a `.bsdf` file for Mitsuba 3.

The plugin `measured` of an unmodified renderer computes f cos(theta_o) = spectra(s) ndf(u) / (4 sigma), see
`analysis.measured_bsdf`. With ndf = D and sigma = cos(theta_i) / G1(i) the model leaves
G1(o) F shift for the table: bounded and smooth, so the steep lobe never has to be interpolated coarsely.
Two layouts are tried for every file, and the one with the smaller measured error is kept:

- "flat": `vndf` is one everywhere, the nodes of the table are even in sqrt(theta_m) and phi_m;
- "vndf": half of the nodes follow the normals that are visible from theta_i, the other half stay even.

Conventions: u_x = sqrt(2 theta_m / pi), phi_m - phi_i = (2 u_y - 1) pi.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from analysis.bsdf_fields import LOWEST_COS, bsdf_fields, unit
from analysis.colour import delta_e_2000, xyz_weights
from analysis.directions import Directions
from analysis.distributions import g1
from analysis.errors import ExportError
from analysis.fresnel import Conductor, fresnel_conductor
from analysis.measured_bsdf import evaluate, read_bsdf
from analysis.models import cook_torrance, cosine_slope, shift
from analysis.results import ModelFit
from analysis.tensor_file import encode
from drivers.arrays import FloatArray
from goniometer.dataset import Dataset

SPECTRAL_RANGE = (360.0, 830.0)
"""Wavelengths, nm, that a spectral renderer asks for (the CIE observer's)."""

COLOUR_BUDGET = 0.05
"""Largest CIEDE2000 difference that interpolating between the wavelength nodes may cause."""

LAYOUTS = {"flat": 0.0, "vndf": 0.5}
"""Share of the table's nodes that follows the visible normals, by layout."""

LARGEST_TESTED_ANGLE = 80.0
"""Degrees; directions beyond are in the file but not in its stated error."""

_TEST_PAIRS = 4000
_TEST_SEED = 20220701


@dataclass(frozen=True)
class RelativeError:
    """Relative error of a file against its model, the worst of all tested wavelengths for each direction pair.

    Half of the pairs are uniform in solid angle up to `LARGEST_TESTED_ANGLE`, half follow the model's own lobe.
    """

    median: float
    p99: float
    maximum: float


@dataclass(frozen=True)
class BsdfReport:
    """What was written, and how well it stands for the model."""

    path: Path
    size: int
    """Bytes."""
    layout: str
    """Key of `LAYOUTS`."""
    wavelengths: FloatArray
    """[nodes] nm."""
    colour_error: float
    """Largest CIEDE2000 difference caused by the wavelength nodes."""
    error: RelativeError
    """Of the layout that was written."""
    errors: dict[str, RelativeError]
    """Of every layout that was tried."""
    description: str
    """The text inside the file."""


@dataclass(frozen=True)
class _Model:
    """Parameters of Eq. 7, as `analysis.models.cook_torrance` takes them."""

    alpha: float
    conductor: Conductor
    h: float
    w: float


def write_bsdf(
    path: Path, alpha: float, conductor: Conductor, h: float = 0.0, w: float = 0.0, *, about: str = ""
) -> BsdfReport:
    """Write Cook-Torrance (`h` = 0) or Cook-Torrance x shift (Eq. 7) to `path`; `h` in 1/um.

    `about` opens the description inside the file. Raises `OutOfRange` where the conductor's table does not
    cover 360 to 830 nm, and `ExportError` where the file cannot be written.
    """
    model = _Model(alpha, conductor, h, w)
    wavelengths, colour_error = _wavelength_nodes(model)
    contents = {
        layout: bsdf_fields(partial(_at_normals, model, wavelengths), alpha, wavelengths, share)
        for layout, share in LAYOUTS.items()
    }
    errors = {layout: _measured_error(encode(fields), model) for layout, fields in contents.items()}
    layout = min(errors, key=lambda name: errors[name].p99)
    description = _description(about, model, layout, errors[layout], wavelengths, colour_error)
    content = encode(contents[layout] | {"description": np.frombuffer(description.encode(), np.uint8)})
    try:
        path.write_bytes(content)
    except OSError as fault:
        raise ExportError(f"The file {path} cannot be written: {fault.strerror}.") from fault
    return BsdfReport(path, len(content), layout, wavelengths, colour_error, errors[layout], errors, description)


def write_fit(path: Path, fit: ModelFit, dataset: Dataset, conductor: Conductor) -> BsdfReport:
    """Write a fit of "cook-torrance" or "cook-torrance-shift" to `path`, described by what it was fitted to.

    Raises as `write_bsdf`, and `ExportError` for another model or distribution than GGX: the file would not be of it.
    """
    if fit.model not in {"cook-torrance", "cook-torrance-shift"} or fit.distribution != "ggx":
        normals = f" with {fit.distribution}" if fit.distribution else ""
        raise ExportError(
            f"The model {fit.model}{normals} cannot be rendered: export a fit of cook-torrance or cook-torrance-shift "
            "with ggx."
        )
    h, w = (fit.value("h"), fit.value("w")) if fit.model != "cook-torrance" else (0.0, 0.0)
    return write_bsdf(path, fit.value("alpha"), conductor, h, w, about=describe(fit, dataset))


def describe(fit: ModelFit, dataset: Dataset) -> str:
    """What a renderer's user has to know about a fit before believing its file."""
    low_in, high_in, low_out, high_out = fit.theta_range
    lines = [
        f"Fitted model of sample {dataset.sample}: {fit.equation}.",
        "This is the model, not the data behind it: an in-plane scan cannot fill a hemisphere.",
        f"Fitted in plane for theta_in {low_in:g} to {high_in:g} deg, theta_out {low_out:g} to {high_out:g} deg, "
        f"{fit.wavelength_range[0]:g} to {fit.wavelength_range[1]:g} nm; everything else is extrapolated.",
        f"Dataset SHA-256 {dataset.content_hash}.",
        "Parameters with standard uncertainty (coverage factor 1): "
        + ", ".join(f"{p.name} = {p.value:.6g} +- {p.standard_error:.2g} {p.unit}" for p in fit.parameters)
        + ".",
    ]
    if not fit.verdict.trusted:
        lines.append("NOT TO BE TRUSTED: " + " ".join(fit.verdict.reasons))
    return "\n".join(lines)


def _wavelength_nodes(model: _Model) -> tuple[FloatArray, float]:
    """Few wavelengths, nm, between which a linear table keeps the colour, and the difference that remains.

    Nodes are added where the luminous error is largest until no test spectrum (angles of incidence on the
    facet 0 to 75 degrees, the model's own range of slopes) is more than `COLOUR_BUDGET` off in CIEDE2000.
    """
    fine = np.linspace(*SPECTRAL_RANGE, 189)
    n, k = model.conductor.index(fine)
    slopes = cosine_slope(np.linspace(0, 90, 181), model.h, model.w)
    cosines = np.cos(np.radians([0.0, 30, 60, 75]))
    fresnel = fresnel_conductor(cosines[:, None], n, k)
    tilts = shift(np.array([slopes.min(), 0.0, slopes.max()]), fine)
    exact = (fresnel[:, None] * tilts).reshape(-1, fine.size)
    weights = xyz_weights(fine)
    nodes = [0, fine.size - 1]
    while True:
        table = np.array([np.interp(fine, fine[nodes], spectrum[nodes]) for spectrum in exact])
        difference = float(delta_e_2000(table @ weights, exact @ weights).max())
        if difference <= COLOUR_BUDGET:
            return fine[nodes], difference
        error = np.abs(table - exact).max(axis=0) * weights.max(axis=1)
        nodes = sorted([*nodes, int(np.argmax(error))])


def _at_normals(
    model: _Model, wavelengths: FloatArray, theta_i: float, normal: FloatArray, cos_d: FloatArray
) -> FloatArray:
    """G1(o) F shift [nodes, wavelengths]."""
    cos_o = 2 * cos_d * normal[:, 2] - np.cos(theta_i)
    n, k = model.conductor.index(wavelengths)
    masking = g1(np.maximum(cos_o, LOWEST_COS), model.alpha)
    fresnel = fresnel_conductor(np.maximum(cos_d, LOWEST_COS)[:, None], n, k)
    theta_m = np.degrees(np.arccos(np.clip(normal[:, 2], -1, 1)))
    tilt = shift(cosine_slope(theta_m, model.h, model.w), wavelengths)
    return np.asarray(masking[:, None] * fresnel * tilt)


def _test_directions(alpha: float) -> tuple[FloatArray, FloatArray]:
    """Incident and reflected unit vectors [pairs, 3]: half uniform in solid angle, half within the lobe."""
    rng = np.random.default_rng(_TEST_SEED)
    lowest = np.cos(np.radians(LARGEST_TESTED_ANGLE))

    def uniform() -> FloatArray:
        return unit(np.arccos(rng.uniform(lowest, 1, _TEST_PAIRS)), rng.uniform(-np.pi, np.pi, _TEST_PAIRS))

    incident = uniform()
    share = rng.random(_TEST_PAIRS)
    normal = unit(np.arctan(alpha * np.sqrt(share / (1 - share))), rng.uniform(-np.pi, np.pi, _TEST_PAIRS))
    reflected = 2 * np.sum(incident * normal, axis=-1, keepdims=True) * normal - incident
    lit = np.flatnonzero(reflected[:, 2] > lowest)[: _TEST_PAIRS // 2]
    even = uniform()
    others = slice(_TEST_PAIRS - lit.size, None)
    return np.concatenate([incident[lit], uniform()[others]]), np.concatenate([reflected[lit], even[others]])


def _measured_error(content: bytes, model: _Model) -> RelativeError:
    """Read `content` back as a renderer does and compare it with the model."""
    incident, reflected = _test_directions(model.alpha)
    wavelengths = np.linspace(*SPECTRAL_RANGE, 48)
    half = incident + reflected
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    cosines = Directions(incident[:, 2], reflected[:, 2], half[:, 2], np.sum(incident * half, axis=-1))
    exact = cook_torrance(cosines, wavelengths, model.alpha, model.conductor, model.h, model.w)
    exact = exact * reflected[:, 2:]
    found = evaluate(read_bsdf(content), incident, reflected, wavelengths)
    # a clamped shift makes the model exactly zero: relate to the brightest wavelength of the direction there
    scale = np.maximum(exact, 1e-3 * exact.max(axis=-1, keepdims=True))
    worst = np.max(np.abs(found - exact) / scale, axis=-1)
    return RelativeError(float(np.median(worst)), float(np.percentile(worst, 99)), float(worst.max()))


def _description(
    about: str, model: _Model, layout: str, error: RelativeError, wavelengths: FloatArray, colour_error: float
) -> str:
    """The text inside the file."""
    lines = [
        *([about] if about else []),
        f"Cook-Torrance with GGX alpha = {model.alpha:.17g} and conductor {model.conductor.name}, times the shift "
        f"1 + m (lambda - 600 nm), m = h cos(w theta_m), h = {model.h:.17g} /um, w = {model.w:.17g}.",
        f"Table layout {layout}; error of this file against the model at {len(wavelengths)} wavelength nodes: "
        f"relative, worst of 360 to 830 nm, median {error.median:.2g}, 99th percentile {error.p99:.2g}, "
        f"maximum {error.maximum:.2g} over {_TEST_PAIRS} pairs of directions up to {LARGEST_TESTED_ANGLE:g} deg, "
        "half of them uniform in solid angle and half within the lobe; "
        f"the wavelength nodes alone cost at most {colour_error:.2g} CIEDE2000.",
    ]
    return "\n".join(lines)
