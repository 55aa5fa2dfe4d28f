"""An unmodified RunEngine drives the simulated bench, and its documents and those of the database are valid."""

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bluesky.plan_stubs as bps
import numpy as np
import pytest
from bluesky import RunEngine
from bluesky.plans import count, grid_scan, list_scan
from bluesky.protocols import Checkable, Locatable, Movable, Pausable, Readable, Stoppable, Triggerable
from bluesky.simulators import check_limits
from bluesky.utils import FailedStatus, RunEngineInterrupted
from event_model import DocumentNames, schema_validators

from api.bluesky_devices import BlueskyBench, Done, bluesky_bench
from api.exports.bluesky import bluesky_documents, bluesky_lines
from drivers.errors import DriverError
from goniometer.errors import GeometryError, InputError
from goniometer.storage.store import Store
from tests.drawn_dataset import drawn_dataset

Documents = list[tuple[str, dict[str, Any]]]


def validate(documents: Documents) -> None:
    """As event-model does, and that the documents refer to each other as its prose says."""
    for name, document in documents:
        schema_validators[DocumentNames[name]].validate(document)
    (run,) = (document["uid"] for name, document in documents if name == "start")
    descriptors = {document["uid"]: document for name, document in documents if name == "descriptor"}
    assert {document["run_start"] for document in descriptors.values()} == {run}
    for name, document in documents:
        if name == "event":
            keys = descriptors[document["descriptor"]]["data_keys"]
            assert set(document["data"]) == set(document["timestamps"]) == set(keys)
            for key, value in document["data"].items():
                assert list(np.shape(value)) == keys[key]["shape"], key
    (stop,) = (document for name, document in documents if name == "stop")
    counts = {each["name"]: 0 for each in descriptors.values()}
    for name, document in documents:
        if name == "event":
            counts[descriptors[document["descriptor"]]["name"]] += 1
    assert stop["num_events"] == counts


@pytest.fixture(scope="module")
def bench() -> Iterator[BlueskyBench]:
    with bluesky_bench(sample="sample-1", seed=4) as bench:
        yield bench


@pytest.fixture
def engine() -> RunEngine:
    return RunEngine()


def run(engine: RunEngine, plan: Any) -> Documents:
    documents: Documents = []
    token = engine.subscribe(lambda name, document: documents.append((name, document)))
    try:
        engine(plan)
    finally:
        engine.unsubscribe(token)
    return documents


def events(documents: Documents) -> list[dict[str, Any]]:
    return [document["data"] for name, document in documents if name == "event"]


def test_every_device_is_what_the_run_engine_takes_it_for(bench: BlueskyBench) -> None:
    for device in (bench.direction, bench.sample_stage, bench.detector_stage):
        for protocol in (Movable, Readable, Stoppable, Pausable, Locatable):
            assert isinstance(device, protocol), protocol
    assert isinstance(bench.direction, Checkable)
    assert isinstance(bench.spectrometer, Triggerable)
    assert isinstance(bench.spectrometer, Readable)
    for setting in (bench.shutter, bench.integration_time):
        assert isinstance(setting, Movable)


def test_a_stock_plan_scans_directions_and_gets_valid_documents_with_units(
    bench: BlueskyBench, engine: RunEngine
) -> None:
    wanted = [(20, -60), (20, 0), (20, 20), (60, 65)]
    documents = run(engine, list_scan([bench.spectrometer], bench.direction, wanted))
    validate(documents)
    found = events(documents)
    read = [(data["direction_theta_in"], data["direction_theta_out"]) for data in found]
    assert np.allclose(read, wanted, atol=0.05)
    # the lobe of a rough metal lies at the mirror direction, far from it there is less light
    totals = [data["spectrometer_total"] for data in found]
    assert totals[2] > totals[1] > totals[0]
    (descriptor,) = (document for name, document in documents if name == "descriptor")
    keys = descriptor["data_keys"]
    assert {name: keys[name]["units"] for name in ("direction_theta_in", "spectrometer_counts")} == {
        "direction_theta_in": "deg",
        "spectrometer_counts": "counts",
    }
    configuration = descriptor["configuration"]["spectrometer"]
    assert configuration["data_keys"]["spectrometer_wavelengths"]["units"] == "nm"
    assert len(configuration["data"]["spectrometer_wavelengths"]) == len(found[0]["spectrometer_counts"])


def test_single_stages_are_scanned_on_a_grid_and_the_other_stage_stays(bench: BlueskyBench, engine: RunEngine) -> None:
    plan = grid_scan([bench.spectrometer], bench.sample_stage, 10, 20, 2, bench.detector_stage, 30, 50, 3)
    documents = run(engine, plan)
    validate(documents)
    read = [(data["sample_stage"], data["detector_stage"]) for data in events(documents)]
    assert np.allclose(read, [(s, d) for s in (10, 20) for d in (30, 40, 50)], atol=0.05)


