"""Series of photographs: raw files against LibRaw's own development, TIFFs, the panel, and what is refused."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rawpy
import tifffile
from numpy.typing import NDArray

from goniometer.errors import DataFileError, InputError
from goniometer.photographs.files import read_frame
from goniometer.photographs.photos import read_series
from goniometer.photographs.series import Series, Shot, load_series, series_text

SHOTS = 'frames = [{file = "a.tif", angle = -20, exposure = 0.5}, {file = "b.tif", angle = 20, exposure = "1/4 s"}]'
SERIES = f'sample = "Sample 1"\nencoding = "linear"\nwhite = {{file = "w.tif", angle = 0, exposure = 2}}\n{SHOTS}\n'
BLACK, WHITE = (600, 602, 604, 606), 15520


def write_dng(path: Path, sites: NDArray[np.uint16]) -> None:
    """A raw file as DNG: squares of R, G, G, B with a black level of its own for each site."""
    one = (1, 1)
    tags = [
        (33421, "H", 2, (2, 2), True),
        (33422, "B", 4, bytes((0, 1, 1, 2)), True),
        (50706, "B", 4, bytes((1, 4, 0, 0)), True),
        (50708, "s", 0, "Test", True),
        (50713, "H", 2, (2, 2), True),
        (50714, "H", 4, BLACK, True),
        (50717, "H", 1, WHITE, True),
        (50721, "2i", 9, (9020, 10000, -2890, 10000, -715, 10000, -4535, 10000, 12436, 10000, 2348, 10000, -934, 10000,
                          1919, 10000, 7086, 10000), True),
        (50728, "2I", 3, one * 3, True),
        (50778, "H", 1, 21, True),
    ]  # fmt: skip
    tifffile.imwrite(path, sites, photometric=32803, extratags=tags, metadata=None, planarconfig=1)


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A series of flat frames: the panel at half, its channels unequal, and a sample that is twice as red."""
    level = {"w": (4000, 8000, 2000), "a": (1000, 1000, 250), "b": (2000, 2000, 500)}
    for name, rgb in level.items():
        tifffile.imwrite(tmp_path / f"{name}.tif", np.full((40, 60, 3), rgb, dtype=np.uint16), photometric="rgb")
    (tmp_path / "series.toml").write_text(SERIES)
    return tmp_path


def spoil(files: Path, name: str, change: Callable[[NDArray[np.uint16]], None]) -> None:
    image = tifffile.imread(files / name)
    change(image)
    tifffile.imwrite(files / name, image, photometric="rgb")


def test_a_raw_file_holds_what_libraw_develops_without_its_own_ideas_of_colour(tmp_path: Path) -> None:
    sites = np.random.default_rng(5).integers(500, 16383, (48, 64)).astype(np.uint16)
    write_dng(tmp_path / "a.dng", sites)
    frame = read_frame(tmp_path / "a.dng", load_series_text(tmp_path, SERIES))
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        developed = raw.postprocess(
            half_size=True, gamma=(1, 1), no_auto_bright=True, user_wb=[1, 1, 1, 1], output_bps=16,
            output_color=rawpy.ColorSpace.raw, adjust_maximum_thr=0,
        )  # fmt: skip
    whole = ~frame.saturated
    # LibRaw cuts off below zero, and takes one white for all four sites
    assert frame.light[whole] == pytest.approx(np.asarray(developed)[whole] / 65535, abs=0.01)
    square = sites.reshape(24, 2, 32, 2)
    assert np.array_equal(frame.saturated, (square >= WHITE).any(axis=(1, 3)))
    assert frame.light[0, 0, 0] == pytest.approx((int(sites[0, 0]) - 600) / (WHITE - 600))


def load_series_text(folder: Path, text: str) -> Series:
    (folder / "series.toml").write_text(text)
    return load_series(folder / "series.toml")


def test_values_are_relative_to_the_panel_per_second(files: Path) -> None:
    series = read_series(files / "series.toml")
    assert [photo.angle for photo in series.photos] == [-20, 20]
    # the panel sent 2000, 4000 and 1000 counts a second, the sample 2000, 2000, 500 and 8000, 8000, 2000
    assert series.photos[0].inset[0, 0] == pytest.approx([1, 0.5, 0.5])
    assert series.photos[1].inset[0, 0] == pytest.approx([4, 2, 2])
    assert series.gains == pytest.approx((2, 1, 4))
    assert series.photos[0].inset.shape == (20, 20, 3)
    assert series.unevenness == pytest.approx(0, abs=1e-6)


def test_eight_bits_of_srgb_are_decoded_and_only_when_it_is_said(files: Path) -> None:
    for name in ("w", "a", "b"):
        tifffile.imwrite(files / f"{name}.tif", np.full((40, 60, 3), 188, dtype=np.uint8), photometric="rgb")
    linear = read_frame(files / "a.tif", load_series_text(files, SERIES))
    assert linear.light[0, 0, 0] == pytest.approx(188 / 255)
    srgb = read_frame(files / "a.tif", load_series_text(files, SERIES.replace("linear", "srgb")))
    assert srgb.light[0, 0, 0] == pytest.approx(0.5029, abs=1e-4)  # IEC 61966-2-1
    with pytest.raises(DataFileError, match='write encoding = "linear" or encoding = "srgb"'):
        read_frame(files / "a.tif", load_series_text(files, SERIES.replace('encoding = "linear"\n', "")))


