"""`goniometer export --to mitsuba`: any fitted model, with its error said, and a scene that renders at once."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from api.commands.main import app
from api.commands.simulations import store_computed
from goniometer.errors import InputError
from simulators.computed import Computed
from simulators.materials.materials import SAMPLES, true_brdf

SCENE = """
import sys
import numpy as np
import mitsuba as mi
mi.set_variant("scalar_spectral")
scene = mi.load_file(sys.argv[1])
assert [b.id() for b in {s.bsdf().id(): s.bsdf() for s in scene.shapes()}.values()].count("sample") == 1
sensor = scene.sensors()[0]
image = np.array(mi.render(scene, spp=16, seed=1))
print(*image.shape, float(np.nanmean(image[..., 1])), int(np.isnan(image).sum()), float(np.nanmin(image)))
"""


def invoke(*arguments: object) -> Any:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bsdf") / "goniometer.db"
    theta_in, theta_out = (a.ravel() for a in np.meshgrid([0.0, 40, 70], np.arange(-85.0, 86, 5), indexing="ij"))
    wavelengths = np.arange(400.0, 781, 20)
    brdf = true_brdf(SAMPLES["sample-4"], theta_in, theta_out, wavelengths, aperture=0.0)
    made = Computed(
        "Traced", theta_in, theta_out, wavelengths, brdf, 0.01 * brdf, 0.003 * brdf, 0.0, {"simulated": "x"}
    )
    assert store_computed(path, made) == 1
    return path


def test_the_command_says_the_error_of_its_file_and_a_scene_renders_at_once(database: Path) -> None:
    bsdf = database.with_name("disc.bsdf")
    said = invoke(
        "export", "Traced", "--to", "mitsuba", "--budget", 0.05, "--colour-budget", 1, "-o", bsdf, "-d", database
    )
    assert "model cook-torrance-shift" in said.stdout
    assert "99 of 100 directions below" in " ".join(said.stdout.split())
    assert "largest albedo in a white furnace" in said.stdout
    scene = database.with_name("disc.scene.xml")
    assert "disc.scene.xml" in said.stdout
    pytest.importorskip("mitsuba")
    small = scene.read_text().replace('"512"', '"24"')  # a picture of the whole size takes a minute
    assert small != scene.read_text()
    scene.with_name("small.xml").write_text(small)
    done = subprocess.run(
        [sys.executable, "-c", SCENE, str(scene.with_name("small.xml"))], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    rows, columns, channels, mean, missing, least = (float(value) for value in done.stdout.split())
    assert (rows, columns, channels) == (24, 24, 3)
    assert mean > 0.01
    assert missing == 0
    assert least >= 0


def test_the_model_that_was_fitted_last_is_exported_unless_one_is_named(database: Path) -> None:
    bsdf = database.with_name("other.bsdf")
    options = ["--to", "mitsuba", "--budget", 0.1, "--colour-budget", 3, "-o", bsdf, "-d", database, "--json"]
    invoke("fit", "Traced", "--model", "cook-torrance", "--distribution", "beckmann", "-d", database)
    told = json.loads(invoke("export", "Traced", *options).stdout)
    assert told["model"] == "cook-torrance"
    assert b"Beckmann" in bsdf.read_bytes()
    assert told["bytes"] == bsdf.stat().st_size
    assert told["layouts"][told["layout"]]["error"]["p99"] < 0.1
    told = json.loads(invoke("export", "Traced", "--model", "dielectric", *options).stdout)
    assert told["model"] == "dielectric"
    assert told["wavelengths_nm"][0] == 400
    assert told["wavelengths_nm"][-1] == 780
    assert b"r_d / pi" in bsdf.read_bytes()


def test_a_model_without_brightness_is_refused_in_one_sentence(database: Path) -> None:
    with pytest.raises(InputError, match='"global" is no model that can be rendered; there are cook-torrance'):
        invoke("export", "Traced", "--to", "mitsuba", "--model", "global", "-d", database)
    with pytest.raises(InputError, match="no use for --budget"):
        invoke("export", "Traced", "--to", "json", "--budget", 0.1, "-d", database)
