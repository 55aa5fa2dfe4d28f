"""Eq. 2 by the library that the paper used: lmfit's Levenberg-Marquardt, spectrum by spectrum from one start."""

import numpy as np

from drivers.arrays import BoolArray, FloatArray


def fit_each(
    weight: FloatArray, weighted: FloatArray, log_fresnel: FloatArray, x: FloatArray, bounds: tuple[float, float]
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """a (1/sr), m (1/um), p and whether it converged, each [spectra], from m = 0 and p = 1.

    `weight`, values times weight and ln F_n are [spectra, wavelengths]; `x` [wavelengths] is the distance to lambda_n,
    um, and p stays between `bounds`.
    """
    import lmfit  # noqa: PLC0415  (takes most of a second)

    low, high = bounds
    found = np.empty((3, weight.shape[0]))
    converged = np.zeros(weight.shape[0], dtype=bool)
    for point, (of_one, values, logarithm) in enumerate(zip(weight, weighted, log_fresnel, strict=True)):
        root = np.sqrt(of_one)
        target = np.divide(values, root, out=np.zeros_like(root), where=root > 0)

        def residual(
            p: lmfit.Parameters, target: FloatArray = target, root: FloatArray = root, log_f: FloatArray = logarithm
        ) -> FloatArray:
            model = p["a"].value * (1 + p["m"].value * x) * np.exp(p["p"].value * log_f)
            return np.asarray(root * model - target)

        parameters = lmfit.Parameters()
        parameters.add("a", value=float(values.sum() / of_one.sum()))
        parameters.add("m", value=0.0)
        parameters.add("p", value=1.0, min=low, max=high)
        result = lmfit.minimize(residual, parameters, calc_covar=False, ftol=1e-15, xtol=1e-15, gtol=1e-15)
        found[:, point] = [result.params[name].value for name in ("a", "m", "p")]
        # MINPACK's 6 to 8 say that rounding stops any further descent, as these tolerances want it
        converged[point] = result.ier in {1, 2, 3, 4, 6, 7, 8}
    return found[0], found[1], found[2], converged
