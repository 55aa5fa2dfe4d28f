"""What models cost and how right they are: evaluation, bytes, and an image of a simple scene."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from analysis.choices import BRDF_MODELS
from analysis.colour import colour_differences
from analysis.costs.fits import Tell
from analysis.costs.renders import render_chart
from analysis.fits.by_name import fit_models, local_fit_for
from analysis.reflectance.directions import Directions, round_aperture, through_aperture
from analysis.reflectance.fresnel import Conductor
from analysis.scenes.brdf_table import reference_table
from analysis.scenes.choose import NODES
from analysis.scenes.ladder import DIELECTRIC_FITS, METAL_FITS, Rung, guides, ladder, roughness, table_rung
from analysis.scenes.rays import trace
from analysis.scenes.scene import Camera, Light, Scene, Shape
from analysis.scenes.vertices import Vertices, display_for, image
from analysis.tradeoff import Axis, Candidate, Chart, Choice, Use, race
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset

SCENE = Scene(
    camera=Camera(position=(0.0, -6.0, 2.5), field_of_view=26.0, pixels=(48, 48)),
    material=(Shape(sphere=1.0),),
    lights=(Light(sun=(-0.6, -0.5, 0.9)), Light(sky=(0.6, 0.25))),
)
"""A sphere under a sun and a sky."""

SAMPLES = 32
"""Of a pixel."""

_EVALUATED = 20_000
_BYTES = 8
_FAMILIES = {"lambert": "no lobe", "tinted": "no shift", "cook-torrance": "no shift", "dielectric": "no shift"}
_FAMILIES |= {"table": "table"}


def model_charts(
    dataset: Dataset, metal: Conductor, dielectric: bool, rounds: int, tell: Tell, *, rendering: bool
) -> list[Chart]:
    """The ladder of models made of every second point of `dataset`: cost against colour error.

    Colours are compared with the points between, which no model has seen, and in an image with that of a table of all
    points, shaded here and, with `rendering`, rendered by Mitsuba. Raises `FitError`, `OutOfRange` and
    `CalibrationError` as fits and tables do, and `RenderError`.
    """
    order = np.lexsort((dataset.theta_out, dataset.theta_in))
    seen, held_out = dataset.at_points(np.sort(order[::2])), dataset.at_points(np.sort(order[1::2]))
    names = DIELECTRIC_FITS if dielectric else METAL_FITS
    tell("models: fits and tables")
    fits = fit_models(seen, local_fit_for(seen, names, metal), names, metal)
    alpha = roughness(fits)
    half, whole = (reference_table(each, alpha, guides(fits)).table for each in (seen, dataset))
    vertices = trace(SCENE, alpha, SAMPLES)
    rungs = (*ladder(vertices, whole, NODES, fits, metal), table_rung(half))
    charts = [
        *_evaluation_charts(held_out, vertices, rungs, rounds, tell),
        _image_chart(dataset.sample, vertices, rungs, table_rung(whole), rounds, tell),
    ]
    if not rendering:
        tell("Mitsuba is not installed, so renderings are left out; the extra is called render.")
        return charts
    return [*charts, render_chart(dataset.sample, SCENE, vertices, rungs, table_rung(whole), alpha, rounds, tell)]


def _evaluation_charts(
    held_out: Dataset, vertices: Vertices, rungs: tuple[Rung, ...], rounds: int, tell: Tell
) -> list[Chart]:
    few = Directions(*(np.resize(cosine, _EVALUATED) for cosine in vertices.directions))
    at = np.array([550.0])
    candidates = [
        Candidate(
            rung.name, _words(rung), _family(rung), _evaluating(rung, few, at), share=_EVALUATED * 1e-9, use=_use(rung)
        )
        for rung in rungs
    ]
    usable = held_out.at_points(np.flatnonzero(held_out.usable))
    errors = [_colour_error(usable, rung) for rung in rungs]
    sizes = [_BYTES * rung.parameters(NODES.size) for rung in rungs]
    timed = race(candidates, rounds, tell)
    what = (
        f"{held_out.sample}; models are made of every second point, and compared at the {usable.theta_in.size} between "
        f"them, through the aperture, under D65. Colours of Lambert's and the tinted model are those that send back as "
        f"much light of a sun and a sky as the measurement does."
    )
    colour = Axis("mean dE00 at points between", "")
    return [
        Chart(
            "model-evaluation",
            "Models: time of an evaluation against error of the colours",
            f"{what} Time: one direction at one wavelength, of {_EVALUATED} at once.",
            Axis("time of an evaluation", "ns"),
            colour,
            tuple(
                replace(each.choice(lambda _: 0.0, {"bytes": size}), error=error)
                for each, error, size in zip(timed, errors, sizes, strict=True)
            ),
        ),
        Chart(
            "model-bytes",
            "Models: bytes against error of the colours",
            f"{what} Bytes: {_BYTES} for every number, colours at {NODES.size} wavelengths.",
            Axis("size", "bytes"),
            colour,
            tuple(
                Choice(rung.name, _words(rung), _family(rung), size, size, size, error, use=_use(rung))
                for rung, error, size in zip(rungs, errors, sizes, strict=True)
            ),
        ),
    ]


def _image_chart(
    sample: str, vertices: Vertices, rungs: tuple[Rung, ...], table: Rung, rounds: int, tell: Tell
) -> Chart:
    """`table` is what the others are compared with."""
    candidates = [
        Candidate(rung.name, _words(rung), _family(rung), _shading(rung, vertices), use=_use(rung))
        for rung in (*rungs, table)
    ]
    timed = race(candidates, rounds, tell)
    right = timed[-1].results[-1].mean(axis=0)
    display = display_for(vertices, right)

    def error(halves: FloatArray) -> float:
        return float(display.difference(halves.mean(axis=0), right).mean())

    return Chart(
        "shading",
        "Shading: our time for an image against its colour error",
        f"{sample}: a sphere under a sun and a sky, {vertices.columns} × {vertices.rows} pixels, {SAMPLES} samples "
        f"each, {NODES.size} wavelengths; the ways of the light are found once and are the same for all. Error: mean "
        f"dE00 of the material's pixels against the table of all points, which takes {timed[-1].middle:.2g} s.",
        Axis("time of an image", "s"),
        Axis("mean dE00 of the image", ""),
        tuple(each.choice(error) for each in timed[:-1]),
    )


def _evaluating(rung: Rung, directions: Directions, at: FloatArray) -> Callable[[int], FloatArray]:
    return lambda _: rung.model(directions, at)


def _shading(rung: Rung, vertices: Vertices) -> Callable[[int], FloatArray]:
    return lambda _: image(vertices, rung.model, NODES)


def _colour_error(dataset: Dataset, rung: Rung) -> float:
    """Mean dE00 of a model, through the aperture, to what was measured."""
    aperture = round_aperture(dataset.aperture) if dataset.aperture else round_aperture(0.0, rings=1, spokes=1)
    through = through_aperture(dataset.theta_in, dataset.theta_out, aperture)
    points, nodes = through.cos_o.shape
    flat = Directions(*(np.broadcast_to(cosine, (points, nodes)).ravel() for cosine in through))
    values = rung.model(flat, NODES).reshape(points, nodes, NODES.size)
    brdf = np.einsum("pnw,n->pw", values, aperture.weights)
    fitted = np.stack([np.interp(dataset.wavelengths, NODES, row) for row in brdf])
    return float(np.nanmean(colour_differences(dataset.brdf, fitted, dataset.wavelengths, dataset.theta_in).absolute))


def _words(rung: Rung) -> str:
    shape = f"directions by {', '.join(rung.shape)}" if rung.shape else "no parameter of direction"
    numbers = "1 number" if rung.per_wavelength == 1 else f"{rung.per_wavelength} numbers"
    return shape + f", {numbers} for each wavelength" * bool(rung.per_wavelength)


def _use(rung: Rung) -> Use:
    """A model that can be fitted is; what else stands on the ladder comes of a choice."""
    if rung.name in BRDF_MODELS:
        return Use("fit", {"model": rung.name, "engine": "fast"})
    return Use("choose", note="It is made where a scene is looked at, and chosen where it will do.")


def _family(rung: Rung) -> str:
    return _FAMILIES.get(rung.name, "with shift")