def test_the_black_level_is_taken_off_and_saturation_is_seen(files: Path) -> None:
    text = "black_level = 500\nwhite_level = 8500\n" + SERIES

    def flare(image: NDArray[np.uint16]) -> None:
        image[20, 30] = (100, 8500, 100)

    spoil(files, "a.tif", flare)
    load_series_text(files, text)
    series = read_series(files / "series.toml")
    assert series.photos[0].inset[0, 0, 0] == pytest.approx((500 / 0.5) / (3500 / 2))
    assert series.photos[0].saturated.sum() == 1
    assert series.photos[0].overexposed
    assert not series.photos[1].overexposed


def test_a_series_file_reads_back_as_it_was_written(tmp_path: Path) -> None:
    shots = tuple(Shot(file=f'odd "{a}".tif', angle=a, exposure=0.1) for a in (-70.0, 2.5))
    matrix = ((1.5, -0.5, 0.0), (-0.25, 1.5, -0.25), (0.0, -0.5, 1.5))
    white = Shot(file="w.tif", angle=0.0, exposure=0.02)
    series = Series(
        sample="Sample 1\tµ", encoding="linear", colour_matrix=matrix, pixel_um=4.88, white=white, frames=shots
    )
    (tmp_path / "s.toml").write_text(series_text(series), encoding="utf-8")
    assert load_series(tmp_path / "s.toml") == series


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("sample = ", "not valid TOML"),
        (SERIES.replace("exposure = 2", "exposure = 0"), "white.exposure"),
        (SERIES.replace("exposure = 2", 'exposure = "1/0"'), "white.exposure"),
        (SERIES.replace("angle = 20", "angle = -20"), "2 frames at -20 degrees"),
        (SERIES.replace("encoding", "encodng"), 'did you mean "encoding"'),
        ("black_level = 70000\n" + SERIES, "do not fit a file"),
        ("black_level = 5\n" + SERIES.replace("linear", "srgb"), "leave them out with srgb"),
        ("colour_matrix = [[1, 0, 0], [0, 1, 0], [0, 0, 2]]\n" + SERIES, "must add up to 1"),
        (SERIES.replace("b.tif", "c.tif"), "c.tif: there is no such file"),
        (SERIES.replace("b.tif", "series.toml"), "neither a TIFF nor a raw file"),
    ],
)
def test_what_is_wrong_in_a_series_is_said_in_one_line(files: Path, text: str, told: str) -> None:
    (files / "series.toml").write_text(text)
    with pytest.raises(DataFileError) as caught:
        read_series(files / "series.toml")
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_panel_that_is_no_measure_of_white_is_refused(files: Path) -> None:
    def flare(image: NDArray[np.uint16]) -> None:
        image[20, 30, 0] = 65535

    def darken(image: NDArray[np.uint16]) -> None:
        image[:] //= 100

    original = (files / "w.tif").read_bytes()
    spoil(files, "w.tif", flare)
    with pytest.raises(DataFileError, match=r"w\.tif: the panel is saturated"):
        read_series(files / "series.toml")
    (files / "w.tif").write_bytes(original)
    spoil(files, "w.tif", darken)
    with pytest.raises(DataFileError, match="too dark for a white balance"):
        read_series(files / "series.toml")


def test_files_that_are_no_photographs_are_refused(files: Path) -> None:
    tifffile.imwrite(files / "a.tif", np.zeros((40, 60), dtype=np.uint16))
    with pytest.raises(DataFileError, match="save it as RGB"):
        read_series(files / "series.toml")
    tifffile.imwrite(files / "a.tif", np.zeros((40, 62, 3), dtype=np.uint16), photometric="rgb")
    with pytest.raises(DataFileError, match="has 62 x 40 pixels"):
        read_series(files / "series.toml")
    (files / "a.tif").write_bytes((files / "b.tif").read_bytes()[:300])
    with pytest.raises(DataFileError, match=r"a\.tif: this TIFF cannot be read"):
        read_series(files / "series.toml")
    with pytest.raises(InputError, match=r"make it at least 0\.4 of the shorter side"):
        read_series(files / "series.toml", inset=0.1)
    with pytest.raises(InputError, match="between 0 and 1"):
        read_series(files / "series.toml", inset=0)


def test_an_uneven_panel_is_told(files: Path) -> None:
    def tilt(image: NDArray[np.uint16]) -> None:
        image[:] = (image * np.linspace(0.5, 1.5, 60)[:, None]).astype(np.uint16)

    spoil(files, "w.tif", tilt)
    # over the middle third of the width, the brightness runs from 5/6 to 7/6
    assert read_series(files / "series.toml").unevenness == pytest.approx((1 / 3) / 12**0.5, rel=0.1)


def test_the_documented_series_can_be_read() -> None:
    series = load_series(Path(__file__).parents[2] / "docs" / "photos.toml")
    assert [shot.exposure for shot in series.frames] == [0.5, 1 / 125]
    lines = (Path(__file__).parents[2] / "docs" / "photos.toml").read_text().splitlines()
    documented = {line.lstrip("# ").split(" =")[0] for line in lines if " = " in line}
    assert set(Series.model_fields) <= documented
