"""The BRDF of the point that was measured last, while its scan goes on: found rarely, however many look on."""

import threading
import time

from analysis.fits.noise import flag_words
from api.bodies.base import numbers
from api.bodies.scans import NewestBrdf
from goniometer.radiometry.provisional import newest_brdf
from goniometer.storage.store import Store
from goniometer.uncertainty import PARTS

EVERY = 1.0
"""Seconds for which an answer holds; to find one takes some 0.08 s of a processor that the bench may want."""


class Newest:
    """Answers about scans that go on, each made at most once in `EVERY` for all who ask."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._lock = threading.Lock()
        self._made: tuple[float, NewestBrdf] | None = None

    def of(self, scan_id: int) -> NewestBrdf:
        """The newest point of a scan, or what was the newest `EVERY` ago; raises what `newest_brdf` raises."""
        with self._lock:  # who asks meanwhile is served with the same
            if self._made is not None:
                moment, made = self._made
                if made.scan == scan_id and time.monotonic() - moment < EVERY:
                    return made
            found = newest_view(self._store, scan_id)
            self._made = time.monotonic(), found
            return found


def newest_view(store: Store, scan_id: int) -> NewestBrdf:
    """The newest point of a scan as it is shown; raises what `newest_brdf` raises."""
    newest = newest_brdf(store, scan_id)
    dataset = newest.dataset
    present = {source.part for source in dataset.sources}
    return NewestBrdf(
        scan=scan_id,
        sample=dataset.sample,
        point=newest.point.id,
        theta_in_deg=float(dataset.theta_in[0]),
        theta_out_deg=float(dataset.theta_out[0]),
        wavelengths_nm=dataset.wavelengths.tolist(),
        brdf=numbers(dataset.brdf[0]),
        u=numbers(dataset.u[0]),
        parts=[part for part in PARTS if part in present],
        neighbours=newest.neighbours,
        flag_words=flag_words(int(dataset.flags[0])),
    )
