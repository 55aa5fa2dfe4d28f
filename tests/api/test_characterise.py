"""The bench measures itself at the command line: what is told, kept, drawn, and pasted into the instrument file."""

import asyncio
import json
import re
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import pytest
import typer
from typer.testing import CliRunner

from api.characterise import instrument_lines, proposals
from api.commands.characterise import REQUESTS, ask_for, register
from api.service import make_bench, simulated_settings
from api.settings import InstrumentSettings, load_instrument
from goniometer.bench.instrument import Instrument
from goniometer.characterisation.alignment import Alignment
from goniometer.characterisation.characterise import Piece, measure_alignment
from goniometer.errors import RunAborted
from goniometer.storage.store import Store
from simulators.bench.imperfections import Imperfections
from simulators.bench.laboratory import simulated_laboratory
from tests.api.test_settings import BENCH

KINDS = {
    "signature": "full width at half maximum",
    "noise": "Noise over its prediction",
    "alignment": "True minus read angle",
    "repeatability": "scatter of the true angle",
    "wavelength": "To be added to the wavelengths",
}


def run(folder: Path, *arguments: str) -> str:
    """What the command prints on stdout."""
    app = typer.Typer()
    app.callback()(lambda: None)
    register(app)
    done = CliRunner().invoke(app, ["characterise", *arguments, "--database", str(folder / "bench.db")])
    assert done.exit_code == 0, done.output
    return done.stdout


@pytest.mark.parametrize("kind", KINDS)
def test_a_measurement_of_the_bench_is_told_kept_drawn_and_ready_to_be_pasted(kind: str, tmp_path: Path) -> None:
    told = run(tmp_path, kind, "--output", str(tmp_path / "figure.svg"))
    assert KINDS[kind] in told
    assert "standard uncertainties (coverage factor k = 1)" in told
    figure = (tmp_path / "figure.svg").read_text()
    assert ElementTree.fromstring(figure).tag.endswith("svg")
    assert "nan" not in figure
    store = Store.open(tmp_path / "bench.db")
    (kept,) = store.characterisations(kind)
    store.close()
    content = json.loads(kept.json)
    assert content["kind"] == kind
    assert content["uncertainties"] == "standard, k = 1"
    pasted = re.search(r"For the instrument file:\n(.*?)Wrote", told, flags=re.DOTALL)
    if kind == "signature":  # it says what the bench is like, and no key depends on it
        assert pasted is None
        return
    assert pasted is not None
    tables = tomllib.loads(pasted[1])
    (tmp_path / "bench.toml").write_text(BENCH)
    values = load_instrument(tmp_path / "bench.toml").model_dump(exclude_none=True)
    for table, keys in tables.items():
        for name, more in keys.items() if table == "stages" else [(table, keys)]:
            place = values["stages"][name] if table == "stages" else values[name]
            assert set(more) <= set(place)
            place.update(more)
    InstrumentSettings.model_validate(values)


def test_json_is_one_object_with_the_result_and_its_units(tmp_path: Path) -> None:
    content = json.loads(run(tmp_path, "wavelength", "--json"))
    assert content["units"]["wavelengths"] == "nm"
    assert content["result"]["lines"][0]["element"] == "Hg"
    assert content["proposed"]["spectrometer"]["wavelength_offset"] == pytest.approx(
        content["result"]["offset"], abs=1e-4
    )


def test_after_the_proposed_zeros_are_set_the_stages_read_the_true_angles() -> None:
    truth = Imperfections(sample_zero=0.4, detector_zero=-0.9)

    async def aligned(zeros: dict[str, dict[str, float]]) -> tuple[dict[str, dict[str, float]], list[float]]:
        with simulated_laboratory(7, imperfections=truth) as laboratory:
            values = simulated_settings(laboratory).model_dump(exclude_none=True)
            for table, keys in zeros.items():
                stage = table.removeprefix("stages.")
                values["stages"].get(stage, {}).update(keys)
            settings = InstrumentSettings.model_validate(values)
            bench = make_bench(settings, laboratory.clock, laboratory.usb_backend)
            instrument = Instrument(
                bench.sample_stage, bench.detector_stage, bench.spectrometer, bench.light, bench.clock
            )

            async def mount(piece: Piece) -> None:
                laboratory.mount(piece)

            await instrument.open()
            try:
                angles = (10.0, 30.0, 50.0)
                found = await measure_alignment(instrument, mount, mirror_angles=angles, panel_angles=(20.0,))
            finally:
                await instrument.close()
            scores = [found.sample_zero / found.u_sample_zero, found.detector_zero / found.u_detector_zero]
            return proposals(found, settings), scores

    proposed, scores = asyncio.run(aligned({}))
    assert min(map(abs, scores)) > 20
    _, scores = asyncio.run(aligned(proposed))
    assert max(map(abs, scores)) < 3


def test_a_zero_is_proposed_in_the_readings_of_a_stage_that_is_turned_round_and_geared(tmp_path: Path) -> None:
    text = BENCH.replace("[stages.detector]", "zero = 12.5\ndirection = -1\nscale = 2.0\n[stages.detector]")
    (tmp_path / "bench.toml").write_text(text)
    settings = load_instrument(tmp_path / "bench.toml")
    found = Alignment(0.3, 0.002, -0.2, 0.003, 0.0, 0.0, 1.0, 1, ())
    tables = tomllib.loads("\n".join(instrument_lines(proposals(found, settings))))
    # it reads 12.5 where it truly stands at 0.3 degrees, and 2 x 0.3 more, as it is turned round, where it stands at 0
    assert tables["stages"]["sample"]["zero"] == pytest.approx(13.1)
    assert tables["stages"]["detector"]["zero"] == pytest.approx(0.2)
    assert tables["geometry"]["u_zero"] == pytest.approx(0.003)


@pytest.mark.parametrize("piece", REQUESTS)
def test_on_a_real_bench_a_person_is_asked_for_each_piece(piece: Piece, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", None)
    with pytest.raises(RunAborted, match=re.escape(REQUESTS[piece][0])):
        asyncio.run(ask_for(piece))


def test_a_figure_of_another_kind_is_refused_before_anything_moves(tmp_path: Path) -> None:
    app = typer.Typer()
    app.callback()(lambda: None)
    register(app)
    database, figure = str(tmp_path / "bench.db"), str(tmp_path / "figure.png")
    refused = CliRunner().invoke(app, ["characterise", "wavelength", "--database", database, "--output", figure])
    assert "end its name in .svg" in str(refused.exception)
    assert not (tmp_path / "bench.db").exists()
