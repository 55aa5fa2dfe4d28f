"""Where fits fail they say so, and an ensemble that was killed goes on where it stood."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from goniometer.errors import DataFileError, InputError
from simulators.bench.measurement import Setup, measure
from simulators.choices import METHODS
from simulators.materials.materials import SAMPLES, true_brdf
from simulators.materials.specimens import Shift, Specimen, specimen_brdf
from simulators.stability.ensemble import cells, ensemble, jobs
from simulators.stability.regimes import REGIMES, case
from simulators.stability.stability import Job, run

QUICK = ("local", "global", "global-two-component", "cook-torrance", "cook-torrance-shift", "two-component")


@pytest.mark.slow
@pytest.mark.parametrize("regime", REGIMES)
def test_no_fit_is_confidently_wrong_without_a_word(regime: str) -> None:
    levels = REGIMES[regime].levels
    some = {levels[len(levels) // 2].name, levels[-1].name}
    found = [run(job) for job in jobs([regime], QUICK, 1) if job.level in some]
    assert found
    silent = [(each.job, each.z, each.reasons) for each in found if each.silent]
    assert not silent


def test_an_ordinary_measurement_is_right_and_trusted_by_every_method() -> None:
    for method in METHODS:
        found = run(Job("ordinary", "as it is", method, 3))
        assert found.trusted, found
        assert found.right == 1, found
        assert max(map(abs, found.z.values())) < 4, found


def test_a_measurement_is_wrong_by_as_much_as_it_says() -> None:
    z = []
    for seed in range(12):
        specimen, setup = Specimen("metal", Shift(1.2, 3.4)), Setup(incident=(10.0, 40.0))
        found = measure(specimen, setup, seed)
        truth = specimen_brdf(specimen, found.theta_in, found.theta_out, setup.wavelengths, 1.0)
        z.append((found.brdf - truth) / found.u)
    rms = np.sqrt(np.mean(np.square(z)))
    # all points of one measurement share errors, so there are few more than 12 independent ones
    assert 0.6 < rms < 1.5
    assert np.std([each.mean() for each in z]) > 0.2


def test_a_specimen_is_what_the_bench_would_see_of_the_same_sample() -> None:
    theta_in, theta_out = np.array([10.0, 40.0, 75.0]), np.array([-50.0, 41.0, 60.0])
    wavelengths = np.array([400.0, 600.0, 900.0])
    bench = SAMPLES["sample-4"]
    specimen = Specimen("metal", Shift(bench.h, bench.w), alpha=bench.alpha)
    expected = true_brdf(bench, theta_in, theta_out, wavelengths)
    np.testing.assert_allclose(specimen_brdf(specimen, theta_in, theta_out, wavelengths, 1.0), expected, rtol=1e-9)


def test_saturated_points_are_flagged_where_full_scale_is_known_and_too_dark_where_not() -> None:
    specimen, exposed = Specimen("metal", Shift(1.2, 3.4)), Setup(shortest=70.0, longest=70.0)
    known, unknown, sound = (
        measure(specimen, setup, 1) for setup in (exposed, replace(exposed, saturation_known=False), Setup())
    )
    lost = np.isnan(known.brdf)
    assert lost.any()
    assert not lost.all(axis=1).all()
    assert np.array_equal(lost.any(axis=1), ~known.usable)
    share = unknown.brdf[lost] / sound.brdf[lost]
    assert np.all(share < 1.02)
    assert share.min() < 0.3


def test_the_same_seed_gives_the_same_measurement() -> None:
    regime = REGIMES["outliers"]
    one, two, other = (case(regime, regime.levels[1], "global", seed).dataset.content_hash for seed in (4, 4, 5))
    assert one == two != other


def test_an_ensemble_that_was_killed_goes_on_where_it_stood(tmp_path: Path) -> None:
    wanted, file = jobs(["few points"], ["local"], 2), tmp_path / "runs.jsonl"
    with ThreadPoolExecutor(1) as executor:
        whole = list(ensemble(wanted, executor))
        list(ensemble(wanted[:4], executor, file))
        # killed while the last line was written
        lines = file.read_text()
        file.write_text(lines[:-40])
        resumed = list(ensemble(wanted, executor, file))
    assert {each.job: repr(each) for each in resumed} == {each.job: repr(each) for each in whole}
    assert len(file.read_text().splitlines()) == len(wanted)
    assert [cell.runs for cell in cells(resumed)] == [2] * len(REGIMES["few points"].levels)


def test_a_file_of_other_code_or_of_something_else_is_refused(tmp_path: Path) -> None:
    wanted, file = jobs(["few points"], ["local"], 1)[:1], tmp_path / "runs.jsonl"
    with ThreadPoolExecutor(1) as executor:
        list(ensemble(wanted, executor, file))
        file.write_text(file.read_text().replace('"code": "', '"code": "0'))
        with pytest.raises(DataFileError, match="another version"):
            list(ensemble(wanted, executor, file))
        file.write_text('{"name": "a campaign"}\n')
        with pytest.raises(DataFileError, match="Line 1"):
            list(ensemble(wanted, executor, file))


def test_an_unknown_regime_is_refused_with_the_known_ones() -> None:
    with pytest.raises(InputError, match="mirror-like"):
        jobs(["foggy"], ["local"], 1)
