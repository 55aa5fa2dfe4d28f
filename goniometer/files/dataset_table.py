"""A dataset as a long table: one value a row, in CSV and in Parquet.

Columns are `point` (number of the point, from 0), `theta_in`, `theta_out`, `wavelength`, `brdf`,
`standard_uncertainty`, `flags`, and for every source of error `u(NAME)`: what it does to the value. In CSV, lines that
begin with # stand before the column names and hold the rest of the dataset, one field of its document in JSON each; in
Parquet it is the metadata of the schema. Rows may be in any order when they are read.
"""

import csv
import io
import json
import math
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.errors import DataFileError, InputError
from goniometer.files.dataset_document import (
    LARGEST_ARRAYS,
    MEANINGS,
    UNITS,
    Arrays,
    Document,
    assembled,
    document,
    parsed,
    parsed_json,
)
from goniometer.files.measured_table import LARGEST_FILE

FIRST_LINE = "# goniometer dataset: one value a row; these lines hold the rest of it as JSON"
"""How such a CSV file begins."""

PARQUET_MAGIC = b"PAR1"
"""How a Parquet file begins and ends."""

_TEXT = re.compile(r'"(?:[^"\\]|\\.)*"')
"""A text in JSON."""
_FORMULA = re.compile(r'((?:^"|[,;])\s*)([=+@-])')
"""Where in such a text the cell of a spreadsheet would begin as a formula does."""

_ROWS_AT_ONCE = 10_000
_KEY = b"goniometer"
_EXACT = ("point", "theta_in", "theta_out", "wavelength", "brdf", "standard_uncertainty", "flags")


def columns(dataset: Dataset) -> dict[str, NDArray[Any]]:
    """The table: column -> [rows], wavelengths of a point beside each other."""
    points, wavelengths = dataset.brdf.shape
    of_point: dict[str, NDArray[Any]] = {
        "point": np.arange(points, dtype=np.int32),
        "theta_in": dataset.theta_in,
        "theta_out": dataset.theta_out,
    }
    return (
        {name: np.repeat(values, wavelengths) for name, values in of_point.items()}
        | {"wavelength": np.tile(dataset.wavelengths, points), "brdf": dataset.brdf.ravel()}
        | {"standard_uncertainty": dataset.u.ravel(), "flags": np.repeat(dataset.flags, wavelengths)}
        | {f"u({source.name})": source.values.ravel() for source in dataset.sources}
    )


def dataset_to_csv(dataset: Dataset) -> str:
    """The text of the file; an empty cell is no number. Raises `DataFileError` where it would be too large to read."""
    lines = [FIRST_LINE, *(f"# {name}: {_inert_json(value)}" for name, value in document(dataset).items())]
    table = columns(dataset)
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(table)
    for start in range(0, dataset.brdf.size, _ROWS_AT_ONCE):
        part = [values[start : start + _ROWS_AT_ONCE].tolist() for values in table.values()]
        # repr is the shortest text that is the same number again
        cells = [["" if cell != cell else repr(cell) for cell in values] for values in part]  # noqa: PLR0124
        writer.writerows(zip(*cells, strict=True))
    text = "\n".join(lines) + "\n" + buffer.getvalue()
    if len(text) > LARGEST_FILE:
        raise DataFileError(
            f"{dataset.sample}: as CSV it would take {len(text) / 1e6:.0f} MB, more than the {LARGEST_FILE / 1e6:.0f} "
            f"MB that an import reads; write hdf5 or parquet."
        )
    return text


def _inert_json(value: object) -> str:
    """JSON of a value; a spreadsheet, which splits lines at commas or semicolons, takes nothing of it for a formula."""
    return _TEXT.sub(lambda text: _FORMULA.sub(lambda at: f"{at[1]}\\u{ord(at[2]):04x}", text[0]), json.dumps(value))


def dataset_from_csv(where: str, text: str) -> Dataset:
    """The dataset of a file that `dataset_to_csv` wrote; raises `DataFileError` where it was changed or damaged."""
    lines = text.split("\n")
    start = next((i for i, line in enumerate(lines) if not line.startswith("#")), len(lines))
    content: dict[str, object] = {}
    for number, line in enumerate(lines[1:start], start=2):
        name, _, value = line[1:].strip().partition(": ")
        try:
            content[name] = json.loads(value)
        except (ValueError, RecursionError) as error:
            raise DataFileError(f"{where}, line {number}: is not as it was written; export it again.") from error
    said = parsed(where, content)
    rows = csv.reader(lines[start:])
    filled = 0
    try:
        names = next(rows, [])
        _check_names(where, names, said)
        _check_size(where, len(lines) - start - 1, len(names))
        table = np.empty((len(lines) - start - 1, len(names)))
        for row in rows:
            if row:
                table[filled] = [float(cell) if cell else math.nan for cell in row]
                filled += 1
    except (csv.Error, ValueError) as error:
        number = start + max(rows.line_num, 1)
        raise DataFileError(f"{where}, line {number}: is not as it was written ({error}); export it again.") from error
    return _from_rows(where, said, dict(zip(names, table[:filled].T, strict=True)))


