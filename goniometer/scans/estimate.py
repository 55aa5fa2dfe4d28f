"""How much longer a running scan will take, from what its points have taken so far."""

from collections.abc import Sequence
from dataclasses import astuple
from itertools import pairwise

from goniometer.bench.route import Motion
from goniometer.campaigns.campaign import Integration
from goniometer.geometry import Geometry
from goniometer.scans.auxiliary import Auxiliary
from goniometer.scans.duration import FEWEST, Foreseen, Visit, dead_time, expected, latest, remaining, visits
from goniometer.storage.records import Expected, ExposureTime
from goniometer.storage.store import Store

NOTHING = Expected(0.0, 0.0, 0.0)


class Estimate:
    """What is foreseen of one scan. All that it learns from is in the database, so a resumed scan foresees the same."""

    def __init__(self, store: Store, scan_id: int, motion: Motion, policy: Integration, budget: float | None) -> None:
        """`policy` says how the points are exposed, and `budget` how many seconds they may take in all."""
        self._store = store
        self._scan_id = scan_id
        self._motion = motion
        self._policy = policy
        self._budget = budget
        self._exposures: list[ExposureTime] = []
        self._visits: list[Visit] = []
        self._batch: list[Geometry] = []
        self._moving: list[float] = []
        self.total = Foreseen(0, 0, 0)
        """Points that there will be."""
        self.remaining = NOTHING
        """Time at the bench to go."""

    @property
    def dead_time(self) -> float | None:
        """Mean seconds at a point beyond its moves and integration; None until a few points have told."""
        return dead_time(self._visits)

    def begin(self, batch: Sequence[Geometry], total: Foreseen, done: int, auxiliary: Auxiliary) -> None:
        """Take up a batch, empty when the scan is complete, after `done` points of about `total`."""
        least = done + len(batch)
        self._batch = list(batch)
        self._moving = [0.0, *(self._motion.seconds(a, b) for a, b in pairwise(batch))]
        self.total = Foreseen(*(max(count, least) for count in astuple(total))) if batch else Foreseen(*[done] * 3)
        self.remaining = NOTHING
        self.update(len(batch), done, auxiliary)

    def update(self, pending: int, done: int, auxiliary: Auxiliary) -> None:
        """Estimate anew when so many points of the batch are left, and `done` of the scan are finished.

        When none are left what comes next is not known yet, and the estimate stays as it was.
        """
        if not pending:
            return
        last = self._exposures[-1].id if self._exposures else 0
        # of no more than the latest, or each point of a long scan would take longer than the one before
        self._exposures = [*latest([*self._exposures, *self._store.exposure_times(self._scan_id, last)])]
        seen = {each.point_id for each in self._exposures if each.point_id is not None}
        points = self._store.points(self._scan_id, seen)
        self._visits = visits(points, self._exposures, self._motion)
        path = self._batch[len(self._batch) - pending :]
        if len(self._visits) >= FEWEST:
            time = remaining(self._visits, self._batch, self._moving, pending, self.total, done)
        else:
            time = expected(path, self._motion, self._policy)
            more = [(count - done) / len(path) for count in astuple(self.total)]
            time = Expected(time.seconds * more[0], time.low * more[1], time.high * more[2])
        time += auxiliary.to_come(path, time)
        if self._budget is not None:
            left = max(self._budget - self._store.bench_seconds(self._scan_id), 0.0)
            time = Expected(*(min(each, left) for each in astuple(time)))
        self.remaining = time
