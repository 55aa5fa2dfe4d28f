"""What can be asked of a running service: one description of every call, for the client that waits and the other.

A call is made of what it asks and of how its answer is read, and is nothing before a client carries it out::

    with Client("http://127.0.0.1:8000", token) as bench:
        for row in bench.every(calls.datasets(sample="Sample 1")):
            print(bench(calls.models(row.id)).best)

Angles are degrees, wavelengths nanometres, BRDF 1/sr; answers are the models that the service itself writes.
"""

from typing import Any, Literal
from urllib.parse import quote

from api.bodies.access import Me
from api.bodies.analyses import ChoiceView, Ensemble, StabilityMap, Tradeoff
from api.bodies.base import Page
from api.bodies.bench import BenchState, Expose, Jog
from api.bodies.calibration import CertificateRow, CertificateView, CharacterisationView, History, Reference
from api.bodies.campaigns import CampaignDetail, CampaignView, EntryView, PreviewView, Verdict
from api.bodies.datasets import Checks, DatasetDetail, DatasetRow, Lineage, SampleRow, SampleView, UncertaintyBudget
from api.bodies.fits import ExportView, FitRow, FormatView, Ladder
from api.bodies.jobs import (
    ChooseArguments,
    DoctorArguments,
    ExportAsked,
    HowAsked,
    ImportAsked,
    JobView,
    RecalibrationAsked,
    StabilityArguments,
    State,
    TradeoffArguments,
    Upload,
)
from api.bodies.plots import Distributions, InPlaneMap, PointSpectrum, Slopes
from api.bodies.scans import NewestBrdf, PointDetail, PointView, ScanView
from api.bodies.service import About
from api.call import MOST, OCTETS, Call, Spectra, floats, get, post, read_spectra, reader, two_halves
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Kind

# The service and the bench


def about() -> Call[About]:
    """What the service is, and which bench it drives."""
    return get("/api/about", About)


def me() -> Call[Me]:
    """Who asks, and what they may do."""
    return get("/api/me", Me)


def instrument() -> Call[BenchState]:
    """What the bench is and does now."""
    return get("/api/instrument", BenchState)


def order(what: Literal["connect", "disconnect", "home", "stop"]) -> Call[BenchState]:
    """Let the bench do something; `stop` ends whatever moves."""
    return post(f"/api/instrument/{what}", BenchState)


def jog(to: Jog) -> Call[BenchState]:
    """Turn the stages; answers when they rest."""
    return post("/api/instrument/jog", BenchState, to)


def expose(how: Expose) -> Call[BenchState]:
    """Read a spectrum, which `spectrum` gives then."""
    return post("/api/instrument/expose", BenchState, how)


def spectrum() -> Call[tuple[FloatArray, FloatArray]]:
    """Wavelengths, nm, and raw counts [pixels] of the last spectrum."""
    return Call("GET", "/api/instrument/spectrum", two_halves, accept=OCTETS)


# Campaigns, the queue and what was measured


def validate(campaign: dict[str, Any]) -> Call[Verdict]:
    """Whether a campaign could be measured."""
    return post("/api/campaigns/validate", Verdict, campaign)


def preview(campaign: dict[str, Any]) -> Call[PreviewView]:
    """What a campaign will do; nothing moves."""
    return post("/api/campaigns/preview", PreviewView, campaign)


def campaigns() -> Call[Page[CampaignView]]:
    """Campaigns that were begun, oldest first."""
    return get("/api/campaigns", Page[CampaignView], limit=MOST)


def campaign(number: int) -> Call[CampaignDetail]:
    """A campaign that was begun, and its scans."""
    return get(f"/api/campaigns/{number}", CampaignDetail)


def queue(*, finished: bool = False) -> Call[Page[EntryView]]:
    """What is to be measured, in its order; or what was, newest first."""
    return get("/api/queue", Page[EntryView], finished=finished, limit=MOST)


def entry(number: int) -> Call[EntryView]:
    """One entry of the queue."""
    return get(f"/api/queue/{number}", EntryView)


def enqueue(campaign: dict[str, Any] | str, start_after: str | None = None) -> Call[EntryView]:
    """Append a campaign, as an object or as YAML; it is measured once it is started."""
    return post("/api/queue", EntryView, {"campaign": campaign, "start_after": start_after})


def entry_do(number: int, what: Literal["start", "pause", "resume", "abort", "mounted"]) -> Call[EntryView]:
    """Let an entry start, pause, go on or end, or say that the sample it asks for is mounted."""
    return post(f"/api/queue/{number}/{what}", EntryView)


def scans(campaign: int | None = None) -> Call[Page[ScanView]]:
    """Scans, those of one campaign or all."""
    return get("/api/scans", Page[ScanView], campaign=campaign, limit=MOST)


def scan(number: int) -> Call[ScanView]:
    """One scan."""
    return get(f"/api/scans/{number}", ScanView)


