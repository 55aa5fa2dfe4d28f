"""HDF5, CSV and Parquet: read by other people's readers, and read back as the very dataset that was written."""

import csv
import io
import json
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pandas
import pyarrow.parquet
import pytest

from goniometer.datasets.dataset import Check, Dataset, Flag
from goniometer.errors import DataFileError
from goniometer.files.dataset_document import LARGEST_ARRAYS
from goniometer.files.dataset_file import reloaded
from goniometer.files.dataset_hdf5 import dataset_to_hdf5
from goniometer.files.dataset_table import dataset_to_csv, dataset_to_parquet
from goniometer.uncertainty import ErrorSource
from tests.drawn_dataset import drawn_dataset

WRITERS: dict[str, Callable[[Dataset], bytes]] = {
    "hdf5": dataset_to_hdf5,
    "csv": lambda dataset: dataset_to_csv(dataset).encode(),
    "parquet": dataset_to_parquet,
}


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    """Sample 2 with all that is awkward: lacking values of both signs, minus zero, tiny numbers, flags, odd names."""
    at = np.array([0.0, 20.0, 20.0, 20.0, 60.0]), np.array([10.0, -10.0, 20.0, 20.0, 70.0])
    drawn = drawn_dataset("sample-2", seed=5, at=at)
    brdf = drawn.brdf.copy()
    brdf[0] = -np.nan  # as the processor makes it of 0 / 0
    brdf[1, :4] = [np.nan, -0.0, 5e-324, 0.1 + 0.2]
    odd = ErrorSource(
        'drift: "lamp", #1, θ', "drift", 1e-3 * np.nan_to_num(brdf), np.array([0, 1, 1, 2, 0], dtype=np.intp), True
    )
    return replace(
        drawn,
        sample='Sample "2", 50 µm #1',
        brdf=brdf,
        sources=(*drawn.sources, odd),
        flags=np.array([Flag.BEYOND_REFERENCE, 0, Flag.CLIPPED | Flag.NEGATIVE, 0, 16], dtype=np.uint16),
        checks=(
            Check("reciprocity", None, "Not known: f(20°, −10°)."),
            Check("energy", True, "Good, 0.9 ± 0.1."),
            Check("values", False, "One\nfailed."),
        ),
        lineage={"scan": 7, "exposures": [1, 2, 3], "corrections": {"dark": "made"}, "certificate_override": None},
    )


def the_same(one: Dataset, other: Dataset) -> bool:
    """Whether two datasets are the same in every bit but the files that they were read from."""
    lineage = {name: value for name, value in other.lineage.items() if name != "reloaded"}
    u = np.array_equal(one.u.view("u8"), other.u.view("u8")) or np.array_equal(one.u, other.u, equal_nan=True)
    return (
        one.content_hash == other.content_hash
        and (one.checks, one.lineage, one.kind, one.aperture) == (other.checks, lineage, other.kind, other.aperture)
        and u
        and one.flags.dtype == other.flags.dtype
        and [s.name for s in one.sources] == [s.name for s in other.sources]
    )


@pytest.mark.parametrize("name", WRITERS)
def test_a_dataset_is_the_same_after_it_was_in_a_file(dataset: Dataset, name: str) -> None:
    content = WRITERS[name](dataset)
    assert WRITERS[name](dataset) == content
    back = reloaded(Path(f"there/a.{name}"), content)
    assert back is not None
    assert the_same(dataset, back)
    origins = back.lineage["reloaded"]
    assert isinstance(origins, list)
    (origin,) = origins
    assert (origin["file"], origin["format"].lower()) == (f"a.{name}", name)
    again = reloaded(Path("b"), WRITERS[name](back))
    assert again is not None
    assert the_same(dataset, again)
    origins = again.lineage["reloaded"]
    assert isinstance(origins, list)
    assert [each["file"] for each in origins] == [f"a.{name}", "b"]


@pytest.mark.parametrize(("origin", "kind"), [({"simulated": "rays"}, "simulated"), ({"imported": "x"}, "imported")])
def test_what_was_not_measured_never_becomes_a_measurement_in_a_file(
    dataset: Dataset, origin: dict[str, object], kind: str
) -> None:
    for write in WRITERS.values():
        back = reloaded(Path("a"), write(replace(dataset, lineage=origin)))
        assert back is not None
        assert back.kind == kind


