"""Which directions a scan measures next, as a function of what stands in the database.

The next batch of a sample is planned while its last point is still being measured: from all points before that one, and
from the knowledge that it is on its way. A resumed scan asks the same and gets the same.
"""

from dataclasses import dataclass, field

import numpy as np

from goniometer.campaigns.campaign import Campaign
from goniometer.geometry import Geometry
from goniometer.plans.plan import Measured, Reached, expected_total, first_points, next_points, reached, spot_points
from goniometer.plans.plan_spec import PlanSpec, reference_points
from goniometer.plans.sweep import Swept
from goniometer.radiometry.calibration import band_values, certificate_of
from goniometer.radiometry.raw import Dark, RawScan, Shot, read_raw
from goniometer.radiometry.response import Response, response
from goniometer.scans.duration import EARLIER, Foreseen
from goniometer.scans.prescan import swept
from goniometer.storage.records import Point, Scan
from goniometer.storage.store import Store

TYPICAL_REFINEMENT = 1.4
"""Points of a sample over points of its coarse pass, before anything is known about it."""

CONFIRMING = 3
"""Batches, of one point for each incident angle, that confirm what is known after the coarse pass; on simulated
materials it takes two to six (`tests/benchmarks/time_left.py`)."""

_FINISHED = {"done", "failed", "skipped"}
_WHY = {
    "accuracy": "that is what was asked for",
    "noise": "the noise of the points supports no more",
    "step": "directions lie as close as they may",
    "grid": "the grid is complete",
    "points": "the points that it may have are measured",
    "seconds": "the time that it may take is over",
}
"""Why a sampling ended, in words."""


@dataclass(frozen=True)
class Batches:
    """What decides the directions of one scan.

    Methods raise `CalibrationError` where the points that were measured cannot be calibrated, and `StoreError`.
    """

    store: Store
    scan: Scan
    campaign: Campaign
    spec: PlanSpec
    response: Response | None
    """Of the instrument; None for the reference scan, which finds it."""
    kept: dict[tuple[int, ...], list[Swept]] = field(default_factory=dict, compare=False)
    """What sweeps tell, by the ids of all exposures that say so: these never change, and it takes a while to find."""

    def look(self, points: list[Point]) -> tuple[list[Geometry], Foreseen]:
        """What `next` gives, and how many points the scan will have, as far as that is known."""
        return self.next(points), self.foreseen(points)

    def next(self, points: list[Point]) -> list[Geometry]:
        """The next batch when `points` are finished; empty when the scan is complete.

        The last point may be under way: then empty means that nothing can be said before it is finished.
        """
        if self.scan.kind == "sample":
            batch = next_points(
                self.spec, *self._known(self.scan, points[:-1]), pending=[p.geometry for p in points[-1:]]
            )
            if batch or not points or points[-1].status not in _FINISHED:
                return batch
            return next_points(self.spec, *self._known(self.scan, points))
        if points:
            return []
        if self.scan.kind == "reference":
            return reference_points(self.spec, self.campaign.reference.step)
        assert self.campaign.homogeneity is not None  # or there were no such scan
        sample = self.store.scans(self.scan.campaign_id)[self.scan.number - 1]
        seen, _ = self._known(sample, self.store.points(sample.id))
        return spot_points(seen, self.campaign.homogeneity.points)

    def foreseen(self, points: list[Point]) -> Foreseen:
        """How many points the scan will have: as its own plan foresees, or as its like before that is known."""
        if self.scan.kind != "sample":
            count = len(points) or len(self.next(points))
            return Foreseen(count, count, count)
        coarse = len(first_points(self.spec))
        finished = [p for p in points if p.status in _FINISHED]
        if self.spec.mode == "uniform":
            return Foreseen(coarse, coarse if self.spec.most_seconds is None else len(points), coarse)
        if len(finished) >= coarse:
            foreseen = expected_total(self.spec, self._known(self.scan, finished)[0])
            # the plan does not foresee the batches that confirm what it believes, nor what they bring to light
            batch = len(self.spec.theta_in)
            total = max(foreseen + batch, coarse + CONFIRMING * batch)
            high = total + CONFIRMING * batch + max(foreseen - len(points), 0)
            limit = self.spec.most_points or high
            return Foreseen(*(min(each, limit) for each in (total, len(points), high)))
        most = max(round(EARLIER[1] * len(self.spec.theta_in)), coarse)
        others = [s for s in self.store.scans(self.scan.campaign_id) if s.kind == "sample" and s.outcome == "completed"]
        typical = round(TYPICAL_REFINEMENT * coarse)
        if others:
            typical = round(sum(len(self.store.points(s.id)) for s in others) / len(others))
        limit = self.spec.most_points or most
        return Foreseen(*(min(each, limit) for each in (typical, coarse, most)))

    def accuracy(self) -> str:
        """What accuracy a sample's sampling has reached, and why it ended, as a sentence; empty for other scans."""
        if self.scan.kind != "sample":
            return ""
        return in_words(reached(self.spec, *self._known(self.scan, self.store.points(self.scan.id))))

    def _known(self, scan: Scan, points: list[Point]) -> tuple[list[Measured], list[Swept]]:
        """What the plan may know of `points`: bands of those that are done, the place of failed ones, and the sweeps.

        A sweep belongs to the points of its incident angle: what is planned before any of these is finished must not
        depend on whether the sweep is.
        """
        nothing = np.full(1, np.nan)
        if not any(p.status == "done" for p in points):
            return [Measured(p.geometry, nothing, nothing, p.seconds) for p in points if p.status in _FINISHED], []
        assert self.response is not None  # there are samples
        raw = read_raw(self.store, scan.id)
        values, noise = band_values(raw, self.response)
        known = {geometry: (v, u) for geometry, v, u in zip(raw.planned, values, noise, strict=True)}
        seen = []
        for point in points:
            if point.status in _FINISHED:
                value, noise = known[point.geometry] if point.status == "done" else (nothing, nothing)
                seen.append(Measured(point.geometry, value, noise, point.seconds))
        visited = {p.geometry.theta_in for p in seen}
        return seen, [s for s in self._swept(raw, self.response) if s.theta_in in visited]

    def _swept(self, raw: RawScan, known: Response) -> list[Swept]:
        shots: list[Shot | Dark] = [*(s.shot for s in raw.sweeps), *raw.darks, *raw.stray]
        key = tuple(i for shot in shots for i in shot.ids)
        if key not in self.kept:
            self.kept.clear()
            self.kept[key] = swept(raw, known, self.spec)
        return self.kept[key]


def batches(store: Store, scan: Scan, campaign: Campaign, spec: PlanSpec) -> Batches:
    """What decides the directions of `scan`; the reference scan must be complete before a sample.

    Raises `CertificateError` and `CalibrationError` as `response`, and `StoreError`.
    """
    known = None
    if scan.kind != "reference":
        reference = store.reference_scan(scan.id)
        known = response(read_raw(store, reference.id), certificate_of(store, scan.campaign_id))
    return Batches(store, scan, campaign, spec, known)


def in_words(found: Reached) -> str:
    """How accurate a sampling is, and why it ended."""
    if not np.isfinite(found.error):
        return f"{found.points} points: too few to say how well the BRDF is known between them."
    why = "" if found.stopped is None else f"; {_WHY[found.stopped]}"
    return (
        f"{found.points} points: between them ln(1 + cos(theta_in) BRDF) is known to {found.error:.2g} (rms) and "
        f"colours to a mean dE00 of {found.colour_error:.2g}{why}."
    )