def points(scan: int) -> Call[Page[PointView]]:
    """The points of a scan."""
    return get(f"/api/scans/{scan}/points", Page[PointView], limit=MOST)


def newest_brdf(scan: int) -> Call[NewestBrdf]:
    """The BRDF of the point of a scan that was measured last, provisional while the scan goes on."""
    return get(f"/api/scans/{scan}/brdf", NewestBrdf)


def measured_point(number: int) -> Call[PointDetail]:
    """A measured point, and the ids of its exposures."""
    return get(f"/api/points/{number}", PointDetail)


def counts(exposure: int) -> Call[FloatArray]:
    """Raw counts [pixels] of an exposure."""
    return Call("GET", f"/api/exposures/{exposure}", lambda response: floats(response.content), accept=OCTETS)


# Samples and datasets


def samples() -> Call[Page[SampleRow]]:
    """All samples, in alphabetical order."""
    return get("/api/samples", Page[SampleRow], limit=MOST)


def sample(name: str) -> Call[SampleView]:
    """A sample and its datasets."""
    return get(f"/api/samples/{quote(name, safe='')}", SampleView)


def datasets(
    sample: str | None = None,
    campaign: int | None = None,
    kind: Kind | None = None,
    flag: str | None = None,
    since: str | None = None,
    until: str | None = None,
    operator: str | None = None,
    passed: bool | None = None,
) -> Call[Page[DatasetRow]]:
    """Datasets, newest first; `flag` e.g. "below-noise", times in ISO 8601."""
    asked = {"sample": sample, "campaign": campaign, "kind": kind, "flag": flag, "since": since, "until": until}
    asked |= {"operator": operator, "passed": passed}
    return get("/api/datasets", Page[DatasetRow], limit=MOST, **asked)


def dataset(number: int) -> Call[DatasetDetail]:
    """A dataset as it opens."""
    return get(f"/api/datasets/{number}", DatasetDetail)


def spectra(dataset: int) -> Call[Spectra]:
    """All spectra of a dataset as arrays."""
    return Call("GET", f"/api/datasets/{dataset}/spectra", read_spectra, accept=OCTETS)


def colour_map(dataset: int, *, filled: bool = True) -> Call[InPlaneMap]:
    """The in-plane map, with what can be said of the directions that were not measured."""
    return get(f"/api/datasets/{dataset}/map", InPlaneMap, filled=filled)


def point(dataset: int, number: int) -> Call[PointSpectrum]:
    """The spectrum of a point with its fits and flags; points count from 0."""
    return get(f"/api/datasets/{dataset}/points/{number}", PointSpectrum)


def slopes(dataset: int) -> Call[Slopes]:
    """Slopes of all spectra, and of the models."""
    return get(f"/api/datasets/{dataset}/slopes", Slopes)


def distributions(dataset: int, wavelength: float | None = 600.0, *, filled: bool = True) -> Call[Distributions]:
    """The BRDF over theta_out at a wavelength, nm; None: as bright as the eye sees it."""
    asked = {"quantity": "luminance"} if wavelength is None else {"quantity": "wavelength", "wavelength": wavelength}
    return get(f"/api/datasets/{dataset}/distributions", Distributions, filled=filled, **asked)


def models(dataset: int) -> Call[Ladder]:
    """The newest fit of every model, simplest first."""
    return get(f"/api/datasets/{dataset}/models", Ladder)


def checks(dataset: int) -> Call[Checks]:
    """Sanity checks and flags."""
    return get(f"/api/datasets/{dataset}/checks", Checks)


def budget(
    dataset: int, theta_in: float | None = None, theta_out: float | None = None, wavelength: float | None = None
) -> Call[UncertaintyBudget]:
    """The uncertainty budget of the value nearest to a direction and wavelength."""
    asked = {"theta_in": theta_in, "theta_out": theta_out, "wavelength": wavelength}
    return get(f"/api/datasets/{dataset}/budget", UncertaintyBudget, **asked)


def lineage(dataset: int) -> Call[Lineage]:
    """Where a dataset comes from, and what was made of it."""
    return get(f"/api/datasets/{dataset}/lineage", Lineage)


def fits(dataset: int) -> Call[list[FitRow]]:
    """All fits of a dataset, oldest first."""
    return get(f"/api/datasets/{dataset}/fits", list[FitRow])


def fit_text(number: int) -> Call[str]:
    """A fit as JSON, of which `analysis.fits.fit_json.fit_from_json` makes the fit again bit for bit."""
    return Call("GET", f"/api/fits/{number}", lambda response: response.text)


def formats() -> Call[list[FormatView]]:
    """All formats of exports."""
    return get("/api/exports/formats", list[FormatView])


def exports(dataset: int) -> Call[list[ExportView]]:
    """All files that were written from a dataset, oldest first."""
    return get(f"/api/datasets/{dataset}/exports", list[ExportView])


