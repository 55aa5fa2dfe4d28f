"""Where methods fail: a catalogue of regimes, most of them from the paper's own admissions.

A regime spoils an ordinary measurement of an ordinary surface in one way, by levels of severity. The surface of each
method is one that its model describes exactly (`SPECIMENS`), so that its parameters have a truth; a level says which of
them lose it where it changes the surface into one that the model does not describe.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from analysis.scenes.ladder import METAL_FITS
from goniometer.datasets.dataset import Dataset
from simulators.bench.measurement import Setup, measure
from simulators.choices import ABOUT
from simulators.materials.specimens import Retro, Shift, Specimen
from simulators.materials.surfaces import Surface

COSINE = Shift(1.2, 3.4, 0.0)
TWO = Shift(1.2, 2.5, 0.1, 0.8, 2.0, 0.2)

SPECIMENS = {
    "local": Specimen("spectra", replace(COSINE, t_y=0.1)),
    "global": Specimen("spectra", replace(COSINE, t_y=0.1)),
    "global-two-component": Specimen("spectra", TWO),
    "cook-torrance": Specimen("metal", Shift()),
    "cook-torrance-shift": Specimen("metal", COSINE),
    "two-component": Specimen("metal", TWO),
    "dielectric-shift": Specimen("dielectric", COSINE, alpha=0.4),
}
"""By model, a surface that it describes."""

SHIFT = frozenset({"h", "w", "t_y", "kappa", "sharpness", "threshold"})
EVERYTHING = SHIFT | {"alpha", "eta", "p"}

ChangeSpecimen = Callable[[Specimen], Specimen | Surface]
ChangeSetup = Callable[[Setup], Setup]
Spoil = Callable[[Dataset, np.random.Generator], Dataset]


@dataclass(frozen=True)
class Level:
    """How bad it is."""

    name: str
    specimen: ChangeSpecimen | None = None
    setup: ChangeSetup | None = None
    spoil: Spoil | None = None
    """What happens to the dataset afterwards, unknown to its uncertainties unless it says so itself."""
    lost: frozenset[str] = frozenset()
    """Parameters that have no truth any more, for a model that does not describe what is measured."""
    described_by: tuple[str, ...] = tuple(SPECIMENS)
    """Models that describe what is measured; of another, a verdict without a word of it is wrong, too."""


@dataclass(frozen=True)
class Regime:
    """A way in which a measurement is difficult."""

    name: str
    levels: tuple[Level, ...]
    """From harmless to hopeless."""
    models: tuple[str, ...] = tuple(SPECIMENS)
    """To which it applies."""

    @property
    def about(self) -> str:
        """What is difficult, in a phrase."""
        return ABOUT[self.name]


@dataclass(frozen=True)
class Case:
    """One measurement of a regime, and what is true of it."""

    dataset: Dataset
    specimen: Specimen | Surface
    truth: dict[str, float]
    """By parameter; without those that have no truth."""
    undescribed: bool
    """Whether the model cannot describe what was measured."""


def case(regime: Regime, level: Level, model: str, seed: int) -> Case:
    """The measurement of a `level` for the `model`, one of `SPECIMENS`; the same `seed` gives the same.

    Raises `OutOfRange` as `simulators.bench.measurement.measure`.
    """
    specimen: Specimen | Surface = SPECIMENS[model]
    truth: dict[str, float] = {}
    described = model in level.described_by
    if level.specimen is not None:
        specimen = level.specimen(SPECIMENS[model])
    if isinstance(specimen, Specimen):
        of_model = {"alpha": specimen.alpha, "eta": specimen.eta, "p": specimen.exponent, **vars(specimen.shift)}
        truth = {name: value for name, value in of_model.items() if described or name not in level.lost}
    setup = Setup() if level.setup is None else level.setup(Setup())
    dataset = measure(specimen, setup, seed, f"{regime.name}, {level.name}")
    if level.spoil is not None:
        dataset = level.spoil(dataset, np.random.default_rng([seed, 1]))
    return Case(dataset, specimen, truth, not described)


def _alpha(alpha: float, specimen: Specimen) -> Specimen:
    return replace(specimen, alpha=alpha)


def _shift(w: float, specimen: Specimen) -> Specimen:
    return replace(specimen, shift=replace(specimen.shift, w=w)) if specimen.shift.h else specimen


def _shifted(h: float, specimen: Specimen) -> Specimen:
    return replace(specimen, shift=replace(COSINE, h=h))


def _sharp(sharpness: float, specimen: Specimen) -> Specimen:
    return replace(specimen, alpha=0.1, shift=replace(TWO, sharpness=sharpness)) if specimen.shift.h else specimen


def _retro(width: float, specimen: Specimen) -> Specimen:
    return replace(specimen, retro=Retro(0.3, width))


def _conductor(name: str, specimen: Specimen) -> Specimen:
    return replace(specimen, conductor=name)


def _distribution(specimen: Specimen) -> Specimen:
    return replace(specimen, distribution="beckmann")


def _notch(share: float, specimen: Specimen) -> Specimen:
    return replace(specimen, notch=share)


def _compensated(kappa: float, specimen: Specimen) -> Specimen:
    return replace(specimen, alpha=0.3, shift=Shift(1.2, 2.0, 0.0, kappa, 2.0, 0.1))


def _mixture(specimen: Specimen) -> Surface:
    eta = None if specimen.law == "metal" else specimen.eta
    return Surface("mixture", specimen.alpha, specimen.shift.h, -specimen.shift.h, 0.02, eta)


def _wavelengths(lowest: float, highest: float, setup: Setup) -> Setup:
    return replace(setup, wavelengths=np.linspace(lowest, highest, setup.wavelengths.size))


def _longest(seconds: float, setup: Setup) -> Setup:
    return replace(setup, longest=seconds)


def _exposed(shortest: float, known: bool, setup: Setup) -> Setup:
    return replace(setup, shortest=shortest, longest=max(shortest, setup.longest), saturation_known=known)


def _disc(diameter: float, known: bool, setup: Setup) -> Setup:
    return replace(setup, diameter_mm=diameter, diameter_known=known)


def _few(count: int, dataset: Dataset, random: np.random.Generator) -> Dataset:
    return dataset.at_points(np.sort(random.permutation(dataset.theta_in.size)[:count].astype(np.intp)))


def _without_retro(half: float, dataset: Dataset, random: np.random.Generator) -> Dataset:
    """Nothing within `half` degrees of the lamp."""
    return dataset.at_points(np.flatnonzero(np.abs(dataset.theta_in + dataset.theta_out) >= half))


def _outliers(share: float, dataset: Dataset, random: np.random.Generator) -> Dataset:
    """Whole spectra that are too bright or too dark by a factor of three."""
    hit = random.permutation(dataset.theta_in.size)[: max(1, round(share * dataset.theta_in.size))]
    factor = np.ones(dataset.theta_in.size)
    factor[hit] = 3.0 ** random.choice([-1.0, 1.0], hit.size)
    return replace(dataset, brdf=dataset.brdf * factor[:, None])


def _spikes(share: float, dataset: Dataset, random: np.random.Generator) -> Dataset:
    """Single values that are too bright by half, as a cosmic ray makes them."""
    hit = random.random(dataset.brdf.shape) < share
    return replace(dataset, brdf=np.where(hit, 1.5 * dataset.brdf, dataset.brdf))


def _noisy(times: float, dataset: Dataset, random: np.random.Generator) -> Dataset:
    """Around lambda_n so many `times` the noise, and its uncertainty says so."""
    factor = np.where(np.abs(dataset.wavelengths - 600) < 25, times, 1.0)
    u = dataset.u_counts * np.sqrt(factor**2 - 1)
    louder = tuple(replace(s, values=s.values * factor) if s.name == "random" else s for s in dataset.sources)
    return replace(dataset, brdf=dataset.brdf + u * random.standard_normal(u.shape), sources=louder)


def _missing(dataset: Dataset, random: np.random.Generator) -> Dataset:
    return replace(dataset, brdf=np.where(np.abs(dataset.wavelengths - 600) < 45, np.nan, dataset.brdf))


_LOBES = (*METAL_FITS, "dielectric-shift")
_TWO = ("local", "global-two-component", "two-component")
_SHIFTED = tuple(model for model in SPECIMENS if model != "cook-torrance")

REGIMES = {
    regime.name: regime
    for regime in (
        Regime("ordinary", (Level("as it is"),)),
        Regime(
            "mirror-like",
            tuple(
                Level(f"alpha {alpha:g}", specimen=partial(_alpha, alpha)) for alpha in (0.05, 0.02, 0.01, 0.005, 0.002)
            ),
        ),
        Regime(
            "dim flanks",
            tuple(
                Level(f"alpha 0.05, {1e3 * seconds:g} ms", partial(_alpha, 0.05), partial(_longest, seconds))
                for seconds in (1.0, 0.1, 0.03, 0.01)
            ),
        ),
        Regime(
            "grazing footprint",
            (
                Level("15 mm, known", setup=partial(_disc, 15.0, True)),
                Level("5 mm, known", setup=partial(_disc, 5.0, True)),
                Level("15 mm, not known", setup=partial(_disc, 15.0, False)),
                Level("5 mm, not known", setup=partial(_disc, 5.0, False)),
            ),
        ),
        Regime(
            "blocked retro direction",
            (
                Level("gap of 15 deg", spoil=partial(_without_retro, 15.0)),
                Level("gap of 40 deg", spoil=partial(_without_retro, 40.0)),
                *(Level(f"peak {width:g} deg wide", partial(_retro, width)) for width in (3.0, 10.0, 30.0)),
            ),
        ),
        Regime(
            "fast transitions",
            (
                *(Level(f"w {w:g}", partial(_shift, w)) for w in (6.0, 9.0, 11.5)),
                *(
                    Level(f"sharpness {sharp:g}", partial(_sharp, sharp), lost=SHIFT | {"p"}, described_by=_TWO)
                    for sharp in (10.0, 50.0)
                ),
            ),
            _SHIFTED,
        ),
        Regime(
            "shift left out",
            tuple(Level(f"h {h:g} 1/um", partial(_shifted, h), described_by=()) for h in (0.4, 1.6)),
            ("cook-torrance",),
        ),
        Regime(
            "compensation",
            tuple(
                Level(name, partial(_compensated, kappa), lost=SHIFT | {"p"}, described_by=_TWO)
                for name, kappa in (
                    ("half", 0.5),
                    ("at normal incidence (grit 1000)", 1.0),
                    ("overdone (grit 60)", 1.5),
                )
            ),
            _SHIFTED,
        ),
        Regime(
            "bad normalisation",
            (
                Level("noise x 30", spoil=partial(_noisy, 30.0)),
                Level("missing", spoil=_missing),
                Level("from 650 nm on", setup=partial(_wavelengths, 650.0, 990.0)),
                Level("line takes 30 %", partial(_notch, 0.3)),
                Level("line takes 95 %", partial(_notch, 0.95)),
            ),
        ),
        Regime(
            "few colours",
            tuple(
                Level(f"{low:g} to {high:g} nm", setup=partial(_wavelengths, low, high))
                for low, high in ((400.0, 750.0), (450.0, 650.0), (560.0, 640.0))
            ),
        ),
        Regime(
            "wrong n and k",
            tuple(
                Level(name, partial(_conductor, page), lost=frozenset({"p"}), described_by=())
                for name, page in (
                    ("silver", "main/Ag/Johnson"),
                    ("nickel", "main/Ni/Johnson"),
                    ("gold", "main/Au/Johnson"),
                )
            ),
            ("local", "global", "global-two-component", *METAL_FITS),
        ),
        Regime(
            "wrong distribution",
            (
                Level("Beckmann", _distribution, lost=frozenset({"alpha"}), described_by=()),
                Level("mixture", _mixture, lost=EVERYTHING, described_by=()),
            ),
            _LOBES,
        ),
        Regime(
            "few points",
            tuple(Level(f"{count} points", spoil=partial(_few, count)) for count in (50, 25, 15, 10, 6)),
        ),
        Regime(
            "outliers",
            (
                Level("one spectrum x 3", spoil=partial(_outliers, 0.0)),
                Level("5 % of spectra x 3", spoil=partial(_outliers, 0.05)),
                Level("20 % of spectra x 3", spoil=partial(_outliers, 0.2)),
                Level("spikes in 1 %", spoil=partial(_spikes, 0.01)),
                Level("spikes in 10 %", spoil=partial(_spikes, 0.1)),
            ),
        ),
        Regime(
            "saturation",
            (
                Level("1.5 x full scale, flagged", setup=partial(_exposed, 20.0, True)),
                Level("5 x full scale, flagged", setup=partial(_exposed, 70.0, True)),
                Level("1.5 x full scale, unnoticed", setup=partial(_exposed, 20.0, False)),
                Level("5 x full scale, unnoticed", setup=partial(_exposed, 70.0, False)),
            ),
        ),
    )
}
"""All regimes by name."""
