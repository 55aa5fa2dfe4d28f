"""Stages with backlash arrive upwards, whatever their family, and moves take as long as the plan thinks."""

import asyncio
from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from drivers.interfaces import RotationStage
from drivers.k10cr1 import K10CR1
from drivers.oriental_az import OrientalAZ
from drivers.owis import OwisPS
from drivers.qepro import QEPro, QEProLight
from drivers.smc100 import SMC100
from goniometer.bench.instrument import Instrument
from goniometer.bench.route import approach, travel
from goniometer.bench.safety import Forbidden, check_standing, grown, raised, safe_path
from goniometer.errors import GeometryError
from goniometer.geometry import Geometry
from goniometer.plans.plan_spec import PlanSpec
from goniometer.plans.reach import check_plan
from simulators.bench.laboratory import COUNTS_PER_DEGREE, simulated_laboratory

DRIVERS: dict[str, Callable[..., RotationStage]] = {
    "smc100": SMC100,
    "oriental-az": OrientalAZ,
    "owis": partial(OwisPS, axis=1, counts_per_degree=COUNTS_PER_DEGREE),
    "k10cr1": K10CR1,
}
BACKLASH = (1.0, 2.5)
SETTLING = (0.4, 0.7)
LIMITS = ((-5.0, 90.0), (-90.0, 175.0))


def on_bench(family, work, **options):
    """Run `work(instrument, moves)` on an open bench; `moves` are the targets of both axes since it was opened."""
    moves = ([], [])

    async def run(laboratory):
        clock, driver = laboratory.clock, DRIVERS[family]
        qepro = QEPro("QE Pro", clock, usb_backend=laboratory.usb_backend)
        instrument = Instrument(
            driver("sample stage", laboratory.sample_stage_url, clock, limits=LIMITS[0]),
            driver("detector stage", laboratory.detector_stage_url, clock, limits=LIMITS[1]),
            qepro,
            QEProLight(qepro),
            clock,
            **({"backlash": BACKLASH, "settling": SETTLING} | options),
        )
        await instrument.open()
        for axis, targets in zip(laboratory.bench._axes, moves, strict=True):
            axis.move = partial(lambda move, seen, target: (seen.append(target), move(target)), axis.move, targets)
        try:
            await work(instrument, moves)
        finally:
            await instrument.close()

    with simulated_laboratory(1, stages=(family, family)) as laboratory:
        asyncio.run(run(laboratory))


@pytest.mark.parametrize("family", DRIVERS)
def test_every_target_is_approached_upwards_and_only_once_beyond_it(family):
    async def work(instrument, moves):
        for geometry in (
            Geometry(20.0, 10.0),
            Geometry(20.0, 30.0),
            Geometry(20.0, -50.0),
            Geometry(10.0, -40.0),
            Geometry(10.0, 0.0),
        ):
            await instrument.arm.goto(geometry)
        assert moves[0] == pytest.approx([20.0, 9.0, 10.0], abs=0.01)
        assert moves[1] == pytest.approx([30.0, 50.0, -32.5, -30.0, 10.0], abs=0.01)

    on_bench(family, work)


def test_a_stage_of_which_nobody_knows_from_where_it_came_takes_up_its_backlash():
    async def work(instrument, moves):
        await instrument.arm.goto(Geometry(0.5, 1.0 + 5.0))  # right after homing, near the marks
        assert moves[0] == pytest.approx([-0.5, 0.5], abs=0.01)
        await instrument.safe()
        await instrument.arm.goto(Geometry(0.5, 6.0))
        assert moves[0][2:] == pytest.approx([-0.5, 0.5], abs=0.01)
        assert moves[1] == pytest.approx([6.5, 4.0, 6.5], abs=0.01)

    on_bench("smc100", work)


@pytest.mark.parametrize("family", DRIVERS)
@pytest.mark.parametrize("slack", [(0.0, 0.0), BACKLASH], ids=["without backlash", "with backlash"])
def test_a_path_takes_the_time_that_the_plan_expects(family, slack):
    random = np.random.default_rng(8)
    path = [Geometry(20.0, float(a)) for a in [*random.uniform(0, 80, 15), *sorted(random.uniform(-15, 80, 15))]]

    async def work(instrument, moves):
        await instrument.arm.goto(path[0])
        begin = instrument.clock.now()
        for geometry in path[1:]:
            await instrument.arm.goto(geometry)
        taken, foreseen = instrument.clock.now() - begin, travel(path, instrument.arm.motion).seconds
        # what is left is the way in which drivers ask whether a motion has ended
        assert foreseen <= taken + 1e-6
        assert taken == pytest.approx(foreseen, rel=0.02)
        for axis, stage in enumerate((instrument.arm.motion.sample, instrument.arm.motion.detector)):
            assert (stage.backlash, stage.settling) == (slack[axis], SETTLING[axis])

    on_bench(family, work, backlash=slack)


def test_what_could_only_be_reached_through_a_forbidden_region_is_refused_before_anything_moves():
    region = Forbidden(sample=(30.0, 40.0), detector=(50.0, 60.0))

    async def work(instrument, moves):
        for refused in (Geometry(40.5, 15.0), Geometry(35.0, 27.0)):
            with pytest.raises(GeometryError, match="forbidden region with the sample stage at 30 to 41"):
                await instrument.arm.goto(refused)
        with pytest.raises(GeometryError, match=r"outside -87\.5 to 175"):
            await instrument.arm.face_source(0.0, -87.6)
        with pytest.raises(GeometryError, match="forbidden region with the sample stage at 30 to 41"):
            check_plan(PlanSpec((40.5,)), instrument.arm.limits, instrument.arm.forbidden)
        assert moves == ([], [])
        await instrument.arm.goto(Geometry(41.0, 15.0))

    on_bench("smc100", work, forbidden=(region,))


def test_no_way_of_a_stage_with_backlash_leads_through_a_forbidden_region():
    random = np.random.default_rng(3)
    allowed = 0
    for _ in range(3000):
        corner, size = random.uniform(0, 60, 2), random.uniform(1, 30, 2)
        region = Forbidden(sample=(corner[0], corner[0] + size[0]), detector=(corner[1], corner[1] + size[1]))
        start, end = (tuple(float(v) for v in np.round(random.uniform(0, 90, 2))) for _ in range(2))
        try:
            for place in (start, end):
                check_standing(place, raised(LIMITS, BACKLASH), grown([region], BACKLASH))
            safe_path(start, end, grown([region], BACKLASH))
        except GeometryError:
            continue
        allowed += 1
        first = approach(start, end, (None, None), BACKLASH)
        way = [start, *safe_path(start, first, [region]), *([end] if first != end else [])]
        for a, b in pairwise(way):
            inside = [
                min(a[i], b[i]) < high and max(a[i], b[i]) > low
                for i, (low, high) in enumerate((region.sample, region.detector))
            ]
            assert not all(inside)
        assert all(b >= a for a, b in zip(first, end, strict=True))
    assert allowed > 1500