def export_file(number: int) -> Call[bytes]:
    """The file of an export."""
    return Call("GET", f"/api/exports/{number}/file", lambda response: response.content, accept="*/*")


# Calibration


def certificates() -> Call[list[CertificateRow]]:
    """All known certificates, newest first."""
    return get("/api/certificates", list[CertificateRow])


def certificate(sha256: str) -> Call[CertificateView]:
    """A certificate with what it certifies."""
    return get(f"/api/certificates/{sha256}", CertificateView)


def hand_in_certificate(name: str, text: str) -> Call[CertificateView]:
    """Hand in a certificate, the text of a CSV file."""
    read, query = reader(CertificateView), {"name": name}
    return Call("POST", "/api/certificates", read, query, text.encode(), "text/csv")


def references() -> Call[Page[Reference]]:
    """Scans of the reference panel with the drift of the lamp, newest first."""
    return get("/api/references", Page[Reference])


def history(limit: int = 60) -> Call[History]:
    """How the bench has changed over the newest scans."""
    return get("/api/history", History, limit=limit)


def characterisations() -> Call[list[CharacterisationView]]:
    """What was measured of the bench itself, newest first."""
    return get("/api/characterisations", list[CharacterisationView])


# Analyses


def tradeoff_charts(job: int) -> Call[Tradeoff]:
    """The charts of a job, with how to ask for each way oneself."""
    return get(f"/api/tradeoff/{job}", Tradeoff)


def stability_map(job: int) -> Call[StabilityMap]:
    """The map of a job."""
    return get(f"/api/stability/{job}", StabilityMap)


def ensemble(job: int, regime: str, level: str, method: str) -> Call[Ensemble]:
    """The runs behind a cell of the map."""
    return get(f"/api/stability/{job}/ensemble", Ensemble, regime=regime, level=level, method=method)


def choice(job: int) -> Call[ChoiceView]:
    """What a job has chosen, and why."""
    return get(f"/api/choose/{job}", ChoiceView)


# Jobs


def doctor(how: DoctorArguments | None = None) -> Call[JobView]:
    """Examine every device of a bench that is not connected."""
    return post("/api/instrument/doctor", JobView, how or DoctorArguments())


def fit(dataset: int, how: HowAsked | None = None) -> Call[JobView]:
    """Fit a dataset anew."""
    return post(f"/api/datasets/{dataset}/fits", JobView, how or HowAsked())


def export(dataset: int, what: ExportAsked) -> Call[JobView]:
    """Write a dataset in a format for others."""
    return post(f"/api/datasets/{dataset}/exports", JobView, what)


def report(dataset: int) -> Call[JobView]:
    """Write the report of a dataset."""
    return post(f"/api/datasets/{dataset}/report", JobView)


def upload(name: str, content: bytes) -> Call[Upload]:
    """Send a file that is to be imported."""
    return Call("POST", "/api/uploads", reader(Upload), {"name": name}, content, OCTETS)


def import_file(asked: ImportAsked) -> Call[JobView]:
    """Make a dataset of what was uploaded."""
    return post("/api/datasets/import", JobView, asked)


def recalibrate(dataset: int, how: RecalibrationAsked) -> Call[JobView]:
    """Calibrate the raw data of a dataset anew."""
    return post(f"/api/datasets/{dataset}/recalibrate", JobView, how)


def tradeoff(asked: TradeoffArguments) -> Call[JobView]:
    """Chart speed against accuracy on the machine of the service."""
    return post("/api/tradeoff", JobView, asked)


def stability(asked: StabilityArguments) -> Call[JobView]:
    """Map where fits break and whether they say so."""
    return post("/api/stability", JobView, asked)


def choose(asked: ChooseArguments) -> Call[JobView]:
    """The simplest model that a scene needs."""
    return post("/api/choose", JobView, asked)


def jobs(*states: State, kind: str | None = None) -> Call[Page[JobView]]:
    """Jobs, newest first: those in one of the states, or all."""
    return get("/api/jobs", Page[JobView], state=list(states) or None, kind=kind, limit=MOST)


def job(number: int) -> Call[JobView]:
    """A job."""
    return get(f"/api/jobs/{number}", JobView)


def job_result(number: int) -> Call[dict[str, Any]]:
    """What came of a job; null is no value."""
    return get(f"/api/jobs/{number}/result", dict[str, Any])


def job_page(number: int) -> Call[str]:
    """The HTML page that a job made."""
    return Call("GET", f"/api/jobs/{number}/page", lambda response: response.text, accept="text/html")


def job_again(number: int) -> Call[JobView]:
    """Run a job anew that is over."""
    return post(f"/api/jobs/{number}/again", JobView)


def cancel(number: int) -> Call[JobView]:
    """End a job, whatever it is doing."""
    return Call("DELETE", f"/api/jobs/{number}", reader(JobView))
