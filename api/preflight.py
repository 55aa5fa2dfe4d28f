"""Whether a campaign can be measured, found out before a device is opened."""

import os
from collections.abc import Callable
from datetime import UTC, date, datetime
from pathlib import Path

import numpy as np

from api.settings import InstrumentSettings
from api.written import make_folder, slug
from goniometer.bench.safety import Forbidden, grown, raised
from goniometer.campaigns.campaign import Campaign, Sample
from goniometer.campaigns.material_file import Content, material_file
from goniometer.certificates.certificate import NOMINAL_SRS99, Override
from goniometer.certificates.certificate_file import certificate_csv, parse_certificate, read_certificate
from goniometer.errors import CampaignError, GoniometerError, StoreFull
from goniometer.geometry import LARGEST_ANGLE
from goniometer.plans.plan_spec import plan_spec, reference_points
from goniometer.plans.reach import check_plan
from goniometer.radiometry.calibration import check_certificate
from goniometer.radiometry.response import STANDARD
from goniometer.storage.store import Store
from simulators.materials.materials import PANEL_CERTIFICATE, material
from simulators.materials.tabulated import Tabulated, check_reach

SAMPLE_STAGE_LIMITS = (0.0, LARGEST_ANGLE + 5.0)
DETECTOR_STAGE_LIMITS = (-LARGEST_ANGLE, 2 * LARGEST_ANGLE)
"""Degrees: all that in-plane geometry can ask for, and nothing beyond."""


def with_materials(campaign: Campaign) -> Campaign:
    """The campaign with what is in every file that is a material of the simulated bench.

    Raises `InputError` for a material that there is not, and for directions of which a table knows nothing.
    """

    def known(sample: Sample) -> Sample:
        lying, file = material(sample.material), material_file(sample.material)
        if file is None or not isinstance(lying, Tabulated):
            return sample
        check_reach(lying, campaign.theta_in, (campaign.outgoing.start, campaign.outgoing.stop))
        content = Content(lying.sha256, float(lying.wavelengths[0]), float(lying.wavelengths[-1]))
        return sample.model_copy(update={"material": str(file._replace(content=content))})

    return campaign.model_copy(update={"samples": tuple(map(known, campaign.samples))})


def preflight(store: Store | None, campaign: Campaign, settings: InstrumentSettings | None) -> list[str]:
    """Why `run` would refuse `campaign` before a device is opened, as sentences; none where it would not.

    Without a `store`, what only a database can tell is left out.
    """
    checks: list[Callable[[], object]] = [
        lambda: _check_certificate(store, campaign, panel_certificate(campaign, settings)),
        lambda: _check_folders(store, campaign),
        lambda: _check_reach(campaign, settings),
        lambda: _check_begun(store, campaign, settings),
    ]
    found: dict[str, None] = {}  # more than one reads the certificate
    for check in checks:
        try:
            check()
        except GoniometerError as error:
            found[str(error)] = None
    return list(found)


def check_all(store: Store, campaign: Campaign, certificate: str | None, settings: InstrumentSettings | None) -> None:
    """Raise what is wrong with `campaign`, first of all its `certificate`; no device is opened."""
    _check_certificate(store, campaign, certificate)
    _check_folders(store, campaign)
    _check_reach(campaign, settings)


def panel_certificate(campaign: Campaign, settings: InstrumentSettings | None) -> str | None:
    """Text of the certificate that the campaign names, or of that of the simulated panel; None where there is none.

    Raises `CertificateError` where the file cannot be read.
    """
    path = campaign.reference.certificate
    if path is not None:
        return read_certificate(Path(path))
    return certificate_csv(PANEL_CERTIFICATE) if settings is None else None


def check_output(folder: Path) -> None:
    """Make the folder of results; raises `StoreFull` where nothing could be written into it later."""
    make_folder(folder)
    if not os.access(folder, os.W_OK | os.X_OK):
        raise StoreFull(f"{folder} cannot be written to; make it writable or name another folder.")


def _check_begun(store: Store | None, campaign: Campaign, settings: InstrumentSettings | None) -> None:
    """Raise `InputError` for a wrong material, `CampaignError` where the campaign has begun with other content."""
    if settings is None:
        campaign = with_materials(campaign)
    if store is not None:
        store.check_begun(campaign, panel_certificate(campaign, settings))


def _check_certificate(store: Store | None, campaign: Campaign, text: str | None) -> None:
    """Raise `CertificateError` where a certificate cannot calibrate what the campaign wants to measure."""
    where = campaign.reference.certificate or "the simulated panel"
    override = campaign.reference.override
    begun: list[str | None] = []
    if store is not None:
        own = [campaign_id for campaign_id, name in store.campaigns().items() if name == campaign.name]
        begun = [store.scans(campaign_id)[0].started for campaign_id in own]
    day = next((date.fromisoformat(started[:10]) for started in begun if started), datetime.now(UTC).date())
    check_certificate(text, where, None if override is None else Override(override.name, override.reason), day)
    panel = NOMINAL_SRS99 if text is None else parse_certificate(text, where)
    points = reference_points(plan_spec(campaign), campaign.reference.step)
    theta_in, theta_out = np.array([(point.theta_in, point.theta_out) for point in points]).T
    panel.brdf(theta_in, theta_out, np.array([STANDARD.lowest, STANDARD.highest]))


def _check_reach(campaign: Campaign, settings: InstrumentSettings | None) -> None:
    """Raise `GeometryError` where the bench cannot take all that the campaign may ask for; no device is opened."""
    limits = SAMPLE_STAGE_LIMITS, DETECTOR_STAGE_LIMITS
    forbidden: tuple[Forbidden, ...] = ()
    if settings is not None:
        stages, backlash = settings.stages, settings.backlash
        limits = raised((stages.sample.standing(limits[0]), stages.detector.standing(limits[1])), backlash)
        forbidden = grown([each.region for each in settings.forbidden], backlash)
    check_plan(plan_spec(campaign), limits, forbidden)


def _check_folders(store: Store | None, campaign: Campaign) -> None:
    """Raise `CampaignError` where results of two scans, or of two campaigns, would go into one folder."""
    folders: dict[str, str] = {}
    for name in (name for name, sample in campaign.series if sample is not None):
        other = folders.pop(slug(name), None)
        folders[slug(name)] = name
        if other is not None:
            raise CampaignError(
                f'The samples "{other}" and "{name}" would both be kept in the folder {slug(name)}; '
                f"give one sample another name."
            )
    for name in () if store is None else store.campaigns().values():
        if name != campaign.name and slug(name) == slug(campaign.name):
            raise CampaignError(
                f'The campaigns "{name}" and "{campaign.name}" would both be kept in the folder {slug(name)}; '
                f"give this one another name."
            )
