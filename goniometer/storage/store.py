"""The database: campaigns, scans, points and raw exposures, and the datasets, fits and exports made from them.

It is the only place where a run is remembered. Every writing method is one committed transaction that is on
the disk when the method returns, so a process may be killed at any instant; a point and its exposures are
written together or not at all.
"""

from collections.abc import Collection, Sequence
from typing import Literal

from sqlalchemy import func, insert, select, update

from drivers.interfaces import Spectrum
from goniometer.bench.track import Passage
from goniometer.errors import StoreError
from goniometer.geometry import Geometry, from_stages
from goniometer.states import EXPOSURE_KINDS, ExposureKind
from goniometer.storage import tables
from goniometer.storage.archive_file import whole_exposures
from goniometer.storage.campaigns import REMAINING, Campaigns
from goniometer.storage.records import Expected, Exposure, ExposureTime, Point, exposure_row, now, to_point


class Store(Campaigns):
    """An open database; `Store.open` makes one."""

    def add_points(self, scan_id: int, geometries: Sequence[Geometry]) -> None:
        """Append a batch of the plan to a scan, in this order."""
        with self.writing() as connection:
            first = connection.execute(
                select(func.count()).select_from(tables.points).where(tables.points.c.scan_id == scan_id)
            ).scalar_one()
            connection.execute(
                insert(tables.points),
                [
                    {
                        "scan_id": scan_id,
                        "number": first + i,
                        "theta_in": geometry.theta_in,
                        "theta_out": geometry.theta_out,
                        "status": "pending",
                    }
                    for i, geometry in enumerate(geometries)
                ],
            )

    def points(self, scan_id: int, only: Collection[int] | None = None) -> list[Point]:
        """All points of a scan, or those that have `only` these ids, in the order in which the plan asked for them."""
        query = select(tables.points).where(tables.points.c.scan_id == scan_id).order_by(tables.points.c.number)
        if only is not None:
            query = query.where(tables.points.c.id.in_(only))
        return [to_point(row) for row in self.rows(query)]

    def bench_seconds(self, scan_id: int) -> float:
        """Bench time that all points of a scan have taken, seconds."""
        here = tables.points.c
        total = select(func.coalesce(func.sum(here.seconds), 0.0).label("total")).where(here.scan_id == scan_id)
        return float(self.rows(total)[0].total)

    def start_point(self, point_id: int, expected_points: int | None = None, remaining: Expected | None = None) -> None:
        """Note that a point is being measured, that this is one more attempt, and what is foreseen of its scan."""
        left = None if remaining is None else (remaining.seconds, remaining.low, remaining.high)
        with self.writing() as connection:
            connection.execute(
                update(tables.points)
                .where(tables.points.c.id == point_id)
                .values(status="running", attempts=tables.points.c.attempts + 1)
            )
            scan = select(tables.points.c.scan_id).where(tables.points.c.id == point_id).scalar_subquery()
            connection.execute(
                update(tables.scans)
                .where(tables.scans.c.id == scan)
                .values(expected_points=expected_points, **dict(zip(REMAINING, left or (None,) * 3, strict=True)))
            )

    def finish_point(
        self,
        point: Point,
        read_back: Geometry,
        spectra: Sequence[Spectrum],
        session: str,
        moment: float,
        seconds: float,
        signal_to_noise: float,
        reason: str = "",
    ) -> None:
        """Write a measured point together with its raw exposures.

        `moment` is when they were taken, on the clock of the `session` of the bench; `signal_to_noise` is the ratio
        that was reached, and `reason` says what is less than was wanted. Raises `StoreError`, and writes nothing,
        where the point is not being measured.
        """
        with self.writing() as connection:
            connection.execute(
                insert(tables.exposures),
                [exposure_row(point.scan_id, point.id, "light", read_back, session, moment, s) for s in spectra],
            )
            done = connection.execute(
                update(tables.points)
                .where(tables.points.c.id == point.id, tables.points.c.status == "running")
                .values(
                    status="done",
                    read_theta_in=read_back.theta_in,
                    read_theta_out=read_back.theta_out,
                    reason=reason,
                    seconds=tables.points.c.seconds + seconds,
                    signal_to_noise=signal_to_noise,
                    finished=now(),
                )
            )
            if done.rowcount == 0:
                raise StoreError(f"Point {point.id} in {self.where} is not being measured; let one process run it")

    def give_up_point(self, point_id: int, status: Literal["failed", "skipped"], reason: str) -> None:
        """Note that a point will not be measured, and why."""
        self._update(tables.points, point_id, status=status, reason=reason, finished=now())

    def release_points(self, scan_id: int) -> None:
        """Make points pending again: what was being measured when a run stopped, and what failed in it."""
        with self.writing() as connection:
            connection.execute(
                update(tables.points)
                .where(tables.points.c.scan_id == scan_id, tables.points.c.status.in_(("running", "failed")))
                .values(status="pending")
            )

    def add_exposures(
        self,
        scan_id: int,
        kind: ExposureKind,
        spectra: Sequence[Spectrum],
        session: str,
        moment: float,
        geometry: Geometry | None = None,
    ) -> None:
        """Write exposures of a scan that belong to no point: darks, stray light, monitors.

        `moment` is when they were taken, on the clock of the `session` of the bench; `geometry` where the stages stood,
        None for darks.
        """
        with self.writing() as connection:
            connection.execute(
                insert(tables.exposures),
                [exposure_row(scan_id, None, kind, geometry, session, moment, s) for s in spectra],
            )

    def add_sweep(self, scan_id: int, sample_angle: float, passages: Sequence[Passage], session: str) -> None:
        """Write all readings of one sweep of the arm, with the sample stage at `sample_angle`, degrees.

        Each has the moment of its own middle, on the clock of the `session` of the bench.
        """
        with self.writing() as connection:
            connection.execute(
                insert(tables.exposures),
                [
                    exposure_row(
                        scan_id,
                        None,
                        "sweep",
                        from_stages(sample_angle, p.start),
                        session,
                        p.moment,
                        p.spectrum,
                        from_stages(sample_angle, p.stop).theta_out,
                    )
                    for p in passages
                ],
            )

    def exposures(
        self,
        scan_id: int,
        kinds: Collection[ExposureKind] = EXPOSURE_KINDS,
        points: Collection[int] | None = None,
    ) -> list[Exposure]:
        """All raw exposures of a scan that are of these kinds, in the order in which they were written.

        With `points`, light of the points with these ids only. Raises `RawDamaged` and `ArchiveMissing`.
        """
        here = tables.exposures.c
        query = select(tables.exposures).where(here.scan_id == scan_id, here.kind.in_(kinds)).order_by(here.id)
        if points is not None:
            query = query.where(here.point_id.is_(None) | here.point_id.in_(points))
        return whole_exposures(self, self.rows(query))

    def exposure_times(self, scan_id: int, after: int = 0) -> list[ExposureTime]:
        """When, where and for how long all raw exposures of a scan were taken whose id is greater than `after`."""
        here = tables.exposures.c
        query = (
            select(
                here.id, here.kind, here.point_id, here.theta_in, here.theta_out, here.session, here.integration_time
            )
            .where(here.scan_id == scan_id, here.id > after)
            .order_by(here.id)
        )
        return [
            ExposureTime(
                row.id,
                row.kind,
                row.point_id,
                None if row.theta_in is None else Geometry(row.theta_in, row.theta_out),
                row.session,
                row.integration_time,
            )
            for row in self.rows(query)
        ]