def test_a_data_frame_of_parquet_and_one_of_csv_hold_the_same_numbers_with_their_units(dataset: Dataset) -> None:
    parquet = dataset_to_parquet(dataset)
    frame = pandas.read_parquet(io.BytesIO(parquet))
    from_csv = pandas.read_csv(io.StringIO(dataset_to_csv(dataset)), comment="#")
    assert list(frame.columns)[:7] == [
        *("point", "theta_in", "theta_out", "wavelength", "brdf", "standard_uncertainty", "flags"),
    ]
    rows = list(csv.reader(line for line in dataset_to_csv(dataset).split("\n") if line and line[0] != "#"))
    assert rows[0] == list(frame.columns)
    for i, name in enumerate(list(frame.columns)[:7]):
        expected = frame[name].to_numpy(dtype=float)
        assert np.array_equal([float(row[i] or "nan") for row in rows[1:]], expected, equal_nan=True)
    assert np.array_equal(from_csv["brdf"].to_numpy(), frame["brdf"].to_numpy(), equal_nan=True)
    grid = frame.pivot(index="point", columns="wavelength", values="brdf").to_numpy()
    assert np.array_equal(grid, dataset.brdf, equal_nan=True)
    squares = frame[[name for name in frame.columns if name.startswith("u(")]].pow(2).sum(axis=1)
    known = frame["brdf"].notna()
    assert np.allclose(np.sqrt(squares[known]), frame["standard_uncertainty"][known], rtol=1e-12)
    schema = pyarrow.parquet.read_schema(io.BytesIO(parquet))
    assert schema.field("brdf").metadata[b"unit"] == b"1/sr"
    assert json.loads(schema.metadata[b"goniometer"])["flags"]["4"] == "footprint leaves the sample"


def test_a_spreadsheet_opens_the_csv_with_one_value_a_row(dataset: Dataset, tmp_path: Path) -> None:
    text = dataset_to_csv(dataset)
    table = "\n".join(line for line in text.split("\n") if not line.startswith("#"))
    found = csv.Sniffer().sniff(table[:2000])
    assert (found.delimiter, found.quotechar) == (",", '"')
    frame = pandas.read_csv(io.StringIO(table))
    frame.to_excel(tmp_path / "a.xlsx", index=False)
    book = pandas.read_excel(tmp_path / "a.xlsx")
    assert np.allclose(book["brdf"], dataset.brdf.ravel(), rtol=1e-14, atol=0, equal_nan=True)
    office = shutil.which("soffice")
    if office is None:
        return
    (tmp_path / "b.csv").write_text(text)
    subprocess.run([office, "--headless", "--convert-to", "xlsx", "b.csv"], cwd=tmp_path, check=True, timeout=120)
    assert len(pandas.read_excel(tmp_path / "b.xlsx", header=None)) == len(text.strip().split("\n"))


def test_h5py_finds_the_plot_its_units_and_the_uncertainty_where_nexus_puts_them(
    dataset: Dataset, tmp_path: Path
) -> None:
    (tmp_path / "a.h5").write_bytes(dataset_to_hdf5(dataset))
    with h5py.File(tmp_path / "a.h5") as file:
        entry = file[file.attrs["default"]]
        data = entry[entry.attrs["default"]]
        assert (entry.attrs["NX_class"], data.attrs["NX_class"]) == ("NXentry", "NXdata")
        signal, axes = data[data.attrs["signal"]], data.attrs["axes"]
        assert list(axes) == [".", "wavelength"]
        assert [data[name].attrs["units"] for name in ("theta_in", "wavelength", "brdf")] == ["deg", "nm", "1/sr"]
        assert np.array_equal(signal, dataset.brdf, equal_nan=True)
        assert np.array_equal(data["brdf_errors"], dataset.u, equal_nan=True)
        meanings = dict(zip(data["flags"].attrs["flag_masks"], data["flags"].attrs["flag_meanings"], strict=True))
        assert meanings[Flag.CLIPPED] == "footprint leaves the sample"
        sources = [entry[f"sources/{name}"] for name in entry["sources"]]
        assert [source.attrs["name"] for source in sources] == [source.name for source in dataset.sources]
        known = np.isfinite(dataset.brdf)
        total = np.sqrt(sum(source["values"][()] ** 2 for source in sources))
        assert np.allclose(total[known], dataset.u[known], rtol=1e-12)
        assert json.loads(entry["lineage"][()])["exposures"] == [1, 2, 3]
        assert list(entry["checks/passed"]) == [-1, 1, 0]


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_whose_numbers_were_changed_is_not_taken_for_the_measurement(
    dataset: Dataset, name: str, tmp_path: Path
) -> None:
    path = tmp_path / "a"
    path.write_bytes(WRITERS[name](dataset))
    if name == "hdf5":
        with h5py.File(path, "r+") as file:
            file["entry/brdf/brdf"][4, 3] *= 1.001
    elif name == "csv":
        lines = path.read_text().split("\n")
        cells = lines[-3].split(",")
        lines[-3] = ",".join([*cells[:4], "0.1234", *cells[5:]])
        path.write_text("\n".join(lines))
    else:
        table = pyarrow.parquet.read_table(path)
        brdf = table["brdf"].to_numpy().copy()
        brdf[-1] *= 1.001
        table = table.set_column(table.column_names.index("brdf"), table.schema.field("brdf"), [brdf])
        pyarrow.parquet.write_table(table, path)
    with pytest.raises(DataFileError, match="changed after it was written"):
        reloaded(path, path.read_bytes())


