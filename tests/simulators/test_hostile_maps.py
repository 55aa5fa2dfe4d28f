"""Surfaces, materials and photographs made to harm who opens them: what they state, and what they unpack to."""

import io
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import tifffile

from goniometer.errors import DataFileError
from goniometer.photographs.files import read_frame
from goniometer.photographs.series import Series
from simulators.errors import UnfitTable
from simulators.materials.tabulated_file import read_tabulated
from simulators.topographies.topography_file import read_topography
from tests.little_memory import little_memory


@pytest.fixture(autouse=True)
def _bounded() -> Iterator[None]:
    with little_memory():
        yield


def stated(*shape: int) -> bytes:
    """The head of an array of this shape in NumPy's format, without its numbers."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return head.getvalue()


def named(path: Path, parts: dict[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content)


def test_a_small_archive_does_not_become_a_large_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simulators.npz_file.LARGEST", 1 << 24)
    file = tmp_path / "a.npz"
    np.savez_compressed(file, brdf=np.zeros(1 << 23), heights_um=np.zeros((1 << 10, 1 << 12)))
    assert file.stat().st_size < 1 << 20
    with pytest.raises(UnfitTable, match="unpacks to more"):
        read_tabulated(file)
    with pytest.raises(DataFileError, match="no NumPy archive"):
        read_topography(file)


@pytest.mark.parametrize("shape", [(1 << 40,), (1 << 20, 1 << 20), (1 << 62, 1 << 62), (0, 1 << 40)])
def test_an_array_that_is_only_stated_is_not_made_room_for(tmp_path: Path, shape: tuple[int, ...]) -> None:
    file = tmp_path / "a.npz"
    parts = "format", "name", "theta_in", "theta_out", "wavelengths", "brdf", "aperture", "filled", "origin"
    named(file, {f"{name}.npy": stated(*shape) for name in (*parts, "heights_um", "pitch_um", "periodic")})
    with pytest.raises(UnfitTable):
        read_tabulated(file)
    with pytest.raises(DataFileError):
        read_topography(file)


@pytest.mark.parametrize("name", ["../heights_um.npy", "/etc/heights_um.npy", "heights_um.npy/../../x", "heights_um"])
def test_an_archive_writes_nothing_anywhere(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "inside"
    folder.mkdir()
    named(folder / "a.npz", {name: stated(2, 2) + bytes(32), "pitch_um.npy": b"", "periodic.npy": b""})
    with pytest.raises(DataFileError):
        read_topography(folder / "a.npz")
    with pytest.raises(UnfitTable):
        read_tabulated(folder / "a.npz")
    assert [each.name for each in tmp_path.rglob("*")] == ["inside", "a.npz"]


def nms(columns: int, rows: int, pitch: float = 300.0, levels: tuple[int, int] = (0, 65535)) -> bytes:
    """A NanoFocus file of a thousand octets of heights that states this size."""
    head = bytearray(3468)
    struct.pack_into("<4i2d", head, 0, 2, 1, *levels, 0.0, 1.0)
    head[32:41] = b"OM_MS_2.0"
    struct.pack_into("<2i2d", head, 1368, columns, rows, pitch, pitch)
    return bytes(head) + bytes(1000)


@pytest.mark.parametrize(
    "content",
    [
        nms(2**31 - 1, 2**31 - 1),
        nms(-2, -2),
        nms(-(2**31), -(2**31)),
        nms(0, 100),
        nms(100, 1),
        nms(65536, 65536),
        nms(10, 10, pitch=float("nan")),
        nms(10, 10, pitch=-300.0),
        nms(10, 10, levels=(5, 5)),
        nms(10, 10, levels=(2**31 - 1, -(2**31))),
    ],
)
def test_a_size_that_a_microscope_only_states_is_not_believed(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "a.nms"
    file.write_bytes(content)
    with pytest.raises(DataFileError) as told:
        read_topography(file)
    assert str(told.value).isprintable()


def test_what_is_no_file_is_not_read_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simulators.npz_file.LARGEST", 1 << 20)
    with pytest.raises(DataFileError, match="larger than"):
        read_topography(Path("/dev/zero"))
    with pytest.raises(UnfitTable, match="larger than"):
        read_tabulated(Path("/dev/zero"))


def test_a_photograph_is_not_larger_than_a_camera_can_take(tmp_path: Path) -> None:
    file = tmp_path / "a.tif"
    tifffile.imwrite(file, np.zeros((2, 3, 3), dtype=np.uint16), photometric="rgb", metadata=None)
    content = bytearray(file.read_bytes())
    with tifffile.TiffFile(file) as whole:
        tags = whole.pages[0].tags
        for name in ("ImageLength", "ImageWidth", "RowsPerStrip"):
            tag = tags[name]
            kind = "<H" if tag.dtype == 3 else "<I"
            struct.pack_into(kind, content, tag.valueoffset, 65535)
    file.write_bytes(content)
    shot = {"file": "a.tif", "angle": 0, "exposure": 1}
    series = Series.model_validate(
        {"sample": "a", "encoding": "linear", "white": shot, "frames": [shot, shot | {"angle": 1}]}
    )
    with pytest.raises(DataFileError, match="states a picture"):
        read_frame(file, series)
