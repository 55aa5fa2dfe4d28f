"""A scene that somebody has sent cannot make Mitsuba open a file of the machine, or load a program from it."""

import pytest

from api.jobs.foreign_scene import check_foreign_scene
from goniometer.errors import InputError

SCENE = """
<scene version="3.0.0">
  <default name="spp" value="16"/>
  <integrator type="path"><integer name="max_depth" value="4"/></integrator>
  <sensor type="perspective">
    <float name="fov" value="30"/>
    <transform name="to_world"><lookat origin="0, 4, 2" target="0, 0, 0" up="0, 0, 1"/></transform>
    <film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="64"/></film>
    <sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>
  </sensor>
  <bsdf type="roughconductor" id="sample"><string name="material" value="Al"/></bsdf>
  <shape type="sphere"><ref id="sample"/></shape>
  <emitter type="constant"><spectrum name="radiance" value="400:1, 700:1"/></emitter>
  %s
</scene>
"""


def test_a_scene_of_shapes_and_numbers_is_taken() -> None:
    check_foreign_scene(SCENE % "")


@pytest.mark.parametrize(
    ("element", "word"),
    [
        ('<include filename="/etc/passwd"/>', "/etc/passwd"),
        ('<path value="/etc"/>', "/etc"),
        ('<bsdf type="../../uploads/0123/evil"/>', "evil"),
        ('<bsdf type="Plugin.so"/>', "Plugin.so"),
        ('<default name="kind" value="x"/><bsdf type="$kind"/>', r"\$kind"),
        ('<spectrum name="radiance" filename="/etc/passwd"/>', "/etc/passwd"),
        ('<spectrum name="radiance" value="/etc/passwd"/>', "/etc/passwd"),
        ('<shape type="obj"><string name="filename" value="mesh.obj"/></shape>', "mesh.obj"),
        ('<default name="key" value="filename"/><string name="$key" value="x"/>', "x"),
        ('<default name="where" value="../x"/>', "../x"),
        ('<bsdf type="conductor"><string name="material" value="..\\\\..\\\\x"/></bsdf>', "x"),
    ],
)
def test_a_scene_that_reaches_outside_is_refused_before_it_is_loaded(element: str, word: str) -> None:
    with pytest.raises(InputError, match=word):
        check_foreign_scene(SCENE % element)


ELSEWHERE = '<!DOCTYPE scene [<!ENTITY e SYSTEM "file:///etc/passwd">]><scene>&e;</scene>'


@pytest.mark.parametrize("text", ["", "no xml", ELSEWHERE])
def test_what_is_no_xml_or_speaks_of_entities_elsewhere_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="not valid XML"):
        check_foreign_scene(text)
