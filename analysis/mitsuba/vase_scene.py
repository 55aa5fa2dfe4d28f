"""The scene in which a material is shown: a turned vase under a spot light, as a file for Mitsuba 3.

The vase swells and narrows, and its belly is fluted, so that it has convex and concave parts towards the lamp and away
from it: it shows forward and backward scattering, grazing angles, and light that is reflected twice. All shapes are
computed here. The material is the BSDF with the id "sample".
"""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from drivers.arrays import FloatArray

VASE = "vase.ply"
"""Name of the file with the shape of the vase, beside the scene."""

SAMPLES = 256
"""Of a pixel, in a scene file."""

DEPTH = 6
"""Longest way of light, in segments; at 2 it is reflected once."""

_PROFILE = np.array(
    [
        (0.62, 0.00), (0.645, 0.05), (0.60, 0.12), (0.43, 0.20), (0.31, 0.32), (0.36, 0.46), (0.58, 0.66),
        (0.74, 0.90), (0.73, 1.12), (0.54, 1.34), (0.33, 1.50), (0.26, 1.64), (0.30, 1.76), (0.40, 1.86),
        (0.40, 1.97), (0.26, 2.06), (0.00, 2.10),
    ]
)  # fmt: skip
"""[nodes, radius and height] of the vase."""

_FLUTES, _FLUTE_DEPTH = 12, 0.035
_BELLY = (0.95, 0.30)
"""Height and width of the part that is fluted."""


@dataclass(frozen=True)
class SceneFiles:
    """A scene of Mitsuba."""

    xml: str
    files: dict[str, bytes]
    """What must lie beside it, by name."""


def vase_scene(material: str, pixels: int = 512, samples: int = SAMPLES, depth: int = DEPTH) -> SceneFiles:
    """A scene that shows a material, in a picture of `pixels` x `pixels`.

    `samples` are of a pixel, `depth` is that of `DEPTH`. `material` is its XML, a `<bsdf>` with the id "sample"; files
    that it names must be put beside the scene.
    """
    xml = f"""<scene version="3.0.0">
  <integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
  <sensor type="perspective">
    <float name="fov" value="21"/>
    <transform name="to_world"><lookat origin="0, -6.6, 2.5" target="0, 0, 0.98" up="0, 0, 1"/></transform>
    <sampler type="independent"><integer name="sample_count" value="{samples}"/></sampler>
    <film type="hdrfilm">
      <integer name="width" value="{pixels}"/><integer name="height" value="{pixels}"/>
      <rfilter type="box"/>
    </film>
  </sensor>
  {material}
  <bsdf type="diffuse" id="ground"><spectrum name="reflectance" value="0.18"/></bsdf>
  <shape type="ply" id="vase"><string name="filename" value="{VASE}"/><ref id="sample"/></shape>
  <shape type="rectangle" id="floor">
    <transform name="to_world"><scale value="12"/></transform>
    <ref id="ground"/>
  </shape>
  <emitter type="spot">
    <transform name="to_world"><lookat origin="-4.2, -2.6, 4.4" target="0, 0, 0.9" up="0, 0, 1"/></transform>
    <spectrum name="intensity" type="d65"><float name="scale" value="100"/></spectrum>
    <float name="cutoff_angle" value="24"/>
  </emitter>
</scene>
"""
    return SceneFiles(xml, {VASE: ply(*vase())})


def vase() -> tuple[FloatArray, FloatArray, NDArray[np.int32]]:
    """Vertices and unit normals [vertices, 3], and triangles [triangles, 3] counter-clockwise from outside."""
    around = along = 120
    steps = np.linalg.norm(np.diff(_PROFILE, axis=0), axis=1)
    curve = scipy.interpolate.CubicSpline(np.concatenate([[0.0], np.cumsum(steps)]), _PROFILE)
    s, phi = np.meshgrid(np.linspace(0, steps.sum(), along), 2 * np.pi * np.arange(around) / around, indexing="ij")
    (radius, height), (by_s, up_by_s) = (np.moveaxis(curve(s, order), -1, 0) for order in (0, 1))
    radius = np.maximum(radius, 0.0)
    away = (height - _BELLY[0]) / _BELLY[1]
    window = np.exp(-(away**4))
    wave, by_phi = np.cos(_FLUTES * phi), -_FLUTES * np.sin(_FLUTES * phi)
    fluted = 1 + _FLUTE_DEPTH * window * wave
    radius_by_phi = radius * _FLUTE_DEPTH * window * by_phi
    window_by_s = window * -4 * away**3 / _BELLY[1] * up_by_s
    radius_by_s = by_s * fluted + radius * _FLUTE_DEPTH * window_by_s * wave
    radius = radius * fluted
    outward = np.stack([np.cos(phi), np.sin(phi), np.zeros_like(phi)], axis=-1)
    sideways = np.stack([-np.sin(phi), np.cos(phi), np.zeros_like(phi)], axis=-1)
    upward = np.array([0.0, 0.0, 1.0])
    # the cross product of the derivatives by phi and s, divided by the radius, which is zero at the top
    turn = radius_by_phi / np.maximum(radius, 1e-9)
    normals = up_by_s[..., None] * (outward - turn[..., None] * sideways) - radius_by_s[..., None] * upward
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    vertices = radius[..., None] * outward + height[..., None] * upward
    number = np.arange(along * around).reshape(along, around)
    here, up = number[:-1], number[1:]
    right, up_right = np.roll(here, -1, axis=1), np.roll(up, -1, axis=1)
    triangles = np.concatenate([np.stack([here, right, up_right], -1), np.stack([here, up_right, up], -1)])
    return vertices.reshape(-1, 3), normals.reshape(-1, 3), triangles.reshape(-1, 3).astype(np.int32)


def ply(vertices: FloatArray, normals: FloatArray, triangles: NDArray[np.int32]) -> bytes:
    """A mesh in the binary form of the Stanford PLY format."""
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        + "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
        + f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, triangles
    return header.encode() + np.hstack([vertices, normals]).astype("<f4").tobytes() + faces.tobytes()
