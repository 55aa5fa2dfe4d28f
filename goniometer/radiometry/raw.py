"""All that was read from the devices in one scan, as calibration wants it."""

import datetime
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from drivers.arrays import CountArray
from goniometer.constants import Constants
from goniometer.datasets.angular import SAME_INCIDENCE
from goniometer.geometry import Geometry
from goniometer.states import EXPOSURE_KINDS, ExposureKind
from goniometer.storage.records import Exposure
from goniometer.storage.store import Store
from goniometer.uncertainty import Groups


@dataclass(frozen=True)
class Shot:
    """Spectra of one integration time, taken in a row where the stages stood."""

    geometry: Geometry
    """As the stages read it back."""
    integration_time: float
    """Seconds."""
    counts: CountArray
    """[scans, pixels]"""
    temperature: float
    """Mean detector temperature, degrees Celsius."""
    session: str
    """Of the bench that took them; moments of two sessions cannot be compared."""
    moment: float
    """When they were taken, seconds on the clock of the session."""
    ids: tuple[int, ...]
    """Of the exposures in the database, ascending: they tell the order in which shots were taken."""
    point: int | None = None
    """Number of the point in its `RawScan`; None for stray light and monitors."""


@dataclass(frozen=True)
class Sweep:
    """One reading of the detector while its arm moved at one incident angle."""

    shot: Shot
    """Of one spectrum; its geometry is that in which it began."""
    theta_out_end: float
    """Where it ended, degrees."""


@dataclass(frozen=True)
class Dark:
    """Dark spectra of one integration time, taken in a row."""

    integration_time: float
    """Seconds."""
    counts: CountArray
    """[read-outs, pixels]"""
    temperature: float
    """Mean detector temperature, degrees Celsius."""
    ids: tuple[int, ...]
    """Of the exposures in the database."""


@dataclass(frozen=True)
class RawScan:
    """All that was read from the devices in one scan; points that were not measured are absent."""

    scan_id: int
    sample: str
    diameter: float
    """Of the round sample, mm."""
    day: datetime.date
    """On which the scan began, UTC."""
    constants: Constants
    planned: tuple[Geometry, ...]
    """[points] directions as planned; they tell which points share an incident angle."""
    read_back: tuple[Geometry, ...]
    """[points] directions as the stages read them back."""
    shots: tuple[Shot, ...]
    """Of all points, in the order in which they were taken; a point has one or more, of different times."""
    darks: tuple[Dark, ...]
    stray: tuple[Shot, ...] = ()
    """With the detector in front of the source, where it sees stray light only."""
    monitors: tuple[Shot, ...] = ()
    """In one direction that is visited again and again, to see the lamp drift; in the order of time."""
    sweeps: tuple[Sweep, ...] = ()
    """Readings of the moving detector, which look for lobes between the points; in the order of time."""


def sample_visits(raw: RawScan) -> Groups:
    """[points] number, from 0, of the visit of the sample stage to an incident angle; points of one share its error.

    A visit ends where another incident angle is measured, or a monitor or stray light at another one.
    """
    places: list[tuple[int, float, int | None]] = [
        (shot.ids[0], raw.planned[shot.point].theta_in, shot.point) for shot in raw.shots if shot.point is not None
    ]
    places += [(shot.ids[0], shot.geometry.theta_in, None) for shot in (*raw.stray, *raw.monitors)]
    visits = np.zeros(len(raw.planned), dtype=np.intp)
    visit, here = -1, None
    for _, theta_in, point in sorted(places, key=lambda place: place[0]):
        if here is None or abs(theta_in - here) > SAME_INCIDENCE:
            visit, here = visit + 1, theta_in
        if point is not None:
            visits[point] = visit
    return visits


def read_raw(
    store: Store,
    scan_id: int,
    kinds: Collection[ExposureKind] = EXPOSURE_KINDS,
    only: Collection[int] | None = None,
) -> RawScan:
    """All measured points of a scan with everything that calibrates them; raises `NotInStore` before it has begun.

    Of other `kinds` of exposures there is nothing in it, nor of other points than those whose ids are in `only`.
    """
    scan = store.scan(scan_id)
    points = [p for p in store.points(scan_id) if p.status == "done" and (only is None or p.id in only)]
    number = {p.id: i for i, p in enumerate(points)}
    exposures = store.exposures(scan_id, kinds, only)
    begun = datetime.date.fromisoformat((scan.started or exposures[0].taken)[:10])
    campaign = store.campaign(scan.campaign_id)
    diameters = {sample.name: sample.diameter for sample in campaign.samples}
    of_kind = {kind: [e for e in exposures if e.kind == kind] for kind in EXPOSURE_KINDS}
    # while a scan goes on, another point may have been finished since the points were read
    light = [e for e in of_kind["light"] if e.point_id in number]
    return RawScan(
        scan_id=scan_id,
        sample=scan.name,
        diameter=campaign.reference.diameter if scan.kind == "reference" else diameters[scan.sample],
        day=begun,
        constants=store.constants(scan_id),
        planned=tuple(p.geometry for p in points),
        read_back=tuple(p.read_back for p in points if p.read_back is not None),
        shots=tuple(_shots(light, number)),
        darks=tuple(_darks(of_kind["dark"])),
        stray=tuple(_shots(of_kind["stray"], number)),
        monitors=tuple(_shots(of_kind["monitor"], number)),
        sweeps=tuple(_sweeps(of_kind["sweep"])),
    )


def _shots(exposures: list[Exposure], number: dict[int, int]) -> Iterable[Shot]:
    """What was taken in a row with one integration time."""
    for (point_id, moment, time), group in groupby(exposures, lambda e: (e.point_id, e.moment, e.integration_time)):
        members = list(group)
        geometry = members[0].geometry
        assert geometry is not None  # the tables see to it
        yield Shot(
            geometry,
            time,
            np.stack([e.counts for e in members]),
            float(np.mean([e.detector_temperature for e in members])),
            members[0].session,
            moment,
            tuple(e.id for e in members),
            None if point_id is None else number[point_id],
        )


def _sweeps(exposures: list[Exposure]) -> Iterable[Sweep]:
    for exposure in exposures:
        (shot,) = _shots([exposure], {})
        assert exposure.theta_out_end is not None  # the tables see to it
        yield Sweep(shot, exposure.theta_out_end)


def _darks(exposures: list[Exposure]) -> Iterable[Dark]:
    """What was taken in a row with one integration time."""
    for (_, time), group in groupby(exposures, lambda e: (e.moment, e.integration_time)):
        members = list(group)
        yield Dark(
            time,
            np.stack([e.counts for e in members]),
            float(np.mean([e.detector_temperature for e in members])),
            tuple(e.id for e in members),
        )