def test_a_dark_is_taken_behind_the_closed_shutter_with_the_wanted_time(bench: BlueskyBench, engine: RunEngine) -> None:
    def plan() -> Any:
        yield from bps.mv(bench.direction, (20, 20), bench.integration_time, 0.5)
        yield from bps.mv(bench.shutter, "closed")
        yield from count([bench.spectrometer, bench.shutter], 2)
        yield from bps.mv(bench.shutter, "open")

    found = events(run(engine, plan()))
    assert [data["spectrometer_shutter"] for data in found] == ["closed", "closed"]
    assert [data["spectrometer_integration_time"] for data in found] == [0.5, 0.5]
    (light,) = events(run(engine, count([bench.spectrometer])))
    assert np.max(light["spectrometer_counts"]) > 2 * np.max(found[0]["spectrometer_counts"])


def test_where_the_bench_cannot_measure_a_plan_fails_before_anything_moves(
    bench: BlueskyBench, engine: RunEngine
) -> None:
    run(engine, bps.mv(bench.direction, (20, 20)))
    with pytest.raises(GeometryError, match="detector would stand in the beam"):
        check_limits(list_scan([bench.spectrometer], bench.direction, [(20, 20), (20, -20)]))
    with pytest.raises(GeometryError, match="detector would stand in the beam"):
        engine(bps.mv(bench.direction, (20, -20)))
    with pytest.raises(FailedStatus) as failure:
        engine(bps.mv(bench.detector_stage, 500))
    assert isinstance(failure.value.__cause__, GeometryError | DriverError)
    for device, value in ((bench.direction, 5), (bench.integration_time, 0), (bench.shutter, "ajar")):
        with pytest.raises(InputError):
            device.set(value)
    (data,) = events(run(engine, count([bench.direction])))
    assert (data["direction_theta_in"], data["direction_theta_out"]) == pytest.approx((20, 20), abs=0.05)


def test_a_run_that_was_paused_goes_on_where_it_stood(bench: BlueskyBench, engine: RunEngine) -> None:
    wanted = [(20, 0), (20, 20), (20, 40)]
    paused = False

    def plan() -> Any:
        nonlocal paused
        for message in list_scan([bench.spectrometer], bench.direction, wanted):
            if message.command == "trigger" and not paused:
                paused = True
                yield from bps.pause()
            yield message

    documents: Documents = []
    engine.subscribe(lambda name, document: documents.append((name, document)))
    with pytest.raises(RunEngineInterrupted):
        engine(plan())
    engine.resume()
    validate(documents)
    assert [round(data["direction_theta_out"]) for data in events(documents)] == [0, 20, 40]


def test_a_command_that_fails_says_so_to_whoever_waits(bench: BlueskyBench) -> None:
    told: list[Done] = []
    done = bench.detector_stage.set(1000.0)
    done.add_callback(told.append)
    assert isinstance(done.exception(60.0), GeometryError | DriverError)
    assert (done.done, done.success) == (True, False)
    deadline = time.monotonic() + 60
    while not told and time.monotonic() < deadline:
        time.sleep(0.01)
    assert told == [done]


def test_a_scan_of_the_database_is_a_valid_stream_of_documents_with_the_same_numbers(
    small: tuple[Path, dict[str, Any]],
) -> None:
    store = Store.open(small[0] / "goniometer.db")
    # as they are in the file, read by anybody's JSON
    documents: Documents = [tuple(json.loads(line)) for line in bluesky_lines(store, 1).splitlines()]
    validate(documents)
    dataset, scan = store.dataset(1), store.scan(2)
    assert documents[0][1]["scan_id"] == scan.id
    assert documents[0][1]["content_hash"] == dataset.content_hash
    names = {document["uid"]: document["name"] for name, document in documents if name == "descriptor"}
    streams: dict[str, list[dict[str, Any]]] = {"primary": [], "exposures": []}
    for name, document in documents:
        if name == "event":
            streams[names[document["descriptor"]]].append(document)
    primary = [event["data"] for event in streams["primary"]]
    assert np.array_equal([data["theta_out"] for data in primary], dataset.theta_out)
    assert np.array_equal(np.array([data["brdf"] for data in primary], dtype=float), dataset.brdf, equal_nan=True)
    assert np.array_equal(
        np.array([data["standard_uncertainty"] for data in primary], dtype=float), dataset.u, equal_nan=True
    )
    exposures = store.exposures(scan.id)
    raw = [event["data"] for event in streams["exposures"]]
    assert np.array_equal([data["counts"] for data in raw], [exposure.counts for exposure in exposures])
    start, stop = documents[0][1]["time"], documents[-1][1]["time"]
    assert all(start <= event["time"] <= stop + 0.001 for event in streams["primary"])
    assert list(bluesky_documents(store, 1)) == list(bluesky_documents(store, 1))


def test_what_no_bench_measured_is_a_stream_of_documents_too(tmp_path: Path) -> None:
    store = Store.open(tmp_path / "a.db")
    drawn = drawn_dataset("sample-1").at_points(np.arange(6))
    drawn.brdf[2, 3] = np.nan
    dataset_id = store.add_dataset(None, drawn)
    documents: Documents = [tuple(json.loads(line)) for line in bluesky_lines(store, dataset_id).splitlines()]
    validate(documents)
    assert [data["brdf"][3] is None for data in events(documents)] == [False, False, True, False, False, False]
