"""Files made to harm who imports them: what they unpack to, whom they lead to, what a spreadsheet would run of them."""

import csv
import io
import json
import re
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
import yaml

from analysis.scenes.scene import load_scene
from api.results.imports import Request, imported_file
from goniometer.campaigns.campaign_file import load_campaign, read_campaign
from goniometer.certificates.certificate_file import parse_certificate
from goniometer.datasets.dataset import Check, Dataset
from goniometer.errors import DataFileError, InputError
from goniometer.files.bird_json import parsed_json, read_bird_json
from goniometer.files.bird_metadata import read_about
from goniometer.files.dataset_document import LARGEST_ARRAYS, document
from goniometer.files.dataset_file import reloaded
from goniometer.files.dataset_hdf5 import dataset_to_hdf5
from goniometer.files.dataset_table import dataset_to_csv, dataset_to_parquet
from goniometer.files.delimited import Meaning, read_delimited
from goniometer.files.published_json import read_published_json
from goniometer.files.raw_text import read_raw_text
from tests.drawn_dataset import drawn_dataset
from tests.little_memory import little_memory

POINTS = np.array([0.0, 20, 20, 60]), np.array([10.0, -10, 20, 70])


@pytest.fixture(autouse=True)
def _bounded() -> Iterator[None]:
    with little_memory():
        yield


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    return drawn_dataset("sample-2", seed=5, at=POINTS)


def of_zeros(octets: int) -> bytes:
    """Zeros, deflated to a thousandth."""
    packer = zlib.compressobj(9)
    return b"".join(packer.compress(bytes(1 << 24)) for _ in range(octets >> 24)) + packer.flush()


def instead(path: str, **made: object) -> Callable[[h5py.File], None]:
    """Puts another array in the place of one."""

    def change(file: h5py.File) -> None:
        del file[path]
        file.create_dataset(path, **made)

    return change


def one_text_many_times(file: h5py.File) -> None:
    """A list of texts that all name the same megabytes."""
    one = file.create_dataset("one", (1,), h5py.string_dtype(), chunks=(1,))
    one[0] = "x" * 3_000_000
    file.flush()
    named = one.id.read_direct_chunk((0,))[1]
    instead("entry/checks/message", shape=(1000,), dtype=h5py.string_dtype(), chunks=(1000,))(file)
    file["entry/checks/message"].id.write_direct_chunk((0,), 1000 * named)


def endless_piece(file: h5py.File) -> None:
    instead("entry/brdf/theta_in", shape=(4,), dtype="f8", chunks=(4,), compression="gzip")(file)
    file["entry/brdf/theta_in"].id.write_direct_chunk((0,), of_zeros(64 << 20))


def list_of_names(file: h5py.File) -> None:
    file["entry/sources/000"].attrs["name"] = ["x" * 1000] * 30


THETA = "entry/brdf/theta_in"
HDF5: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    "octets that would become numbers": (
        instead(THETA, shape=(900_000_000,), dtype="u1", chunks=(1 << 20,), compression="gzip"),
        "larger than 1 GB",
    ),
    "a piece larger than its array": (
        instead(THETA, shape=(4,), maxshape=(None,), dtype="f8", chunks=(200_000_000,), compression="gzip"),
        "packed in another way",
    ),
    "more pieces than a computer can count": (
        instead(THETA, shape=(100_000_000,), dtype="f8", chunks=(1,)),
        "packed in another way",
    ),
    "a filter that is a program": (
        instead(THETA, data=POINTS[0], chunks=(4,), compression="lzf"),
        "packed in another way",
    ),
    "a piece that inflates without end": (endless_piece, "larger than it should be"),
    "one text many times": (one_text_many_times, "larger than 1 GB"),
    "more texts than anybody writes": (
        instead("entry/checks/message", shape=(100_000_000,), dtype=h5py.string_dtype(), chunks=(10_000,)),
        "no list of at most 1000 texts",
    ),
    "a list for a name": (list_of_names, "a list as its name"),
    "texts for numbers": (
        instead(THETA, shape=(10_000,), dtype=h5py.string_dtype(), chunks=(10_000,)),
        "are no numbers",
    ),
    "groups of more points than there are": (
        instead("entry/sources/003/groups", shape=(50_000_000,), dtype="i8", chunks=(100_000,), compression="gzip"),
        "larger than 1 GB",
    ),
    "a size that is only stated": (instead(THETA, shape=(1 << 40,), dtype="f8", chunks=(1 << 16,)), "larger than 1 GB"),
}


@pytest.mark.parametrize("name", HDF5)
def test_a_small_hdf5_file_does_not_take_all_memory(dataset: Dataset, name: str) -> None:
    change, told = HDF5[name]
    content = io.BytesIO(dataset_to_hdf5(dataset))
    with h5py.File(content, "r+") as file:
        change(file)
    assert len(content.getvalue()) < 10_000_000
    with pytest.raises(DataFileError, match=told):
        reloaded(Path("a.h5"), content.getvalue())


