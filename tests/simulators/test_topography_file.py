"""Maps of microscopes are read with the size, the heights and the gaps that their files state."""

import hashlib
import pickle
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from goniometer.errors import DataFileError, InputError
from simulators.topographies.heights import HeightField, roughness
from simulators.topographies.synthesis import gaussian, gaussian_correlation
from simulators.topographies.topography import topography
from simulators.topographies.topography_file import read_topography, write_topography


def nms(heights_um: np.ndarray, pitch_nm: tuple[float, float], unmeasured: np.ndarray | None = None) -> bytes:
    """A NanoFocus file of the version OM_MS_2.0, written byte by byte."""
    header = bytearray(3468)
    low, high = float(heights_um.min()), float(heights_um.max())
    struct.pack_into("<4i2d", header, 0, 2, 1, 0, 65535, low, high)
    header[32:41] = b"OM_MS_2.0"
    struct.pack_into("<2i2d", header, 1368, heights_um.shape[1], heights_um.shape[0], *pitch_nm)
    struct.pack_into("<i", header, 1416, int(unmeasured is not None))
    counts = np.rint((heights_um - low) / (high - low) * 65535).astype("<u2")
    intensity = b"" if unmeasured is None else np.where(unmeasured, 0, 90).astype(np.uint8).tobytes()
    return bytes(header) + counts.tobytes() + intensity


def sur(heights_um: np.ndarray, pitch_mm: tuple[float, float], unmeasured: np.ndarray) -> bytes:
    """A Digital Surf file with points in mm, heights in um and gaps, written after its published layout."""
    step = 0.001
    counts = np.rint(heights_um / step).astype(int)
    lowest, highest = int(counts.min()), int(counts.max())
    counts[unmeasured] = lowest - 2
    text = [name.encode().ljust(16) for name in ("X", "Y", "Z", "mm", "mm", "um", "mm", "mm", "um")]
    head = b"DIGITAL SURF" + struct.pack("<4h", 0, 1, 1, 2) + b"map".ljust(30) + b"test".ljust(30)
    head += struct.pack("<5h2ih", 0, 0, 0, 1, 1, 0, 0, 32)
    head += struct.pack("<4iI", lowest, highest, counts.shape[1], counts.shape[0], counts.size)
    head += struct.pack("<3f", *pitch_mm, step) + b"".join(text)
    head += struct.pack("<3f", 1, 1, 1) + struct.pack("<3h", 0, 0, 0)
    return head.ljust(512, b"\0") + counts.astype("<i4").tobytes()


@pytest.fixture
def waves() -> np.ndarray:
    """[60, 90] heights, um, on an inclined plane."""
    y, x = np.indices((60, 90))
    return np.asarray(0.4 * np.sin(2 * np.pi * x / 30) * np.cos(2 * np.pi * y / 20) + 0.02 * x - 0.03 * y + 5)


def flat(heights: np.ndarray, measured: np.ndarray | None = None) -> np.ndarray:
    """Without the plane of its normal equations."""
    y, x = np.indices(heights.shape)
    basis = np.stack([np.ones(heights.size), x.ravel(), y.ravel()], axis=1)
    rows = np.ones(heights.size, bool) if measured is None else measured.ravel()
    plane = np.linalg.solve(basis[rows].T @ basis[rows], basis[rows].T @ heights.ravel()[rows])
    return np.asarray(heights - (basis @ plane).reshape(heights.shape))


