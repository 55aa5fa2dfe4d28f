"""Spectra of a dataset: one point with all that is known of it, or all of them as numbers in a row."""

import numpy as np

from analysis.fits.noise import flag_words
from analysis.fits.stored_fit import as_measured
from analysis.reflectance.fresnel import Conductor
from analysis.reflectance.models import local_model, normalised_fresnel
from api.bodies.base import number, numbers
from api.bodies.plots import LocalCurve, PointSpectrum
from api.views.listing import flag_names
from api.views.opened import Opened
from api.views.slopes import local_points
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.errors import NotInStore
from goniometer.storage.look_up import exposures_of
from goniometer.storage.store import Store


def point_spectrum(store: Store, opened: Opened, point: int) -> PointSpectrum:
    """One point of a dataset; raises `NotInStore`."""
    dataset = opened.dataset
    if not 0 <= point < dataset.theta_in.size:
        raise NotInStore(
            f"Dataset {opened.entry.id} has no point {point}; its points have the numbers 0 to "
            f"{dataset.theta_in.size - 1}."
        )
    modelled = None
    if opened.shift is not None:
        modelled = as_measured(opened.shift, *_directions(dataset, point), dataset.wavelengths)[0]
    differences = opened.differences
    measured, exposures = _raw(store, opened, point)
    return PointSpectrum(
        dataset=opened.entry.id,
        point=point,
        theta_in_deg=float(dataset.theta_in[point]),
        theta_out_deg=float(dataset.theta_out[point]),
        wavelengths_nm=dataset.wavelengths.tolist(),
        brdf=numbers(dataset.brdf[point]),
        u=numbers(dataset.u[point]),
        u_counts=numbers(dataset.u_counts[point]),
        local=_local(opened, point),
        model=None if opened.shift is None else opened.shift.model,
        modelled=None if modelled is None else numbers(modelled),
        dE00=None if differences is None else number(differences.absolute[point]),
        dE00_chromatic=None if differences is None else number(differences.chromatic[point]),
        flags=flag_names(int(dataset.flags[point])),
        flag_words=flag_words(int(dataset.flags[point])),
        point_id=measured,
        exposures=exposures,
    )


def packed_spectra(dataset: Dataset) -> bytes:
    """All spectra as little-endian numbers.

    Two unsigned 32-bit integers: points P and wavelengths W. Then 64-bit floats: W wavelengths in nm, P theta_in and P
    theta_out in degrees, P x W BRDF and P x W combined standard uncertainty (k = 1) in 1/sr, wavelength by wavelength
    of the first point, then of the next; NaN where there is no value.
    """
    head = np.array([dataset.theta_in.size, dataset.wavelengths.size], dtype="<u4")
    parts = dataset.wavelengths, dataset.theta_in, dataset.theta_out, dataset.brdf, dataset.u
    return head.tobytes() + b"".join(np.ascontiguousarray(part, dtype="<f8").tobytes() for part in parts)


def _directions(dataset: Dataset, point: int) -> tuple[FloatArray, FloatArray]:
    return dataset.theta_in[point : point + 1], dataset.theta_out[point : point + 1]


def _local(opened: Opened, point: int) -> LocalCurve | None:
    found = local_points(opened)
    own = None if found is None else found.get(point)
    if own is None or opened.analysis is None:
        return None
    if own.scale_per_sr is None or own.slope_per_um is None or own.exponent is None:
        return LocalCurve(parameters=own, fitted=[None] * opened.dataset.wavelengths.size)
    metal = opened.analysis["conductor"]
    conductor = Conductor(metal["name"], *(np.array(metal[key], dtype=float) for key in ("wavelength_nm", "n", "k")))
    lambda_n, wavelengths = float(opened.analysis["local"]["lambda_n_nm"]), opened.dataset.wavelengths
    fresnel = normalised_fresnel(opened.dataset.theta_in[point], wavelengths, conductor, lambda_n)
    scale, slope, exponent = (np.array(each) for each in (own.scale_per_sr, own.slope_per_um, own.exponent))
    fitted = local_model(fresnel, wavelengths, scale, slope, exponent, lambda_n)
    return LocalCurve(parameters=own, fitted=numbers(fitted))


def _raw(store: Store, opened: Opened, point: int) -> tuple[int | None, list[int]]:
    """The measured point, and its exposures: a dataset has the points of its scan that are done, in their order."""
    scan_id = opened.entry.scan_id
    if scan_id is None:
        return None, []
    done = [each for each in store.points(scan_id) if each.status == "done"]
    if len(done) != opened.dataset.theta_in.size:  # the scan was resumed after this dataset was made
        return None, []
    return done[point].id, exposures_of(store, done[point].id)
