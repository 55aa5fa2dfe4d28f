"""Files of other people's data: what is in them arrives, and what cannot be meant is refused with one sentence."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniometer.certificates.certificate import NOMINAL_SRS99
from goniometer.errors import DataFileError, InputError
from goniometer.files import measured_table
from goniometer.files.delimited import Meaning, read_delimited
from goniometer.files.imported import Stated, imported_dataset
from goniometer.files.measured_table import MeasuredTable, read_text, tidied
from goniometer.files.published_json import read_published_json
from goniometer.files.raw_text import looks_like_raw_text, ratio_to_reference, read_raw_text
from goniometer.files.scatter import scatter

ALL = (0.0, np.inf)
NM = [400.0, 500.0, 700.0]
PLAIN = Meaning("brdf", "deg", "nm")


def point(theta_in, phi_in, theta_out, phi_out, spectrum):
    return {"thetaIn": theta_in, "phiIn": phi_in, "thetaOut": theta_out, "phiOut": phi_out, "spectrum": spectrum}


def published(*points, wavelengths=NM):
    return json.dumps([{"wavelengths": wavelengths}, *points])


def read(text, name="a.json"):
    table, notes = read_published_json(name, text)
    table, tidying = tidied(name, table, *ALL)
    return table, [*notes, *tidying]


def test_directions_of_the_published_json_arrive_with_the_sign_of_their_side():
    table, _ = read(
        published(
            point(40, 0, 40, 180, [3, 3, 3]),  # mirror
            point(40, 0, 20, 0, [1, 1, 1]),  # on the side of the lamp
            point(10, 0, 30, 180, [2, 2, 2]),
            point(40, 180, 60, 360, [4, 4, 4]),  # the same plane, turned
        )
    )
    assert list(zip(table.theta_in, table.theta_out, table.brdf[:, 0], strict=True)) == [
        (10, 30, 2),
        (40, -20, 1),
        (40, 40, 3),
        (40, 60, 4),
    ]


def test_a_file_whose_azimuths_count_the_other_way_round_is_told_by_what_no_detector_can_measure():
    table, notes = read(published(point(40, 0, 40, 0, [9, 9, 9]), point(40, 0, 60, 180, [1, 1, 1])))
    assert table.theta_out.tolist() == [-60, 40]
    assert "mirror side" in notes[0]


def test_wavelengths_in_any_order_gaps_and_copies_are_put_in_order_and_told():
    table, notes = read(
        published(
            point(30, 0, 30, 180, [3, 1, 2]),
            point(30, 0, 30, 180, [3, 1, 2]),
            point(30, 0, 40, 180, [None, 5, 6]),
            point(30, 0, 50, 180, [None, None, None]),
            wavelengths=[700, 400, 500],
        )
    )
    assert table.wavelengths.tolist() == [400, 500, 700]
    assert table.brdf[0].tolist() == [1, 2, 3]
    assert np.isnan(table.brdf[1]).tolist() == [False, False, True]
    assert table.theta_out.tolist() == [30, 40]
    assert [note.split()[0] for note in notes] == ["1", "1", "1"]  # empty, missing, copied


def test_a_direction_measured_twice_stays_two_points():
    table, _ = read(published(point(30, 0, 30, 180, [1, 2, 3]), point(30, 0, 30, 180, [1.1, 2, 3])))
    assert table.brdf[:, 0].tolist() == [1, 1.1]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[", "not valid JSON"),
        ("[" * 100_000, "nested too deeply"),
        ('{"a": 1}', "must be an array"),
        ("[{}]", 'element 0: has no "wavelengths"'),
        (published(), "no point"),
        (published([]), "element 1: must be an object"),
        (published({"thetaIn": 3}), "element 1: phiIn is missing"),
        (published(point(10, 0, 10, 90, NM)), "phiOut is 90 deg"),
        (published(point(95, 0, 10, 0, NM)), "element 1: theta_in = 95"),
        (published(point("10", 0, 10, 0, NM)), "nothing but numbers"),
        (published(point(10, 0, 10, 180, [1, 2])), "2 values, but there are 3 wavelengths"),
        (published(point(10, 0, 10, 180, [1, 2, float("inf")])), "infinite"),
        (published(point(10, 0, 10, 180, [None] * 3)), "no value at any point"),
        (published(point(10, 0, 10, 180, NM), wavelengths=[0.4, 0.5, 0.7]), "another unit"),
        (published(point(10, 0, 10, 180, NM), wavelengths=[400, 400, 700]), "400 nm occurs twice"),
        (published(point(10, 0, 10, 180, [10**400, 2, 3])), "too large"),
    ],
)
def test_a_json_that_cannot_be_meant_is_refused_where_it_is_wrong(text, told):
    with pytest.raises(DataFileError, match=told) as error:
        read(text)
    assert str(error.value).startswith("a.json")


WIDE = "theta_in,theta_out,400,500\n40,-20,0.1,0.2\n40,40,0.5,0.6\n"
LONG = "wavelength,theta_in,theta_out,brdf\n" + "".join(
    f"{w},40,{out},{f}\n" for w, out, f in [(500, 40, 0.6), (400, 40, 0.5), (400, -20, 0.1), (500, -20, 0.2)]
)
GERMAN = "# Messung\ntheta_in\ttheta_out\t400\t500\n40\t-20\t0,1\t0,2\n\n40\t40,0\t5e-1\t0,6\n"


@pytest.mark.parametrize("text", [WIDE, LONG, GERMAN, GERMAN.replace("\t", ";")])
def test_the_same_table_wide_long_and_with_decimal_commas_is_the_same(tmp_path, text):
    path = tmp_path / "a.csv"
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    table, notes = tidied("a.csv", read_delimited("a.csv", read_text(path)[0], PLAIN), *ALL)
    assert table.theta_in.tolist() == [40, 40]
    assert table.theta_out.tolist() == [-20, 40]
    assert table.wavelengths.tolist() == [400, 500]
    assert table.brdf.tolist() == [[0.1, 0.2], [0.5, 0.6]]
    assert notes == []


@pytest.mark.parametrize(
    ("quantity", "of_value"),
    [("brdf", 0.5), ("brdf-cos-in", 1.0), ("brdf-cos-out", 0.5 / np.cos(np.pi / 4)), ("radiance-factor", 0.5 / np.pi)],
)
def test_what_a_table_holds_becomes_a_brdf(quantity, of_value):
    text = f"theta_in,theta_out,0.55\n{np.pi / 3!r},{np.pi / 4!r},0.5\n"
    table = read_delimited("a.csv", text, Meaning(quantity, "rad", "um"))
    assert (table.theta_in[0], table.theta_out[0], table.wavelengths[0]) == pytest.approx((60, 45, 550))
    assert table.brdf[0, 0] == pytest.approx(of_value, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("\n# nothing\n", "is empty"),
        ("a,b\n1,2\n", "line 1: there is no column theta_in"),
        ("theta_in,theta_out\n1,2\n", "no column of values"),
        ("theta_in,theta_out,400\n", "no row of numbers"),
        ("theta_in,theta_out,400,400\n1,2,3,4\n", '"400" occurs twice'),
        ("theta_in,theta_out,blue\n1,2,3\n", '"blue" is no wavelength'),
        ("theta_in,theta_out,400\n1,2,3\n1,2\n", "line 3: has 2 cells"),
        ("theta_in,theta_out,400\n1,2,3\n1,2,x\n", 'line 3: "x" is no number'),
        ("theta_in,theta_out,400\n1,2,1_0\n", '"1_0" is no number'),
        ("theta_in,theta_out,400\n,2,3\n", "line 2: a row without angles"),
        ("theta_in,theta_out,400\n1,2,inf\n", "line 2: a BRDF cannot be infinite"),
        ("theta_in,theta_out,wavelength,colour\n1,2,400,1\n", '"colour" is unknown or missing'),
        ("theta_in,theta_out,wavelength\n1,2,400\n", '"brdf" is unknown or missing'),
        ("theta_in,theta_out,wavelength,brdf\n1,2,400,1\n1,2,400,2\n", "line 3: .* line 2 already"),
        (
            "theta_in,theta_out,wavelength,brdf\n" + "".join(f"1,{i},{400 + i},1\n" for i in range(9)),
            "less than half of 9 directions times 9 wavelengths",
        ),
        ("theta_in,theta_out,wavelength,brdf,standard_uncertainty\n1,2,400,1,-1\n", "line 2: .* negative"),
    ],
)
def test_a_table_that_cannot_be_meant_is_refused_with_the_line(text, told):
    with pytest.raises(DataFileError, match=told):
        tidied("a.csv", read_delimited("a.csv", text, PLAIN), *ALL)


def test_light_on_the_side_of_the_lamp_is_doubted():
    text = "theta_in,theta_out,400\n40,-30,9\n40,40,1\n60,-30,9\n60,60,1\n"
    _, notes = tidied("a.csv", read_delimited("a.csv", text, PLAIN), *ALL)
    assert "counts theta_out the other way round" in notes[-1]


@pytest.mark.parametrize("content", [b"\xff\xff\xff", b"theta_in\0", b"\xff\xfea"])
def test_a_binary_file_is_refused(tmp_path, content):
    path = tmp_path / "a.bin"
    path.write_bytes(content)
    with pytest.raises(DataFileError, match="is no text"):
        read_text(path)


def test_a_file_too_large_for_memory_is_refused_before_it_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr(measured_table, "LARGEST_FILE", 10)
    path = tmp_path / "a.csv"
    path.write_bytes(bytes(11))
    with pytest.raises(DataFileError, match="is larger than"):
        read_text(path)


def test_noise_is_seen_in_the_scatter_and_the_shape_of_a_spectrum_is_not_taken_for_it():
    wavelengths = np.cumsum(np.random.default_rng(1).uniform(2, 6, 300)) + 300
    shape = 0.3 * (1 + 0.5 * np.sin(wavelengths / 60))[None] * np.ones((20, 1))
    noise = np.where(wavelengths < 900, 0.002, 0.01)
    drawn = shape + noise * np.random.default_rng(2).standard_normal(shape.shape)
    drawn[3, 50:60] = np.nan
    found = scatter(wavelengths, drawn)
    assert np.isnan(found).sum() == 10
    root_mean_square = np.sqrt(np.nanmean(found**2, axis=0))
    inside = np.abs(wavelengths - 900) > 60
    assert root_mean_square[inside] == pytest.approx(noise[inside], rel=0.25)
    assert np.sqrt(np.mean((root_mean_square[inside] / noise[inside]) ** 2)) == pytest.approx(1, abs=0.03)
    assert np.nanmax(scatter(wavelengths, shape)) < 2e-5


def table_of(brdf, **more):
    points, count = brdf.shape
    theta_out = np.linspace(-70, 80, points)
    return MeasuredTable(
        np.full(points, 40.0),
        theta_out,
        np.linspace(400, 700, count),
        brdf,
        places=("",) * points,
        **{"u": None} | more,
    )


def test_the_stated_uncertainty_is_split_into_noise_and_what_all_points_share():
    brdf = 0.3 + 0.003 * np.random.default_rng(3).standard_normal((30, 200))
    dataset = imported_dataset("A", table_of(brdf), Stated(0.02, None, 1.0, 0.0), {})
    assert np.median(dataset.u_counts) == pytest.approx(0.003, rel=0.05)
    assert dataset.u == pytest.approx(np.maximum(0.02 * brdf, dataset.u_counts), rel=1e-12)
    assert [source.name for source in dataset.sources] == ["random", "reference: as stated with the file"]
    louder = imported_dataset("A", table_of(brdf), Stated(0.001, None, 1.0, 0.0), {})
    assert louder.u == pytest.approx(dataset.u_counts, rel=1e-12)
    itself = imported_dataset("A", table_of(brdf, u=np.full(brdf.shape, 0.01)), Stated(None, 0.001, 1.0, 0.0), {})
    assert itself.u == pytest.approx(0.01, rel=1e-12)
    assert itself.u_counts == pytest.approx(0.001 * brdf, rel=1e-12)


def test_an_uncertain_angle_is_worth_the_slope_of_the_brdf():
    slope = 0.02  # of ln f over theta_out, per degree
    table = table_of(np.exp(slope * np.linspace(-70, 80, 30))[:, None] * np.ones((1, 10)))
    dataset = imported_dataset("A", table, Stated(0.0, 1e-6, 1.0, 0.1), {})
    angle = {s.name: s for s in dataset.sources if s.part == "angle"}
    assert angle["angle: detector stage"].values == pytest.approx(0.1 * slope * table.brdf, rel=1e-9)
    assert angle["angle: sample stage"].values == pytest.approx(-0.2 * slope * table.brdf, rel=1e-9)


def test_spectra_without_scatter_ask_for_their_noise():
    with pytest.raises(InputError, match="--relative-noise"):
        imported_dataset("A", table_of(np.full((5, 20), 0.3)), Stated(0.01, None, 1.0, 0.0), {})


WAVELENGTHS = np.linspace(400, 700, 12)
SPECTRUM = np.random.default_rng(5).uniform(0.2, 0.3, 12).round(4).tolist()
GOOD = [
    published(*(point(t, 0, 10 * t, 180, SPECTRUM) for t in range(9)), wavelengths=WAVELENGTHS.tolist()),
    f"theta_in,theta_out,{','.join(map(str, WAVELENGTHS))}\n"
    + "".join(f"{t},{-t},{','.join(map(str, SPECTRUM))}\n" for t in range(9)),
    LONG,
    GERMAN,
]
JUNK = ["", "0", "-", ",", "\t", "\n", "nan", "inf", "null", '"', "[", "}", "1e999", "1e-320", "\0", "é", "9" * 400]
damages = st.lists(st.tuples(st.integers(0, 3000), st.integers(0, 40), st.sampled_from(JUNK)), max_size=4)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.sampled_from(GOOD), damages)
def test_a_damaged_file_is_read_or_refused_in_one_line(text, damage):
    for place, length, junk in damage:
        start = place % len(text)
        text = (text[:start] + junk + text[start + length :]) or " "
    try:
        if text.lstrip()[:1] in {"[", "{"}:
            table, _ = read(text)
        else:
            table, _ = tidied("a.json", read_delimited("a.json", text, PLAIN), *ALL)
        dataset = imported_dataset("A", table, Stated(0.01, 0.01, 1.0, 0.01), {})
    except DataFileError as error:
        message = str(error)
    else:
        assert np.isfinite(dataset.u[np.isfinite(dataset.brdf)]).all()
        return
    assert message.startswith("a.json")
    assert message.isprintable()


# Raw text

PIXELS = np.linspace(380, 980, 40)
LAMP = 2000 + 3000 * np.exp(-(((PIXELS - 650) / 200) ** 2))
OFFSET = 1500.0


def raw_text(rows, seed):
    """Raw text of [(theta_in, theta_out, time, light per unit of time or None)], with noise of 5 counts."""
    random = np.random.default_rng(seed)
    blocks = []
    for theta_in, theta_out, time, light in rows:
        level = OFFSET + time * (0 if light is None else light) + 5 * random.standard_normal(PIXELS.size)
        counts = " ".join(f"{value:.2f}".replace(".", ",") for value in level)
        scale = " ".join(f"{value:.4f}".replace(".", ",") for value in PIXELS)
        blocks.append(f"{theta_in:g} {theta_out:g} {time:g}\n{counts}\n{scale}\n{'-' * 20}\n")
    return "\r\n".join(blocks)


def light_of(theta_in, brdf):
    return LAMP * np.cos(np.radians(theta_in)) * brdf


def panel_at(theta_in, theta_out):
    # where the incident angle is negative the whole plane is turned
    side = -1 if theta_in < 0 else 1
    return NOMINAL_SRS99.brdf(np.array([abs(theta_in)]), np.array([side * theta_out]), PIXELS)[0]


REFERENCE = [
    (theta_in, theta_out, 10, light_of(theta_in, panel_at(theta_in, theta_out)))
    for theta_in in (-30, 30)
    for theta_out in range(-60, 61, 10)
]
DARKS = [(0, 0, time, None) for time in (5, 10) for _ in range(8)]


def read_raw(rows, seed, name):
    return read_raw_text(name, raw_text(rows, seed))


def test_raw_counts_become_the_brdf_that_they_were_made_of():
    truth = 0.2 + 0.1 * (PIXELS - 600) / 300
    rows = [(30, 40, 5, light_of(30, truth)), (-30, -45, 5, light_of(30, 2 * truth)), (30, 70, 5, light_of(30, truth))]
    text = raw_text(rows, 1)
    assert looks_like_raw_text(text)
    assert not looks_like_raw_text(WIDE)
    table, notes = ratio_to_reference(
        read_raw_text("a.txt", text), read_raw(REFERENCE, 2, "ref"), NOMINAL_SRS99, read_raw(DARKS, 3, "dark"), 60000
    )
    assert notes == ["1 of 3 points lie where the reference was not measured and have no value."]
    table, _ = tidied("a.txt", table, *ALL)
    assert list(zip(table.theta_in, table.theta_out, strict=True)) == [(30, 40), (30, 45)]
    off = (table.brdf - np.stack([truth, 2 * truth])) / np.stack([truth, 2 * truth])
    assert np.sqrt(np.mean(off**2)) < 0.01
    dataset = imported_dataset("A", table, Stated(0.0, None, 1.0, 0.01), {})
    own = np.median(dataset.u_counts / table.brdf)
    assert own == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.5)
    certified = NOMINAL_SRS99.errors(np.array([30.0]), np.array([40.0]), PIXELS)
    for name, relative in certified.items():
        (source,) = (s for s in dataset.sources if s.name == f"reference: {name}")
        assert np.abs(source.values[0]) == pytest.approx(np.abs(relative[0] * table.brdf[0]), rel=1e-6)


def test_saturated_pixels_have_no_value_and_missing_darks_are_asked_for():
    rows = [(30, 40, 5, light_of(30, 1 + 0 * PIXELS))]
    sample, reference = read_raw(rows, 1, "a"), read_raw(REFERENCE, 2, "ref")
    table, notes = ratio_to_reference(sample, reference, NOMINAL_SRS99, read_raw(DARKS, 3, "dark"), 20_000)
    assert np.isnan(table.brdf[0]).tolist() == (sample.counts[0] >= 20_000).tolist()
    assert "saturated" in notes[0]
    with pytest.raises(DataFileError, match="dark: has 1 dark spectra of the integration time 5"):
        ratio_to_reference(sample, reference, NOMINAL_SRS99, read_raw(DARKS[7:], 3, "dark"), 60_000)
    other = read_raw_text("other", raw_text(REFERENCE, 2).replace("380,0000", "381,0000"))
    with pytest.raises(DataFileError, match="other: has other wavelengths than a"):
        ratio_to_reference(sample, other, NOMINAL_SRS99, None, 60_000)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("1 2 3\n1 2 3 4\n", "no multiple of three"),
        ("1 2\n1 2 3 4\n1 2 3 4\n", "line 1: must be incidence"),
        ("1 2 0\n1 2 3 4\n1 2 3 4\n", "line 1: the integration time 0"),
        ("1 2 3\n1 2 3 4\n1 2 3\n", "line 1: has 4 counts and 3 wavelengths"),
        ("1 2 3\n1 2 3 x4\n1 2 3 4\n", "line 2: holds something that is no number"),
        ("1 2 3\n1 2\n4 5\n--\n1 2 3\n1 2\n4 6\n--\n", "line 5: has other wavelengths"),
    ],
)
def test_raw_text_that_is_spoilt_is_refused_with_the_line(text, told):
    with pytest.raises(DataFileError, match=told):
        read_raw_text("a.txt", text)


def test_degrees_that_may_be_radians_are_doubted_and_wavelengths_without_values_left_out():
    text = "theta_in,theta_out,400,500,600\n0,1.2,1,,2\n0.5,-1.2,1,,3\n"
    table, notes = tidied("a.csv", read_delimited("a.csv", text, PLAIN), *ALL)
    assert table.wavelengths.tolist() == [400, 600]
    assert notes[0] == "At 500 nm no point has a value; left out."
    assert "if the file gives them in radians" in notes[-1]
    _, notes = tidied("a.csv", read_delimited("a.csv", text, Meaning("brdf", "rad", "nm")), *ALL)
    assert not any("radians" in note for note in notes)


def test_what_a_file_lacks_is_no_fault_and_per_cent_are_suspected():
    theta_out = np.arange(-80.0, 81.0, 10.0)
    brdf = np.full((theta_out.size, 20), 90 / np.pi)
    brdf[3, 4] = np.nan
    table = MeasuredTable(np.full(theta_out.size, 60.0), theta_out, np.linspace(400, 780, 20), brdf, None, ())
    found = {check.name: check for check in imported_dataset("a", table, Stated(0.01, 0.005, 1, 0), {}).checks}
    assert found["values"].passed
    assert "but 1 that the file lacks" in found["values"].message
    assert not found["energy"].passed
    assert "not per cent" in found["energy"].message