def test_a_nanofocus_map_is_as_large_as_its_microscope_saw_and_has_its_gaps(tmp_path: Path, waves: np.ndarray) -> None:
    gap = np.zeros(waves.shape, bool)
    gap[10:12, 20:25] = gap[0, 0] = True
    file = tmp_path / "map.NMS"
    file.write_bytes(nms(waves, (312.5, 312.5), gap))
    field, origin = read_topography(file)
    assert field.pitch_um == pytest.approx(0.3125)
    assert not field.periodic
    np.testing.assert_allclose(field.heights_um[~gap], flat(waves, ~gap)[~gap], atol=1e-4)
    np.testing.assert_allclose(field.heights_um[0, 0], (field.heights_um[0, 1] + field.heights_um[1, 0]) / 2)
    assert origin["file"] == "map.NMS"
    assert origin["sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
    assert origin["missing"] == pytest.approx(11 / 5400)
    assert origin["steps"] == [
        "levelled by a least-squares plane",
        "0.2 % of the heights were missing and were filled as by a membrane",
    ]


def test_points_further_apart_along_one_side_are_interpolated_to_the_finer_distance(tmp_path: Path) -> None:
    y, x = np.indices((50, 120)) * np.array([0.8, 0.5])[:, None, None]
    file = tmp_path / "map.nms"
    file.write_bytes(nms(np.sin(2 * np.pi * x / 15) * np.cos(2 * np.pi * y / 10), (500, 800)))
    field, origin = read_topography(file)
    assert field.pitch_um == 0.5
    assert field.heights_um.shape == (79, 120)
    y, x = np.indices((79, 120)) * 0.5
    off = field.heights_um - flat(np.sin(2 * np.pi * x / 15) * np.cos(2 * np.pi * y / 10))
    assert np.abs(flat(off)[4:-4]).max() < 2e-3
    assert origin["steps"] == [
        "levelled by a least-squares plane",
        "interpolated by cubic splines from 0.5 x 0.8 um to 0.5 um",
    ]


def test_a_digital_surf_map_is_read_with_its_axes_units_and_gaps(tmp_path: Path, waves: np.ndarray) -> None:
    gap = np.zeros(waves.shape, bool)
    gap[30, 40:44] = True
    file = tmp_path / "map.sur"
    file.write_bytes(sur(waves, (6.25e-4, 6.25e-4), gap))
    field, origin = read_topography(file)
    assert field.pitch_um == pytest.approx(0.625)
    np.testing.assert_allclose(field.heights_um[~gap], flat(waves, ~gap)[~gap], atol=2e-3)
    assert origin["missing"] == pytest.approx(4 / 5400)
    assert origin["points"] == [90, 60]


def test_a_surface_that_was_written_is_read_back_as_it_was(tmp_path: Path) -> None:
    field = gaussian(0.3, gaussian_correlation(4.0), 64, 0.4, 1)
    write_topography(tmp_path / "made.npz", field)
    made = topography(str(tmp_path / "made.npz"), None, None, 1, micro=False)
    np.testing.assert_allclose(made.field.heights_um, field.heights_um, atol=1e-12)
    assert (made.name, made.field.pitch_um, made.field.periodic) == ("made.npz", 0.4, True)
    assert made.origin["steps"] == ["mean removed"]
    with pytest.raises(InputError, match="leave out --size and --pitch"):
        topography(str(tmp_path / "made.npz"), None, 0.5, 1, micro=False)


class Trap:
    """What a hostile archive would run."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return exec, ("raise SystemExit('the file ran')",)


def test_an_archive_that_is_not_ours_is_refused_and_nothing_in_it_runs(tmp_path: Path) -> None:
    file = tmp_path / "made.npz"
    np.savez(file, heights_um=np.array([[Trap()]], dtype=object), pitch_um=1.0, periodic=True)
    with pytest.raises(DataFileError, match=r"no NumPy archive with heights_um"):
        read_topography(file)
    for content in (b"", b"PK\x03\x04 and no more", pickle.dumps([1])):
        file.write_bytes(content)
        with pytest.raises(DataFileError, match="no NumPy archive"):
            read_topography(file)
    np.savez(file, heights_um=np.zeros((4, 4)), pitch_um=np.zeros(2), periodic=True)
    with pytest.raises(DataFileError, match="one number"):
        read_topography(file)


def test_a_nanofocus_file_that_cannot_be_right_is_refused_with_the_reason(tmp_path: Path, waves: np.ndarray) -> None:
    file = tmp_path / "map.nms"
    whole = nms(waves, (312.5, 312.5))
    for content, told in (
        (whole[:-1], "should hold 90 x 60 heights, but ends before"),
        (whole[:200], "no NanoFocus file"),
        (b"\0" * len(whole), "no NanoFocus file"),
        (nms(waves, (3.125e-4, 3.125e-4)), "0.0003125 nm apart; a light microscope has 10 to 100000 nm"),
        (nms(waves, (float("nan"), 300)), "nm apart"),
        (nms(waves, (300, 9000)), "0.3 um apart along x and 9 um along y"),
        (bytes([4]) + whole[1:], "no area of heights"),
        (whole[:16] + struct.pack("<2d", 3, float("inf")) + whole[32:], "states heights of 3 to inf um"),
        (nms(waves, (300, 300), np.indices(waves.shape)[0] > 20), "lacks 65 % of its heights"),
    ):
        file.write_bytes(content)
        with pytest.raises(DataFileError, match=told):
            read_topography(file)


def test_other_files_are_refused_in_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "map.sur"
    for content in (b"", b"DIGITAL SURF", bytes(range(256)) * 8, b"heights\n1 2\n3 4\n"):
        file.write_bytes(content)
        with pytest.raises(DataFileError) as error:
            read_topography(file)
        assert "\n" not in str(error.value)
    with pytest.raises(DataFileError, match=r"cannot be read: Is a directory"):
        read_topography(tmp_path)
    monkeypatch.setitem(sys.modules, "SurfaceTopography", None)
    with pytest.raises(DataFileError, match=r'pip install "goniometer\[topography\]"'):
        read_topography(file)


def test_a_sandblasted_surface_says_what_beads_did_and_the_polished_one_is_a_mirror() -> None:
    blasted = topography("sample-1", 256, 1.0, 3, micro=False)
    assert blasted.origin["seed"] == 3
    assert blasted.origin["deepest_dent_um"] == pytest.approx(
        np.ptp(blasted.field.heights_um), rel=0.05
    )  # the deepest of many dents is nearly as deep as a dent can be
    flat_share = np.mean(blasted.field.heights_um == blasted.field.heights_um.max())
    assert blasted.origin["bare_share"] == pytest.approx(flat_share)
    polished = roughness(topography("sample-6", None, None, 1, micro=False).field)
    assert polished.sq_um == pytest.approx(0.10)
    assert polished.sdq == pytest.approx(0.0045, rel=0.15)  # Beckmann's alpha is the rms slope in all directions
    with pytest.raises(InputError, match="make it 178 um"):
        topography("sample-6", 64, 0.5, 1, micro=False)


def test_a_surface_that_is_none_is_refused(tmp_path: Path) -> None:
    for name in ("sample-9", str(tmp_path), "gauss:1:2", ""):
        with pytest.raises(InputError, match="no surface and no file"):
            topography(name, None, None, 1, micro=False)
    with pytest.raises(InputError, match="without numbers"):
        topography("sample-1:3", None, None, 1, micro=False)
    with pytest.raises(InputError, match="gaussian:RMS:LENGTH, with positive lengths"):
        topography("gaussian:1", None, None, 1, micro=False)


def test_fine_roughness_is_put_on_a_map_only_where_its_pitch_can_show_it(tmp_path: Path) -> None:
    write_topography(tmp_path / "made.npz", HeightField(np.zeros((64, 64)), 0.1, True))
    made = topography(str(tmp_path / "made.npz"), None, None, 1, micro=True)
    assert made.origin["micro_roughness"] is True
    assert roughness(made.field).sq_um == pytest.approx(0.04, rel=0.2)
