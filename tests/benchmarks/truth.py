"""What a stored point ought to be: a direction of the plan, and what the bench would have read without noise."""

from collections import Counter
from collections.abc import Iterator
from functools import partial

import numpy as np

from drivers.arrays import CountArray, FloatArray
from goniometer.campaigns.campaign import Campaign
from goniometer.geometry import Geometry
from goniometer.plans.plan import next_points
from goniometer.plans.plan_spec import monitor_direction, plan_spec, reference_points
from goniometer.scans.exposure import ladder
from goniometer.storage.records import Exposure, Point, Scan
from goniometer.storage.store import Store
from simulators.bench.imperfections import drawn
from simulators.bench.optics import FULL_SCALE, GAIN, READ_NOISE, STATED, OpticalBench, positioning_error
from simulators.devices.clock import SimulatedClock

AT_PLAN = 0.02
"""Degrees between the planned angle of a stage and the one read back."""
COLD = -10.0
"""Degrees Celsius of the detector."""


class _Standing:
    """An axis that stands."""

    def __init__(self, angle: float) -> None:
        self.angle = angle

    def true_positions(self, moments: FloatArray) -> FloatArray:
        """[moments] degrees."""
        return np.full(moments.shape, self.angle)


class Truth:
    """The laboratory of `seed`, as it would be seen without noise."""

    def __init__(self, seed: int) -> None:
        self._axes = _Standing(0.0), _Standing(0.0)
        self._bench = OpticalBench(
            SimulatedClock(),
            seed=seed,
            sample_axis=self._axes[0],
            detector_axis=self._axes[1],
            imperfections=drawn(seed, STATED),
        )
        self._errors = positioning_error(seed, "sample stage"), positioning_error(seed, "detector stage")

    def mount(self, material: str) -> None:
        """Lay a material on the bench."""
        self._bench.mount(material)

    def light(self, geometry: Geometry) -> FloatArray:
        """[pixels] counts a second with the stages sent to `geometry`, the errors of their positions included."""
        sample, detector = round(geometry.sample_angle, 4), round(geometry.detector_angle, 4)
        on_stage = self._bench.mounted, self._bench.spot
        self._axes[0].angle = sample + self._errors[0](sample, *on_stage)
        self._axes[1].angle = detector + self._errors[1](detector, *on_stage, sample)
        return self._bench.light(self._bench.geometry())

    def deviation(self, counts: CountArray, integration_time: float, light: FloatArray | float) -> float:
        """How many standard deviations the worst pixel of a spectrum is off; 0 where it is rightly saturated."""
        dark = integration_time * self._bench.dark_current(COLD)
        bright = np.broadcast_to(np.asarray(integration_time * light), dark.shape)
        expected = self._bench.as_read(bright) + dark + self._bench._offset
        noise = np.sqrt((bright + dark) / GAIN + READ_NOISE**2 + 1 / 12)
        off = np.abs(counts - np.minimum(expected, FULL_SCALE)) / noise
        return float(np.max(np.where((counts == FULL_SCALE) & (expected > FULL_SCALE), 0.0, off)))


def wrong(store: Store, scan: Scan, truth: Truth, *, sigma: float = 6.0) -> list[str]:
    """What is wrong with the stored points and exposures of a scan, as sentences; all of them where it is complete."""
    campaign = store.campaign(scan.campaign_id)
    spec = plan_spec(campaign)
    of_reference = scan.kind == "reference"
    planned = reference_points(spec, campaign.reference.step) if of_reference else next_points(spec, [])
    points = store.points(scan.id)
    found = Counter(point.geometry for point in points)
    where = partial("{0} at theta_in {1.theta_in:g}, theta_out {1.theta_out:g}: {2}".format, scan.sample)
    faults = [where(g, f"planned {n} times") for g, n in found.items() if n > 1]
    faults += [where(g, "never planned") for g in found if g not in planned]
    if scan.outcome == "completed":
        faults += [where(g, "missing") for g in planned if g not in found]
    exposures: dict[int | None, list[Exposure]] = {}
    for exposure in store.exposures(scan.id):
        exposures.setdefault(exposure.point_id, []).append(exposure)
    truth.mount(scan.material)
    for point in points:
        mine = exposures.pop(point.id, [])
        faults += [where(point.geometry, text) for text in _wrong_point(point, mine, campaign, truth, sigma)]
        scans = campaign.reference.scans if of_reference else campaign.integration.scans
        if len(mine) != (scans if point.status == "done" else 0):
            faults.append(where(point.geometry, f"is {point.status} and has {len(mine)} exposures instead of {scans}"))
    for other in exposures.pop(None, []):
        if other.integration_time not in ladder(campaign.integration):
            faults.append(f"{scan.sample}: {other.kind} of {other.integration_time:g} s, which nobody asks for")
        off = truth.deviation(other.counts, other.integration_time, _light_of(other, campaign, truth))
        if off > sigma:
            faults.append(
                f"{scan.sample}: {other.kind} of {other.integration_time:g} s is {off:.1f} standard deviations off"
            )
    return faults + [f"{scan.sample}: exposures of no point" for _ in exposures]


def _light_of(exposure: Exposure, campaign: Campaign, truth: Truth) -> FloatArray | float:
    """[pixels] counts a second that an exposure of no point should show."""
    stood = exposure.geometry
    if stood is None:
        return 0.0
    if exposure.kind == "monitor":
        return truth.light(monitor_direction(plan_spec(campaign)))
    theta_in = min(campaign.theta_in, key=lambda t: abs(t - stood.theta_in))
    return truth.light(Geometry(theta_in, -theta_in))


def lost(store: Store, scan: Scan) -> list[str]:
    """Why points of a scan were given up."""
    return [f"{p.geometry}: {p.reason}" for p in store.points(scan.id) if p.status in {"failed", "skipped"}]


def _wrong_point(
    point: Point, exposures: list[Exposure], campaign: Campaign, truth: Truth, sigma: float
) -> Iterator[str]:
    if point.status != "done" or point.read_back is None:
        return
    plan, read = point.geometry, point.read_back
    for wanted, reached in ((plan.sample_angle, read.sample_angle), (plan.detector_angle, read.detector_angle)):
        if not abs(wanted - reached) <= AT_PLAN:
            yield f"a stage read back {reached:.3f}° for {wanted:.3f}°"
    times = {exposure.integration_time for exposure in exposures}
    if len(times) > 1 or not times <= set(ladder(campaign.integration)):
        yield f"integration times {times} s, which nobody asked for"
    light = truth.light(plan)
    for exposure in exposures:
        off = truth.deviation(exposure.counts, exposure.integration_time, light)
        if off > sigma:
            yield f"its counts are {off:.1f} standard deviations off"
        if abs(exposure.detector_temperature - COLD) > 0.5:
            yield f"taken at {exposure.detector_temperature:.1f} °C"