def dataset_to_parquet(dataset: Dataset) -> bytes:
    """The content of the file; raises `InputError` without pyarrow."""
    pyarrow, parquet = _pyarrow()
    table = columns(dataset)
    fields = [
        pyarrow.field(
            name,
            pyarrow.from_numpy_dtype(values.dtype),
            nullable=False,
            metadata={"unit": UNITS.get(name, "1" if name == "point" else "1/sr"), "meaning": _meaning(name)},
        )
        for name, values in table.items()
    ]
    schema = pyarrow.schema(fields, metadata={_KEY: json.dumps(document(dataset))})
    buffer = io.BytesIO()
    parquet.write_table(pyarrow.table(table, schema=schema), buffer, compression="zstd")
    return buffer.getvalue()


def dataset_from_parquet(where: str, content: bytes) -> Dataset:
    """The dataset of a file that `dataset_to_parquet` wrote.

    Raises `DataFileError` where it is of another program, changed or damaged, and `InputError` without pyarrow.
    """
    pyarrow, parquet = _pyarrow()
    try:
        file = parquet.ParquetFile(io.BytesIO(content))
        metadata = file.schema_arrow.metadata or {}
        if _KEY not in metadata:
            raise DataFileError(f"{where}: is a Parquet file of another program; only those of this one are read.")
        said = parsed_json(where, metadata[_KEY])
        _check_names(where, file.schema_arrow.names, said)
        if not all(
            pyarrow.types.is_floating(each) or pyarrow.types.is_integer(each) for each in file.schema_arrow.types
        ):
            # a text is kept once for all rows that hold it, and would become as many as there are rows
            raise DataFileError(f"{where}: has a column of something else than numbers; export it again.")
        _check_size(where, _rows_of_parquet(where, file.metadata), file.metadata.num_columns)
        table = file.read()
        rows = {name: table[name].to_numpy().astype(float) for name in table.column_names}
    except (pyarrow.ArrowException, OSError, ValueError, TypeError) as error:
        raise DataFileError(f"{where}: cannot be read as Parquet of a dataset; export it again.") from error
    return _from_rows(where, said, rows)


def _pyarrow() -> tuple[Any, Any]:
    try:
        import pyarrow  # noqa: PLC0415  (an extra)
        from pyarrow import parquet  # noqa: PLC0415  (an extra)
    except ImportError as error:
        raise InputError(
            "Parquet needs pyarrow, which is not installed; run: pip install goniometer[parquet]."
        ) from error
    return pyarrow, parquet


def _meaning(name: str) -> str:
    if name == "point":
        return "number of the point, from 0"
    return MEANINGS.get(name, "change of brdf for one standard uncertainty of the source of error, signed")


def _rows_of_parquet(where: str, metadata: Any) -> int:
    """How many rows its columns have; raises `DataFileError` where that is not what the file says of itself."""
    total = 0
    for i in range(metadata.num_row_groups):
        group = metadata.row_group(i)
        total += group.num_rows
        if any(group.column(k).num_values != group.num_rows for k in range(group.num_columns)):
            raise DataFileError(f"{where}: its columns are not as long as it states; export it again.")
    if total != metadata.num_rows:
        raise DataFileError(f"{where}: has not as many rows as it states; export it again.")
    return total


def _check_size(where: str, rows: int, names: int) -> None:
    if 8 * rows * names > LARGEST_ARRAYS:
        raise DataFileError(
            f"{where}: its arrays are larger than {LARGEST_ARRAYS / 1e9:g} GB, which is more than is read at once."
        )


def _check_names(where: str, names: list[str], said: Document) -> None:
    wanted = [*_EXACT, *(f"u({source.name})" for source in said.sources)]
    if names != wanted:
        odd = next((name for name in [*wanted, *names] if (name in wanted) != (name in names)), "another order")
        raise DataFileError(f"{where}: its columns are not those that it states ({odd}); export it again.")


def _from_rows(where: str, said: Document, rows: dict[str, FloatArray]) -> Dataset:
    """The dataset of a table whose rows stand in any order; raises `DataFileError` for one that is not complete."""
    wavelengths, of_wavelength = np.unique(rows["wavelength"], return_inverse=True)
    point = rows["point"]
    size = point.size
    points = size // max(wavelengths.size, 1)
    if not size or not np.array_equal(np.sort(point), np.repeat(np.arange(points), wavelengths.size)):
        raise DataFileError(f"{where}: has not one row for each point and wavelength; export it again.")
    place = point.astype(np.intp) * wavelengths.size + of_wavelength
    order = np.empty(size, dtype=np.intp)
    order[place] = np.arange(size)
    grid = {name: values[order].reshape(points, wavelengths.size) for name, values in rows.items()}
    arrays = Arrays(
        grid["theta_in"][:, 0],
        grid["theta_out"][:, 0],
        wavelengths,
        grid["brdf"],
        grid["flags"][:, 0],
        tuple(grid[f"u({source.name})"] for source in said.sources),
    )
    return assembled(where, said, arrays)
