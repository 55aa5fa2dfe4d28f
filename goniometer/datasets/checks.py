"""Sanity checks: what a dataset says about its own faults.

Every check is one question with an answer in numbers. It passes or fails by what would be rare (less than one in a
thousand) if the dataset and its stated uncertainties were right; where the data do not tell, it says so.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import FloatArray
from goniometer.datasets.averages import Averages, averages, middle
from goniometer.datasets.dataset import Check, Dataset, Flag
from goniometer.datasets.energy import energy
from goniometer.datasets.reciprocity import reciprocity
from goniometer.uncertainty import combined

RARE = 3.5
"""Standard uncertainties beyond which one difference is rare: 1 in 2000 where it is normally distributed."""

RARE_SHARE = 0.05
"""Share of rare differences above which the data contradict their uncertainties."""

ENERGY_FACTOR = 3.0
"""Coverage factor of the energy check, which judges the largest of some hundred values."""

NEGATIVE_SHARE = 0.02
"""Share of the values of a point that must be rare for the point to count as negative: one alone is chance."""

NEGATIVE_FACTOR = 3.0
"""Standard uncertainties below zero at which a value counts."""

LARGEST_DRIFT = 0.1
"""Relative change of a lamp over a scan above which it should not be trusted, corrected or not."""

ALIKE = 0.02
"""Relative difference between two spots up to which a sample is called the same everywhere, however well known."""

SAME_DIRECTION = 0.1
"""Degrees within which two scans stood in the same planned direction."""

_UNSHARED_PARTS = ("random", "dark", "drift", "stray light")


def noise_flags(brdf: FloatArray, u_counts: FloatArray) -> NDArray[np.uint16]:
    """[points] `Flag.BELOW_NOISE` and `Flag.NEGATIVE` where they apply.

    `brdf` and its standard uncertainty from the counts, each [points, wavelengths], 1/sr; a point without any value
    gets no flag. A point is below the noise where the median of its values over their uncertainties is below one.
    It is negative where more than `NEGATIVE_SHARE` of its values lie more than three uncertainties below zero.
    """
    flags = np.zeros(brdf.shape[0], dtype=np.uint16)
    ratio = _in_uncertainties(brdf, u_counts)
    some = np.isfinite(ratio).any(axis=1)
    flags[some] |= np.where(np.nanmedian(ratio[some], axis=1) < 1, Flag.BELOW_NOISE, 0).astype(np.uint16)
    flags[_negative(brdf, u_counts)] |= np.uint16(Flag.NEGATIVE)
    return flags


def checks(dataset: Dataset, *, spot: Dataset | None, drift: float | None, drift_corrected: bool) -> tuple[Check, ...]:
    """Every check of a dataset.

    `spot` is the same sample at another spot or azimuth, calibrated with the same reference scan; None where that was
    not measured. `drift` is the largest relative change of the lamp over the scan; None where no monitor
    exposures tell of it.
    """
    return (
        _reciprocity(dataset, _OF_OWN_BENCH),
        _energy(dataset, _OF_OWN_BENCH),
        _values(dataset, _OF_OWN_BENCH),
        _drift(dataset, drift, corrected=drift_corrected),
        _saturation(dataset),
        _homogeneity(dataset, spot),
        _noise_floor(dataset, _OF_OWN_BENCH),
        _footprint(dataset),
    )


def checks_of_imported(dataset: Dataset) -> tuple[Check, ...]:
    """What can be asked of a dataset that was measured elsewhere: the questions that its values alone answer."""
    return _of_values(dataset, _OF_OTHERS)


def checks_of_simulated(dataset: Dataset) -> tuple[Check, ...]:
    """What can be asked of a dataset that was computed: the same, with other advice where an answer is bad."""
    return _of_values(dataset, _OF_A_SIMULATION)


def _of_values(dataset: Dataset, advice: "_Advice") -> tuple[Check, ...]:
    return (
        _reciprocity(dataset, advice),
        _energy(dataset, advice),
        _values(dataset, advice, may_lack=True),
        _noise_floor(dataset, advice),
    )


class _Advice(NamedTuple):
    """What to do where a check failed; it depends on where a dataset comes from."""

    reciprocity: str
    energy: str
    negative: str
    noise_floor: str


_OF_OWN_BENCH = _Advice(
    "check the zeros of both stages, and whether the sample looks the same from all sides",
    "Check that the reference panel and its certificate belong together, and the integration times of the brightest "
    "points.",
    "take darks and stray light again",
    "allow longer integration times, or measure fewer dark directions",
)
_OF_OTHERS = _OF_OWN_BENCH._replace(
    energy="Check that the values are what was stated of them, and not per cent or counts."
)
_OF_A_SIMULATION = _Advice(
    "choose a reciprocal model of light, or a surface that looks the same from all sides",
    "Look for the limits of the approximation, or sample the surface more finely.",
    "use more rays, or average over a larger area",
    "use more rays, average over a larger area, or leave out dark directions",
)


def _reciprocity(dataset: Dataset, advice: _Advice) -> Check:
    name = "reciprocity"
    pairs = reciprocity(dataset)
    if not pairs.z.size:
        return Check(name, None, "Not known: no direction has its reverse beside it, clear of the noise.")
    z = np.abs(pairs.z)
    worst = int(np.argmax(z))
    rare = int(np.sum(z > RARE))
    theta_in, theta_out = float(pairs.theta_in[worst]), float(pairs.theta_out[worst])
    there, back = _direction(theta_in, theta_out), _direction(abs(theta_out), np.copysign(theta_in, theta_out))
    above = "above" if pairs.difference[worst] > 0 else "below"
    found = (
        f"{_count(z.size, 'direction')} compared with {'its' if z.size == 1 else 'their'} reverse, mean over "
        f"{_middle(dataset)}: root mean square difference {np.sqrt(np.mean(z**2)):.1f} standard uncertainties, at most "
        f"{z[worst]:.1f}, where {there} lies {_percent(abs(np.expm1(pairs.difference[worst])))} {above} {back}."
    )
    if rare <= RARE_SHARE * z.size:
        return Check(name, True, found)
    return Check(
        name,
        False,
        f"{rare} of {found} That is more than {RARE:g} standard uncertainties in more than "
        f"{100 * RARE_SHARE:.0f} % of the pairs: {advice.reciprocity}.",
    )


def _energy(dataset: Dataset, advice: _Advice) -> Check:
    name = "energy"
    found = energy(dataset)
    if not found.theta_in.size:
        return Check(name, None, "Not known: no incident angle has three usable directions.")
    known = np.isfinite(found.rho)
    if not known.any():
        return Check(name, None, "Not known: at no incident angle and in no band of wavelengths is a value above zero.")
    # the largest in its own uncertainty: a badly known 1.1 says less than a well known 1.05
    excess = (found.rho - 1) / np.maximum(found.u, 1e-12)
    too_much = excess > ENERGY_FACTOR
    failed = bool(too_much.any())
    angle, band = np.unravel_index(np.nanargmax(excess if failed else found.rho), found.rho.shape)
    rho, u = float(found.rho[angle, band]), float(found.u[angle, band])
    said = (
        f"At θ in = {found.theta_in[angle]:.0f}° and {found.wavelengths[band]:.0f} nm, {rho:.3f} ± "
        f"{ENERGY_FACTOR * u:.3f} (k = {ENERGY_FACTOR:g}) of the light that falls in is reflected, if the surface is "
        f"isotropic and its BRDF depends on the half vector above all"
    )
    dark = (
        ""
        if known.all()
        else f" Not known for {int(np.sum(~known))} of {known.size} combinations of incident angle and band of "
        f"wavelengths, where no value is above zero."
    )
    if not failed:
        return Check(name, True, f"{said}; nowhere is it more.{dark}")
    bands = found.wavelengths[too_much.any(axis=0)]
    where = f"at {bands[0]:.0f} nm" if bands.size == 1 else f"from {bands[0]:.0f} to {bands[-1]:.0f} nm"
    return Check(
        name,
        False,
        f"{said}: more than all. So it is for {int(too_much.sum())} of {int(known.sum())} combinations of incident "
        f"angle and band of wavelengths, {where}.{dark} {advice.energy}",
    )


def _values(dataset: Dataset, advice: _Advice, *, may_lack: bool = False) -> Check:
    """With `may_lack` values that are no numbers are no fault: a file holds what it holds, and its import counts them.

    Nobody can look at the raw counts of another laboratory.
    """
    explained = dataset.flagged(Flag.SATURATED | Flag.BEYOND_REFERENCE)
    missing = ~np.isfinite(dataset.brdf).all(axis=1) & ~explained & (not may_lack)
    negative = _negative(dataset.brdf, dataset.u)
    by_noise = int(np.sum(dataset.flagged(Flag.NEGATIVE) & ~negative))
    faults = []
    if missing.any():
        faults.append(
            f"{_count(int(missing.sum()), 'point')} without a flag that says why {_has(missing)} values that are no "
            f"numbers, the first at {_at(dataset, missing)}: look at the raw counts."
        )
    if negative.any():
        faults.append(
            f"{_count(int(negative.sum()), 'point')} {_has(negative)} values that lie below zero by more than "
            f"{NEGATIVE_FACTOR:g} standard uncertainties, the first at {_at(dataset, negative)}: {advice.negative}."
        )
    if faults:
        return Check("values", False, " ".join(faults))
    lacking = int(np.sum(~np.isfinite(dataset.brdf))) if may_lack else 0
    all_ = f"All values but {lacking} that the file lacks are numbers" if lacking else "All values are numbers"
    told = f"{all_}, and none lies below zero by more than its uncertainty explains."
    if by_noise:
        told += f" {_count(by_noise, 'point')} would be negative by the noise of the counts alone."
    return Check("values", True, told)


def _drift(dataset: Dataset, largest: float | None, *, corrected: bool) -> Check:
    name = "drift"
    part = tuple(source for source in dataset.sources if source.part == "drift")
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = combined(part, dataset.brdf.shape) / np.abs(dataset.brdf)
    known = relative[np.isfinite(relative) & (relative > 0)]
    covered = float(np.median(known)) if known.size else 0.0
    stated = f"the budget contains {_percent(covered)} for it (k = 1)" if covered else "the budget does not contain it"
    if largest is None:
        return Check(name, None, f"Not measured: no monitor exposures tell how the lamp drifted; {stated}.")
    changed = f"The lamp changed by up to {_percent(largest)} during the scan"
    if largest > LARGEST_DRIFT:
        return Check(name, False, f"{changed}, which no lamp does that is well; let it warm up, or replace it.")
    if corrected:
        return Check(name, True, f"{changed}; that was corrected, and what remains of it is in the budget.")
    if largest > 2 * covered:
        return Check(
            name, False, f"{changed} and was not corrected, but {stated}; calibrate with the correction of drift."
        )
    return Check(name, True, f"{changed} and was not corrected; {stated}.")


def _saturation(dataset: Dataset) -> Check:
    saturated = dataset.flagged(Flag.SATURATED)
    if not saturated.any():
        return Check("saturation", True, "No point was saturated.")
    return Check(
        "saturation",
        False,
        f"{_count(int(saturated.sum()), 'point')} stayed saturated at the shortest integration time, the first at "
        f"{_at(dataset, saturated)}: shorten it, or attenuate the lamp.",
    )


def _homogeneity(dataset: Dataset, spot: Dataset | None) -> Check:
    name = "homogeneity"
    if spot is None:
        return Check(name, None, "Not measured: set homogeneity in the campaign.")
    here, there = (averages(each, middle(each.wavelengths)) for each in (dataset, spot))
    apart = np.maximum(
        np.abs(spot.theta_in[:, None] - dataset.theta_in), np.abs(spot.theta_out[:, None] - dataset.theta_out)
    )
    apart[:, ~np.isfinite(here.values[:, 0])] = np.inf
    nearest = np.argmin(apart, axis=1)
    same = (apart[np.arange(nearest.size), nearest] <= SAME_DIRECTION) & np.isfinite(there.values[:, 0])
    if not same.any():
        return Check(name, None, "Not known: the two spots have no usable direction in common.")
    one, other = here.values[nearest[same], 0], there.values[same, 0]
    # What both scans share, from the reference to the zeros of the stages, is the same error on both sides. What the
    # stages do is taken from this dataset for both: the few directions of a spot do not tell how steep its lobe is.
    angle = _angle(here)[nearest[same]]
    own = _unshared(here)[nearest[same]], _unshared(there)[same]
    u = np.sqrt(own[0] ** 2 + own[1] ** 2 + 2 * angle**2)
    z, relative = np.abs(other - one) / u, np.abs(other / one - 1)
    worst = int(np.argmax(z))
    rare = int(np.sum((z > RARE) & (relative > ALIKE)))
    place = int(np.flatnonzero(same)[worst])
    found = (
        f"{_count(z.size, 'direction')} compared with another spot or azimuth, mean over {_middle(dataset)}: root "
        f"mean square difference {np.sqrt(np.mean(z**2)):.1f} standard uncertainties, at most {z[worst]:.1f}, where "
        f"{_direction(spot.theta_in[place], spot.theta_out[place])} differs by "
        f"{_percent(relative[worst])}."
    )
    if rare <= RARE_SHARE * z.size:
        return Check(name, True, found)
    return Check(
        name,
        False,
        f"{rare} of {found} The sample is not the same everywhere: what is said of one spot does not hold for all.",
    )


def _unshared(mean: Averages) -> FloatArray:
    """[points] standard uncertainty of one band from counts, darks, lamp and stray light, which every scan has anew."""
    own = tuple(source for source in mean.sources if source.part in _UNSHARED_PARTS)
    return combined(own, mean.values.shape)[:, 0]


_MOVES = {"angle: sample stage", "angle: detector stage"}
"""Errors of angles that another scan has anew; zeros, and the positions at the reference, are the same for both."""


def _angle(mean: Averages) -> FloatArray:
    """[points] standard uncertainty of one band from what each move of a stage does anew."""
    moves = tuple(source for source in mean.sources if source.name in _MOVES)
    return combined(moves, mean.values.shape)[:, 0]


def _noise_floor(dataset: Dataset, advice: _Advice) -> Check:
    below = dataset.flagged(Flag.BELOW_NOISE)
    if not below.any():
        return Check("noise floor", True, "All points stand clear of the noise.")
    number, points = int(below.sum()), below.size
    floor = float(np.nanmedian(dataset.u_counts[below]))
    found = (
        f"{number} of {points} points lie below the noise, which is {floor:.2g} 1/sr there (k = 1, median over "
        f"wavelengths)"
    )
    if number <= points / 2:
        return Check("noise floor", True, f"{found}.")
    return Check("noise floor", False, f"{found}: {advice.noise_floor}.")


def _footprint(dataset: Dataset) -> Check:
    clipped = dataset.flagged(Flag.CLIPPED)
    if not clipped.any():
        return Check("footprint", True, "The detector saw nothing but the sample at all points.")
    smallest = float(np.abs(dataset.theta_out[clipped]).min())
    return Check(
        "footprint",
        False,
        f"At {_count(int(clipped.sum()), 'point')}, from |θ out| = {smallest:.0f}° on, the detector sees beyond the "
        f"edge of the sample: leave out these directions, or measure a larger sample.",
    )


def _in_uncertainties(brdf: FloatArray, u: FloatArray) -> FloatArray:
    """[points, wavelengths] value over its standard uncertainty, NaN without one."""
    ratio = np.full(brdf.shape, np.nan)
    np.divide(brdf, u, out=ratio, where=np.isfinite(brdf) & np.isfinite(u) & (u > 0))
    return ratio


def _negative(brdf: FloatArray, u: FloatArray) -> NDArray[np.bool_]:
    """[points] whether more than `NEGATIVE_SHARE` of the values lie below zero by more than three of `u`."""
    ratio = _in_uncertainties(brdf, u)
    below = np.sum(ratio < -NEGATIVE_FACTOR, axis=1)
    return np.asarray(below > NEGATIVE_SHARE * np.maximum(np.isfinite(ratio).sum(axis=1), 1))


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _has(points: NDArray[np.bool_]) -> str:
    return "has" if points.sum() == 1 else "have"


def _at(dataset: Dataset, points: NDArray[np.bool_]) -> str:
    first = int(np.argmax(points))
    return f"θ in = {dataset.theta_in[first]:.1f}°, θ out = {dataset.theta_out[first]:.1f}°".replace("-", "−")


def _direction(theta_in: float, theta_out: float) -> str:
    return f"BRDF({theta_in:.1f}°, {round(theta_out, 1) + 0.0:.1f}°)".replace("-", "−")  # no negative zero


def _middle(dataset: Dataset) -> str:
    inside = dataset.wavelengths[middle(dataset.wavelengths)[:, 0] > 0]
    return f"{inside[0]:.0f} to {inside[-1]:.0f} nm"


def _percent(part: float) -> str:
    return f"{100 * part:.2g} %" if part < 1 else f"{100 * part:.0f} %"
