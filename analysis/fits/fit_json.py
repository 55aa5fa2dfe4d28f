"""Fits as JSON: what was fitted, to what, how well, and enough to evaluate it again bit for bit.

Strict JSON (RFC 8259). A number is written with as many digits as its reload needs. JSON knows no NaN and no
infinity: NaN ("no value") is null, infinities are the strings "inf" and "-inf"; the reader turns them back.
The refractive index is part of the file, so that a model does not change when a material database does.
"""

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from importlib.metadata import version
from typing import Any, cast

import numpy as np

from analysis.fits.misfit import PARTS_OF_FITS
from analysis.fits.noise import flag_words
from analysis.fits.stored_fit import StoredFit
from analysis.reflectance.fresnel import Conductor
from analysis.results import (
    Albedo,
    ColourDifferences,
    Comparison,
    LocalFit,
    ModelFit,
    Parameter,
    SampleAnalysis,
    Verdict,
)
from analysis.strict_json import strict_json
from goniometer.datasets.dataset import MEANING, Dataset
from goniometer.errors import InputError
from goniometer.geometry import Geometry

FIT_SCHEMA = "goniometer-fit"
ANALYSIS_SCHEMA = "goniometer-analysis"
SCHEMA_VERSION = 3

_NOTE = (
    'null is NaN (no value), "inf" and "-inf" are infinities; standard errors and u_ are standard uncertainties '
    f"(coverage factor 1) by {', '.join(PARTS_OF_FITS)}; angles in degrees, theta_out signed with the mirror direction "
    "at +theta_in, wavelengths in nm, slopes in 1/um, BRDF in 1/sr; directions that the detector blocks are left out"
)


def fit_to_json(fit: ModelFit, dataset: Dataset, differences: ColourDifferences, conductor: Conductor) -> str:
    """One fit as JSON text; `dataset` and `conductor` are those it was fitted with, the latter where it was needed.

    Raises as `analysis_to_json`.
    """
    part = _fit_part(fit, dataset, differences)
    needed = {"conductor": _conductor_part(conductor)} if _is_of_metal(part) else {}
    return strict_json(_head(FIT_SCHEMA) | part | needed)


def fit_from_json(text: str) -> StoredFit:
    """A fit from what `fit_to_json` wrote, equal to it bit for bit.

    Raises `InputError` if the text is no JSON, no fit, of another schema version, or incomplete.
    """
    with _complete():
        return _stored_fit(_document(text, FIT_SCHEMA))


def analysis_from_json(text: str) -> tuple[StoredFit, ...]:
    """All fits but the local one from what `analysis_to_json` wrote, in its order and equal to them bit for bit.

    Raises what `fit_from_json` raises.
    """
    document = _document(text, ANALYSIS_SCHEMA)
    with _complete():
        of_all = {"software": document["software"]}
        metal = {"conductor": document["conductor"]}
        return tuple(_stored_fit(part | of_all | (metal if _is_of_metal(part) else {})) for part in document["models"])


@contextmanager
def _complete() -> Iterator[None]:
    """Turns what a missing or wrong field raises into `InputError`."""
    try:
        yield
    except KeyError as fault:
        raise InputError(f"This fit file is incomplete: the field {fault} is missing.") from fault
    except (TypeError, ValueError, AttributeError) as fault:
        raise InputError(f"This fit file is damaged: a field does not hold what it should ({fault}).") from fault


def _is_of_metal(part: dict[str, Any]) -> bool:
    """Whether a model needs the refractive index of the metal."""
    return "albedo" not in part and any(parameter["name"] in {"p", "alpha"} for parameter in part["parameters"])


def analysis_to_json(analysis: SampleAnalysis, conductor: Conductor) -> str:
    """Everything fitted to one dataset as JSON text: the local fit point by point, and all models.

    Raises `ExportError` if the dataset's lineage holds something that JSON cannot.
    """
    dataset = analysis.dataset
    return strict_json(
        _head(ANALYSIS_SCHEMA)
        | {
            "dataset": {
                "sample": dataset.sample,
                "sha256": dataset.content_hash,
                "points": int(dataset.theta_in.size),
                "wavelengths_nm": dataset.wavelengths.tolist(),
                "aperture_deg": dataset.aperture,
                "u_stage_deg": dataset.u_angle,
                "u_zero_deg": dataset.u_zero,
                "flagged_points": {words: int(dataset.flagged(flag).sum()) for flag, words in MEANING.items()},
                "checks": [asdict(check) for check in dataset.checks],
                "lineage": dataset.lineage,
            },
            "local": _local_part(analysis.local, dataset, analysis.differences["local"]),
            "models": [_fit_part(fit, dataset, analysis.differences[fit.model]) for fit in analysis.models],
            "conductor": _conductor_part(conductor),
        }
    )