def test_a_large_dataset_of_ours_is_no_bomb() -> None:
    """What h5py packs of a scan with many wavelengths is within the limits that hostile files exceed."""
    drawn = drawn_dataset("sample-2", seed=5)
    wide = np.linspace(380, 780, 1044)
    noise = np.random.default_rng(3).random((drawn.theta_in.size, 1044))
    large = replace(
        drawn, wavelengths=wide, brdf=noise, sources=(replace(drawn.sources[0], values=1e-3 * noise),), lineage={}
    )
    back = reloaded(Path("a.h5"), dataset_to_hdf5(large))
    assert back is not None
    assert back.content_hash == large.content_hash


def parquet(columns: dict[str, object], said: bytes) -> bytes:
    """A table of columns as Parquet that states `said` as a dataset of ours does."""
    buffer = io.BytesIO()
    table = pyarrow.table(columns)
    with pyarrow.parquet.ParquetWriter(buffer, table.schema, store_schema=False) as writer:
        writer.add_key_value_metadata({b"goniometer": said})
        writer.write_table(table)
    return buffer.getvalue()


def test_a_small_parquet_file_does_not_take_all_memory(dataset: Dataset) -> None:
    ours = pyarrow.parquet.ParquetFile(io.BytesIO(dataset_to_parquet(dataset)))
    said = ours.schema_arrow.metadata[b"goniometer"]
    rows = 1_000_000
    plain = {name: pyarrow.array(np.zeros(rows)) for name in ours.schema_arrow.names}
    texts = pyarrow.DictionaryArray.from_arrays(np.zeros(rows, dtype=np.int32), ["z" * 100_000])
    with pytest.raises(DataFileError, match="something else than numbers"):
        reloaded(Path("a.parquet"), parquet(plain | {"brdf": texts}, said))
    lists = pyarrow.array([[1.0] * 100_000] * 10 + [[]] * (rows - 10))
    with pytest.raises(DataFileError, match="something else than numbers"):
        reloaded(Path("a.parquet"), parquet(plain | {"brdf": lists}, said))
    del plain, texts, lists
    most = LARGEST_ARRAYS // 8 // len(ours.schema_arrow.names)
    of_zeros = pyarrow.array(np.zeros(most + 1))
    with pytest.raises(DataFileError, match="larger than 1 GB"):
        reloaded(Path("a.parquet"), parquet(dict.fromkeys(ours.schema_arrow.names, of_zeros), said))


def test_a_csv_file_of_many_columns_and_empty_rows_does_not_take_all_memory(dataset: Dataset) -> None:
    head, _, _ = dataset_to_csv(dataset).partition("\npoint,")
    many = [{"name": "a", "part": "random", "shared_by_wavelengths": True, "groups": None}]

    def with_sources(count: int, rows: int) -> bytes:
        told = re.sub(r"(?m)^# sources: .*$", f"# sources: {json.dumps(count * many)}", head)
        names = "point,theta_in,theta_out,wavelength,brdf,standard_uncertainty,flags" + count * ",u(a)"
        return f"{told}\n{names}\n{rows * chr(10)}".encode()

    with pytest.raises(DataFileError, match="at most 1000 items"):
        reloaded(Path("a.csv"), with_sources(100_000, 10))
    with pytest.raises(DataFileError, match="larger than 1 GB"):
        reloaded(Path("a.csv"), with_sources(1000, 1_000_000))


DEEP = "[" * 200_000
READERS: dict[str, Callable[[str], object]] = {
    "published JSON": lambda text: read_published_json("a.json", text),
    "BiRD JSON": lambda text: read_bird_json("a.brdf", parsed_json("a.brdf", text)),
    "CSV": lambda text: read_delimited("a.csv", text, Meaning("brdf", "deg", "nm")),
    "raw text": lambda text: read_raw_text("a.txt", text),
    "campaign": lambda text: read_campaign(text, Path()),
    "certificate": lambda text: parse_certificate(text, "a.csv"),
}
TEXTS = {
    "nested": DEEP,
    "nested objects": '{"a":' * 100_000,
    "nested in a point": '[{"wavelengths": ' + DEEP,
    "a number of a million digits": '[{"wavelengths": [' + "9" * 1_000_000 + "]}]",
    "a number beyond all": '{"data": {"BRDF": {"unit": "1/sr", "values": [1' + 400 * "0" + "]}}}",
    "a million columns": "theta_in,theta_out," + ",".join(map(str, range(1_000_000))) + "\n1",
    "a million same columns": "theta_in,theta_out" + 1_000_000 * ",5" + "\n1",
    "rows that all differ": "theta_in,theta_out,wavelength,brdf\n"
    + "\n".join(f"{i / 1e4},{i / 1e4},{400 + i / 1e3},1" for i in range(100_000)),
    "a cell without end": "theta_in,theta_out,500\n1,1," + 1_000_000 * "x",
    "a line without end": "1 2 3\n" + 1_000_000 * "4 x",
    "a key without end": '{"' + 100_000 * "k" + '": 1}',
    "minutes of minutes": "name: 1" + 1_000_000 * ":1",
    "nothing": "",
    "a null character": "name: \0",
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("text", TEXTS)
def test_a_text_without_end_is_refused_in_one_line_and_soon(reader: str, text: str) -> None:
    began = time.process_time()
    with pytest.raises(InputError) as told:
        READERS[reader](TEXTS[text])
    assert str(told.value).isprintable()
    assert len(str(told.value)) < 2000
    assert time.process_time() - began < 20  # what is quadratic would take hours


LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)
"""Nine lines of YAML that mean 387 million words."""