def test_rows_of_a_table_that_were_sorted_otherwise_are_the_same_measurement(dataset: Dataset) -> None:
    lines = dataset_to_csv(dataset).strip().split("\n")
    start = next(i for i, line in enumerate(lines) if not line.startswith("#")) + 1
    shuffled = [lines[i] for i in start + np.random.default_rng(1).permutation(len(lines) - start)]
    back = reloaded(Path("a"), "\r\n".join([*lines[:start], *shuffled]).encode())
    assert back is not None
    assert the_same(dataset, back)


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_that_is_cut_short_is_refused_with_a_sentence(dataset: Dataset, name: str) -> None:
    content = WRITERS[name](dataset)
    for part in (0.999, 0.9, 0.5, 0.1, 0.02):
        with pytest.raises(DataFileError):
            reloaded(Path("a"), content[: int(part * len(content))])


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_a_damaged_file_never_ends_in_a_traceback(dataset: Dataset, name: str) -> None:
    content = np.frombuffer(WRITERS[name](dataset), dtype=np.uint8)
    random = np.random.default_rng(7)
    for _ in range(60):
        damaged = content.copy()
        places = random.integers(20, content.size if name != "hdf5" else 6000, random.integers(1, 8))
        damaged[places] = random.integers(0, 256, places.size)
        try:
            back = reloaded(Path("a"), damaged.tobytes())
        except DataFileError:
            continue
        assert back is None or the_same(dataset, back)


def test_an_hdf5_file_cannot_make_us_open_another_file_or_unpack_without_end(dataset: Dataset, tmp_path: Path) -> None:
    secret = tmp_path / "secret.h5"
    secret.write_bytes(dataset_to_hdf5(dataset))

    def refused(change: Callable[[h5py.File], None], match: str) -> None:
        path = tmp_path / "a.h5"
        path.write_bytes(dataset_to_hdf5(dataset))
        with h5py.File(path, "r+") as file:
            change(file)
        with pytest.raises(DataFileError, match=match):
            reloaded(path, path.read_bytes())

    def link(file: h5py.File) -> None:
        del file["entry/brdf/brdf"]
        file["entry/brdf/brdf"] = h5py.ExternalLink(str(secret), "/entry/brdf/brdf")

    def link_of_group(file: h5py.File) -> None:
        del file["entry/brdf"]
        file["entry/brdf"] = h5py.SoftLink("/entry")

    def outside(file: h5py.File) -> None:
        del file["entry/brdf/brdf"]
        file["entry/brdf"].create_dataset("brdf", (5, 24), dtype="f8", external=[(str(secret), 0, 960)])

    def virtual(file: h5py.File) -> None:
        del file["entry/brdf/brdf"]
        layout = h5py.VirtualLayout((5, 24), dtype="f8")
        layout[:] = h5py.VirtualSource(str(secret), "entry/brdf/brdf", (5, 24))
        file["entry/brdf"].create_virtual_dataset("brdf", layout)

    def endless(file: h5py.File) -> None:
        del file["entry/brdf/brdf"]
        file["entry/brdf"].create_dataset("brdf", (LARGEST_ARRAYS // 8, 2), chunks=(10**6, 2), dtype="f8")

    def other_kind(file: h5py.File) -> None:
        del file["entry/lineage"]
        file["entry/lineage"] = 7

    def nothing(file: h5py.File) -> None:
        del file["entry/sample/name"]
        file["entry/sample"].create_dataset("name", (0,), dtype=h5py.string_dtype())

    def group_for_array(file: h5py.File) -> None:
        del file["entry/brdf/flags"]
        file["entry/brdf"].create_group("flags")

    def nested(file: h5py.File) -> None:
        del file["entry/lineage"]
        file["entry/lineage"] = "[" * 100_000

    for change in (other_kind, nothing, nested):
        refused(change, "cannot be read as HDF5 of a dataset")
    refused(group_for_array, "is no array")
    refused(link, "link to elsewhere")
    refused(link_of_group, "link to elsewhere")
    refused(outside, "kept elsewhere")
    refused(virtual, "kept elsewhere")
    refused(endless, "larger than 1 GB")


def test_parquet_of_others_and_of_a_later_version_are_told_from_ours(dataset: Dataset) -> None:
    buffer = io.BytesIO()
    pandas.DataFrame({"a": [1.0]}).to_parquet(buffer)
    with pytest.raises(DataFileError, match="of another program"):
        reloaded(Path("a"), buffer.getvalue())
    later = dataset_to_csv(dataset).replace("# format_version: 1", "# format_version: 2")
    with pytest.raises(DataFileError, match="version 2 of the format, but this program reads version 1"):
        reloaded(Path("a"), later.encode())
