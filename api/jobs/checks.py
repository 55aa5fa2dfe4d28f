"""What can be known to be wrong with a job before the work begins."""

from analysis.choices import MODELS
from analysis.reflectance.fresnel import load_conductor
from api.bodies.base import Asked
from api.bodies.jobs import (
    ChooseArguments,
    ExportArguments,
    FitArguments,
    OfDataset,
    RecalibrateArguments,
    StabilityArguments,
    TradeoffArguments,
)
from api.exports.formats import FORMATS, package_terms
from api.jobs.foreign_scene import check_foreign_scene
from api.results.certificates import known_certificate
from api.results.products import conductor_name
from api.results.quality import settings_of
from goniometer.errors import InputError
from goniometer.storage.store import Store
from simulators.stability.ensemble import jobs


def check(store: Store, asked: Asked) -> None:
    """Raise `NotInStore` for what is not there, and `InputError` or `UnknownConductor` for a name that nothing has."""
    if isinstance(asked, OfDataset):
        store.entry(asked.dataset)
    match asked:
        case FitArguments():
            if asked.model is not None and asked.model not in MODELS:
                raise InputError(f'There is no model "{asked.model}"; there are {", ".join(MODELS)}.')
            load_conductor(*conductor_name(asked.conductor))
        case ExportArguments():
            _check_export(asked)
        case RecalibrateArguments():
            settings_of(asked.without, asked.also)
            if asked.certificate is not None:
                known_certificate(store, asked.certificate)
        case TradeoffArguments(dataset=int(dataset)):
            store.entry(dataset)
        case StabilityArguments():
            jobs(asked.regimes, asked.methods, 1)
        case ChooseArguments(scene_format="mitsuba"):  # it may reach for files
            check_foreign_scene(asked.scene)


def _check_export(asked: ExportArguments) -> None:
    if asked.format not in FORMATS:
        raise InputError(f'There is no format "{asked.format}"; there are {", ".join(FORMATS)}.')
    known = FORMATS[asked.format].uses
    if unknown := sorted(asked.options.model_dump(exclude_defaults=True).keys() - set(known)):
        told = f"An export to {asked.format} has no option {unknown[0]}; it has {', '.join(known) or 'none'}."
        raise InputError(told)
    if asked.format == "package":
        package_terms(asked.options.license, tuple(asked.options.creators))