YAML = {
    "laughs": LAUGHS,
    "laughs as a key": LAUGHS + "sample: *i\nmaterial: *i\ncamera: *i\nname: *i\n",
    "itself": "provenance: &a {a: *a}\n",
    "an object of Python": "provenance: !!python/object/apply:os.system ['exit 1']\n",
    "a module of Python": "name: !!python/name:os.system\n",
    "keys of a list": "? [a]\n: b\n",
    "a key twice": "name: a\nname: b\n",
    "a number in sixties": "name: 1" + 100_000 * ":1",
    "a number of many digits": f"name: 0x{100_000 * 'f'}",
    "nested": "[" * 100_000,
    "far too long": "a: b #" + 5_000_000 * "x",
}


@pytest.mark.parametrize("read", [load_campaign, load_scene, read_about])
@pytest.mark.parametrize("text", YAML)
def test_a_few_lines_of_yaml_neither_run_nor_grow(read: Callable[[Path], object], text: str, tmp_path: Path) -> None:
    file = tmp_path / "a.yaml"
    file.write_text(YAML[text])
    with pytest.raises(InputError) as told:
        read(file)
    assert str(told.value).isprintable()
    assert len(str(told.value)) < 1000


def test_dates_and_sets_of_yaml_do_not_break_what_is_written_of_them(tmp_path: Path) -> None:
    """YAML makes days of texts that look so, and JSON knows none."""
    file = tmp_path / "lab.yaml"
    file.write_text("sample: {delivered: 2026-01-31, colours: !!set {red}, picture: !!binary aGk=}\n")
    with pytest.raises(InputError, match="JSON"):
        read_about(file)


@pytest.mark.parametrize("name", ["/dev/zero", "/proc/self/mem", "."])
def test_what_is_no_file_is_not_read_for_ever(name: str) -> None:
    with pytest.raises(InputError):
        imported_file(Request(Path(name)))


RUN = ["=1+1", "+1", "-1", "@SUM(1)", "=cmd|' /C calc'!A0", "\t=1", "\r=1"]


@pytest.mark.parametrize("separator", [",", ";", "\t", ", ", '",', "\n", "\n,"])
@pytest.mark.parametrize("formula", RUN)
def test_a_spreadsheet_runs_nothing_of_a_csv_file(dataset: Dataset, separator: str, formula: str) -> None:
    """A spreadsheet takes a cell that begins so for a formula, and splits the lines before the table, too."""
    text = f"a{separator}{formula}"
    hostile = replace(
        dataset,
        sample=re.sub(r"\s", " ", text),
        checks=(Check(text, True, text),),
        lineage={text: [text, {"imported": text}], "number": -1},
    )
    written = dataset_to_csv(hostile)
    back = reloaded(Path("a.csv"), written.encode())
    assert back is not None
    assert back.content_hash == hostile.content_hash
    assert (back.sample, back.checks, back.lineage[text]) == (hostile.sample, hostile.checks, hostile.lineage[text])
    for delimiter in ",;\t":
        for row in csv.reader(io.StringIO(written), delimiter=delimiter):
            for cell in row:
                assert not re.match(r"\s*[=+@]|\s*-\D", cell), cell


@pytest.mark.parametrize("name", ["a,=1", "a; +1", "a\n=1", "a\x1b[2J", "a" * 1000])
def test_a_file_cannot_bring_a_formula_or_a_command_of_terminals_as_the_name_of_a_column(
    dataset: Dataset, name: str
) -> None:
    hostile = replace(dataset, sources=(replace(dataset.sources[0], name=name), *dataset.sources[1:]))
    with pytest.raises(DataFileError, match=r"sources\.0\.name"):
        reloaded(Path("a.h5"), dataset_to_hdf5(hostile))


def test_a_document_is_plain_json_to_other_readers(dataset: Dataset) -> None:
    hostile = replace(dataset, sample='a,=1 "b";+c')
    lines = [line for line in dataset_to_csv(hostile).split("\n") if line.startswith("# sample: ")]
    assert yaml.safe_load(lines[0].partition(": ")[2]) == hostile.sample
    assert document(hostile)["sample"] == hostile.sample