def _head(schema: str) -> dict[str, Any]:
    return {
        "schema": schema,
        "schema_version": SCHEMA_VERSION,
        "note": _NOTE,
        "software": {"name": "goniometer", "version": version("goniometer")},
    }


def _fit_part(fit: ModelFit, dataset: Dataset, differences: ColourDifferences) -> dict[str, Any]:
    found = {
        "model": fit.model,
        "equation": fit.equation,
        "engine": fit.engine,
        "lambda_n_nm": fit.lambda_n,
        "parameters": [
            {
                "name": p.name,
                "value": p.value,
                "standard_error": p.standard_error,
                "unit": p.unit,
                "standard_error_by_part": p.error_by_part,
            }
            for p in fit.parameters
        ],
        "correlation": fit.correlation.tolist(),
        "verdict": {
            "trusted": fit.verdict.trusted,
            "reasons": list(fit.verdict.reasons),
            "undetermined": list(fit.verdict.undetermined),
            "converged": fit.verdict.converged,
        },
        "fitted_to": {
            "sample": dataset.sample,
            "dataset_sha256": dataset.content_hash,
            "points": int(dataset.theta_in.size),
            "aperture_deg": dataset.aperture,
            "theta_in_deg": list(fit.theta_range[:2]),
            "theta_out_deg": list(fit.theta_range[2:]),
            "wavelength_nm": list(fit.wavelength_range),
        },
        "metrics": {
            "cost": {"name": fit.cost, "value": fit.cost_value},
            "independent_residuals": fit.independent,
            "r2": fit.r2,
            "clamped_points": fit.clamped_points,
            "dE00": {kind: differences.statistics(kind) for kind in ("absolute", "chromatic")},
        },
    }
    if fit.distribution is not None:
        found["distribution"] = fit.distribution
    if fit.comparison is not None:
        found["comparison"] = {
            "simpler_model": fit.comparison.simpler,
            "BIC_falls_by": fit.comparison.bic,
            "mean_dE00_falls_by": fit.comparison.dE00,
        }
    if fit.albedo is not None:
        found["albedo"] = {
            "wavelength_nm": fit.albedo.wavelengths.tolist(),
            "r_d": fit.albedo.values.tolist(),
            "u_r_d": fit.albedo.u.tolist(),
        }
    return found


def _local_part(local: LocalFit, dataset: Dataset, differences: ColourDifferences) -> dict[str, Any]:
    pairs = zip(dataset.theta_in.tolist(), dataset.theta_out.tolist(), strict=True)
    seen = np.array([dataset.simulated or not Geometry(*pair).blocked for pair in pairs], dtype=bool)
    return {
        "equation": "f = a (1 + m (lambda - lambda_n)) F_norm(theta_in)^p, Eq. 2"
        + ("" if local.fresnel else ", p held at 0"),
        "lambda_n_nm": local.lambda_n,
        "theta_in_deg": dataset.theta_in[seen].tolist(),
        "theta_out_deg": dataset.theta_out[seen].tolist(),
        "m_per_um": local.slope[seen].tolist(),
        "u_m_per_um": local.u_slope[seen].tolist(),
        "p": local.exponent[seen].tolist(),
        "u_p": local.u_exponent[seen].tolist(),
        "a_per_sr": local.scale[seen].tolist(),
        "r2": local.r2[seen].tolist(),
        "reliable": local.reliable[seen].tolist(),
        "doubts": list(local.doubts),
        "flags": [flag_words(int(flags)) for flags in dataset.flags[seen]],
        "dE00_absolute": differences.absolute[seen].tolist(),
        "dE00_chromatic": differences.chromatic[seen].tolist(),
    }


