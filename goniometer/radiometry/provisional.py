"""The BRDF of the point that a scan measured last, while the scan goes on.

It is calibrated as the whole scan will be (`goniometer.radiometry.calibration`), from the point, its neighbours at the
same incident angle, and all darks, stray light and looks at the lamp so far. What comes later can still change it: a
look at the lamp after the point, and neighbours that are measured nearer to it, whose slope says what errors of the
angles do. The light by which wavelengths are weighted within a bin is that of the panel at this incident angle only,
which moves them by some picometres.
"""

from dataclasses import dataclass

import numpy as np

from goniometer.campaigns.material_file import material_file
from goniometer.certificates.certificate import Override, check_validity
from goniometer.datasets.dataset import Dataset
from goniometer.errors import CalibrationError
from goniometer.geometry import Geometry
from goniometer.radiometry.calibration import calibrate, certificate_of, within_table
from goniometer.radiometry.raw import read_raw
from goniometer.radiometry.response import STANDARD
from goniometer.storage.records import Point
from goniometer.storage.store import Store

BESIDE = 2
"""Neighbours on either side that tell how the BRDF changes; at the end of a series both are asked for."""


@dataclass(frozen=True)
class Newest:
    """The point of a scan that was measured last."""

    point: Point
    dataset: Dataset
    """Of this point alone."""
    neighbours: int
    """Other points that tell how the BRDF changes with theta_out; without any, errors of angles are not known."""


def newest_brdf(store: Store, scan_id: int) -> Newest:
    """The BRDF of the point of a scan that was measured last, with what is known of its uncertainty so far.

    Raises `NotInStore` before the scan has begun, `CertificateError` as
    `goniometer.radiometry.calibration.calibrate_scan` does, and `CalibrationError` where nothing was measured yet, or
    the scan is that of the reference itself.
    """
    scan = store.scan(scan_id)
    if scan.kind == "reference":
        raise CalibrationError(f"Scan {scan_id} is that of the reference panel, whose BRDF the certificate tells")
    done = [p for p in store.points(scan_id) if p.status == "done"]
    if not done:
        raise CalibrationError(f"Scan {scan_id} has no measured point yet; wait for the first one")
    last = done[-1]
    near = _beside(done, last)
    reference_scan = store.reference_scan(scan_id)
    alike = [p.id for p in store.points(reference_scan.id) if _same_incidence(p.geometry, last.geometry)]
    reference = read_raw(store, reference_scan.id, only=alike)
    sample = read_raw(store, scan_id, only=[p.id for p in near])
    certificate = certificate_of(store, scan.campaign_id)
    stated = store.campaign(scan.campaign_id).reference.override
    check_validity(certificate, reference.day, None if stated is None else Override(stated.name, stated.reason))
    since = store.scans(scan.campaign_id)[reference_scan.number + 1 : scan.number]
    watched = len(sample.monitors) > 1
    between = [read_raw(store, s.id, only=()) for s in since if watched and s.outcome == "completed"]
    settings = within_table(material_file(scan.material), STANDARD)
    dataset = calibrate(sample, reference, certificate, settings, between)
    return Newest(last, dataset.at_points(np.array([near.index(last)])), len(near) - 1)


def _same_incidence(a: Geometry, b: Geometry) -> bool:
    return abs(a.theta_in - b.theta_in) < 1e-6


def _beside(done: list[Point], last: Point) -> list[Point]:
    """The point `last` and its nearest neighbours at the same incident angle, in the order in which they were measured.

    A direction that was measured more than once counts as one.
    """
    alike = [p for p in done if _same_incidence(p.geometry, last.geometry)]
    angles = sorted({p.geometry.theta_out for p in alike})
    here = angles.index(last.geometry.theta_out)
    wanted = angles[max(here - BESIDE, 0) : here + BESIDE + 1]
    return [p for p in alike if p.geometry.theta_out in wanted]