def _conductor_part(conductor: Conductor) -> dict[str, Any]:
    return {
        "name": conductor.name,
        "wavelength_nm": conductor.wavelengths.tolist(),
        "n": conductor.n.tolist(),
        "k": conductor.k.tolist(),
    }


def _stored_fit(document: dict[str, Any]) -> StoredFit:
    fitted_to, metrics, verdict = document["fitted_to"], document["metrics"], document["verdict"]
    low_in, high_in = (float(v) for v in fitted_to["theta_in_deg"])
    low_out, high_out = (float(v) for v in fitted_to["theta_out_deg"])
    shortest, longest = (float(v) for v in fitted_to["wavelength_nm"])
    parameters = tuple(
        Parameter(
            str(p["name"]),
            float(p["value"]),
            float(p["standard_error"]),
            str(p["unit"]),
            {str(part): float(error) for part, error in p["standard_error_by_part"].items()},
        )
        for p in document["parameters"]
    )
    return StoredFit(
        model=str(document["model"]),
        equation=str(document["equation"]),
        engine=document["engine"],
        distribution=document.get("distribution"),
        parameters=parameters,
        correlation=np.array(document["correlation"], dtype=float).reshape(len(parameters), len(parameters)),
        verdict=Verdict(
            bool(verdict["trusted"]),
            tuple(map(str, verdict["reasons"])),
            tuple(map(str, verdict["undetermined"])),
            bool(verdict["converged"]),
        ),
        comparison=_stored_comparison(document["comparison"]) if "comparison" in document else None,
        cost=str(metrics["cost"]["name"]),
        cost_value=float(metrics["cost"]["value"]),
        independent=float(metrics["independent_residuals"]),
        r2=float(metrics["r2"]),
        lambda_n=float(document["lambda_n_nm"]),
        theta_range=(low_in, high_in, low_out, high_out),
        wavelength_range=(shortest, longest),
        clamped_points=int(metrics["clamped_points"]),
        sample=str(fitted_to["sample"]),
        dataset_hash=str(fitted_to["dataset_sha256"]),
        points=int(fitted_to["points"]),
        aperture=float(fitted_to["aperture_deg"]),
        colour_difference={
            kind: {name: float(v) for name, v in values.items()} for kind, values in metrics["dE00"].items()
        },
        conductor=_stored_conductor(document["conductor"]) if "conductor" in document else None,
        albedo=_stored_albedo(document["albedo"]) if "albedo" in document else None,
        software=str(document["software"]["version"]),
    )


def _stored_comparison(part: dict[str, Any]) -> Comparison:
    return Comparison(str(part["simpler_model"]), float(part["BIC_falls_by"]), float(part["mean_dE00_falls_by"]))


def _stored_conductor(part: dict[str, Any]) -> Conductor:
    wavelengths, n, k = (np.array(part[name], dtype=float) for name in ("wavelength_nm", "n", "k"))
    return Conductor(str(part["name"]), wavelengths, n, k)


def _stored_albedo(part: dict[str, Any]) -> Albedo:
    wavelengths, values, u = (np.array(part[name], dtype=float) for name in ("wavelength_nm", "r_d", "u_r_d"))
    return Albedo(wavelengths, values, u)


def _document(text: str, schema: str) -> dict[str, Any]:
    """The JSON object of the wanted schema and version, with NaN where it says null."""
    try:
        document = json.loads(text, parse_constant=_refuse_constant)
    except ValueError as fault:
        raise InputError(f"This is not a fit file: it is no valid JSON ({fault}).") from fault
    if not isinstance(document, dict) or document.get("schema") != schema:
        raise InputError(f'This is not a fit file: it should be a JSON object whose "schema" is "{schema}".')
    if document.get("schema_version") != SCHEMA_VERSION:
        raise InputError(
            f"This fit file has schema version {document.get('schema_version')}; "
            f"this software reads version {SCHEMA_VERSION}."
        )
    return cast(dict[str, Any], _with_nan(document))


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not JSON")


def _with_nan(value: Any) -> Any:
    """The same structure with NaN for null."""
    if value is None:
        return math.nan
    if isinstance(value, dict):
        return {key: _with_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_nan(item) for item in value]
    return value
