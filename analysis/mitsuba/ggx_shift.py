"""Mitsuba 3 plugin `ggx_shift`: Cook-Torrance with GGX times the wavelength shift, for metals and for dielectrics.

    import mitsuba as mi
    import analysis.mitsuba.ggx_shift  # any scene may name the plugin from now on, in whichever variant
    mi.set_variant("llvm_ad_spectral")
    mi.load_dict({"type": "ggx_shift", "alpha": 0.36, "eta": ..., "k": ..., "h": 1.6, "w": 2.3})

This file needs nothing but Mitsuba and NumPy: a copy of it may lie beside a scene, and

    python ggx_shift.py SCENE.xml IMAGE.exr [VARIANT]

renders that. Equation numbers are those of Clausen et al., Computer Graphics Forum 42 (2023). Parameters:

- `alpha` (0.1): roughness.
- `eta`, `k`: refractive index and extinction of a metal (Eq. 7), spectra; or `int_ior`: refractive index of a
  dielectric, one for all wavelengths, and `diffuse_reflectance` (0.5), its diffuse albedo r_d, a spectrum (Eq. 8).
- `h`, `w`: slope of the shift, m = h cos(w theta_m), h in 1/um (Eq. 5). Without them there is no shift.

f = F G D / (4 cos_i cos_o) (1 + m (lambda - 600 nm)), negative values becoming zero, plus r_d / pi for a dielectric. It
is the same with its two directions exchanged. Without shift a metal equals `roughconductor`. Masking and normals are
those of Walter et al. 2007, samples follow the visible normals.

The shift is linear in the wavelength, so an `rgb` variant has it at the centroids of the channels under D65: exact for
a neutral metal. A `mono` variant has it at that of luminance. `polarized` variants are refused.

Nothing in the equations keeps a strong shift, or a bright dielectric at grazing angles, from reflecting more light than
falls in. Where the albedo A of a direction exceeds one, f is divided by the larger of A(theta_i) and A(theta_o), at the
wavelength in question; that keeps it reciprocal, and leaves it as it is everywhere else. Mitsuba's log then says so.

`mitsuba.traverse` finds all parameters; in vectorised variants they can be changed, and images differentiated by them.
"""

import math
import sys
from typing import Any

import drjit as dr
import mitsuba
import numpy as np
from numpy.typing import NDArray

mi: Any = mitsuba
"""Its types are others in every variant, which its stubs cannot say."""

NAME = "ggx_shift"

LAMBDA_N = 600.0
"""Wavelength at which the shift is one, nm."""

RGB_CENTROIDS = (642.44, 543.01, 440.82)
"""Of the responses of linear BT.709 under D65, CIE 1931 observer, nm; they have negative lobes, and so a weight."""

LUMINANCE_CENTROID = 556.78
"""The same of Y, nm."""

SPECTRUM = (360.0, 830.0)
"""Wavelengths that a spectral variant samples, nm."""

MOST = 1.001
"""Albedo up to which the model is left as it is."""

_NOTHING = 1e-30
"""Added where zero would be divided by, or have its root taken; single precision still has it."""


_COLUMNS = 48
"""Wavelengths at which the albedo is known in a spectral variant."""

_COSINES = np.maximum(np.linspace(0, 1, 24) ** 2, 1e-3)
"""Of the angles at which it is known; the square makes them dense at grazing ones."""


class GGXShift:
    """What the plugin does; `register` makes it a BSDF of a variant."""

    def __init__(self, props: Any) -> None:
        """Raises `ValueError` for parameters that contradict each other, and for a polarised variant."""
        mi.BSDF.__init__(self, props)
        if mi.is_polarized:
            raise ValueError(f"{NAME} does not know polarisation; choose a variant that is not polarized.")
        metal, dielectric = "eta" in props and "k" in props, "int_ior" in props
        if metal == dielectric:
            raise ValueError(f"{NAME} needs either eta and k, of a metal, or int_ior, of a dielectric.")
        if metal and "diffuse_reflectance" in props:
            raise ValueError(f"{NAME} has a diffuse_reflectance only beside int_ior; a metal has none.")
        if ("h" in props) != ("w" in props):
            raise ValueError(f"{NAME} needs both h and w for its shift, or neither.")
        self.alpha: Any = mi.Float(props.get("alpha", 0.1))
        self.eta: Any = props.get_unbounded_texture("eta") if metal else None
        self.k: Any = props.get_unbounded_texture("k") if metal else None
        self.int_ior: Any = None if metal else mi.Float(props["int_ior"])
        self.diffuse_reflectance: Any = None if metal else props.get_texture("diffuse_reflectance", 0.5)
        self.h: Any = mi.Float(props["h"]) if "h" in props else None
        self.w: Any = mi.Float(props["w"]) if "w" in props else None
        for texture in (self.eta, self.k, self.diffuse_reflectance):
            if texture is not None and texture.is_spatially_varying():
                raise ValueError(f"{NAME} is one material: its spectra cannot vary over a surface.")
        components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
        if not metal:
            components.append(mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide)
        self.m_components = components
        self.m_flags = components[0] | components[-1]
        self._prepare()

    def traverse(self, callback: Any) -> None:
        """Name the parameters to `mitsuba.traverse`."""
        smooth = mi.ParamFlags.Differentiable
        for name in ("int_ior", "h", "w", "eta", "k", "diffuse_reflectance"):
            if getattr(self, name) is not None:
                callback.put(name, getattr(self, name), smooth)
        callback.put("alpha", self.alpha, smooth | mi.ParamFlags.Discontinuous)

    def parameters_changed(self, keys: list[str]) -> None:
        """Find anew what follows from the parameters."""
        self._prepare()

    def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """f cos_o."""
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
        """Density by solid angle with which `sample` finds `wo`."""
        return self.eval_pdf(ctx, si, wo, active)[1]

    def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> tuple[Any, Any]:
        """Both of `eval` and `pdf`.

        Numbers are taken channel by channel: in scalar variants an operation on an array of a few costs as much as
        twenty on plain numbers, in the others it is the same.
        """
        glossy, diffuse = self._enabled(ctx)
        wi = si.wi
        cos_i, cos_o = wi.z, wo.z
        lit = active & (cos_i > 0) & (cos_o > 0)
        values, density = [0.0] * len(self._channels), 0.0
        if glossy:
            x, y, z = wi.x + wo.x, wi.y + wo.y, cos_i + cos_o
            sideways = x * x + y * y
            length = dr.sqrt(sideways + z * z + _NOTHING)
            reach_i = self._reach(cos_i)
            lobe = _ndf(sideways, z, length, self.alpha) / reach_i
            values = self._reflected(si, 0.5 * length, x, y, z, lobe * cos_o / self._reach(cos_o), lit)
            density = 0.5 * lobe
        if diffuse:
            even = cos_o / math.pi
            albedo = self.diffuse_reflectance.eval(si, lit)
            values = [value + even * albedo[i] for i, value in enumerate(values)]
            share = self._share(cos_i) if glossy else 0.0
            density = share * density + (1 - share) * even
        if self._limit is not None:
            values = self._limited(si, cos_i, cos_o, values)
        result = mi.Spectrum(*[dr.select(lit, value, 0.0) for value in values])
        return result, dr.select(lit, density, 0.0)

    def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> tuple[Any, Any]:
        """A direction with its density, and f cos_o over that."""
        glossy, diffuse = self._enabled(ctx)
        found = mi.BSDFSample3f()
        if not (glossy or diffuse):
            return found, mi.Spectrum(0.0)
        active = active & (si.wi.z > 0)
        wo: Any = None
        which, flags = mi.UInt32(0), mi.UInt32(+mi.BSDFFlags.GlossyReflection)
        if glossy:
            normals = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, self.alpha, True)
            wo = mi.reflect(si.wi, normals.sample(si.wi, sample2)[0])
        if diffuse:
            of_lobe = (sample1 < self._share(si.wi.z)) if glossy else mi.Mask(False)
            even = mi.warp.square_to_cosine_hemisphere(sample2)
            wo = even if wo is None else dr.select(of_lobe, wo, even)
            which = dr.select(of_lobe, mi.UInt32(0), mi.UInt32(1))
            flags = dr.select(of_lobe, flags, mi.UInt32(+mi.BSDFFlags.DiffuseReflection))
        value, density = self.eval_pdf(ctx, si, wo, active)
        found.wo, found.pdf, found.eta = wo, density, 1.0
        found.sampled_component, found.sampled_type = which, flags
        per = dr.select(density > 0, 1 / dr.maximum(density, _NOTHING), 0.0)
        return found, mi.Spectrum(*[value[i] * per for i in range(len(self._channels))])

    def to_string(self) -> str:
        """Everything that a person may want to see of it."""
        names = ("alpha", "eta", "k", "int_ior", "diffuse_reflectance", "h", "w")
        shown = {name: getattr(self, name) for name in names}
        lines = [f"  {name} = {value}" for name, value in shown.items() if value is not None]
        if self._limit is not None:
            lines.append(f"  albedo limited, from {self._largest:.3f} at most")
        return "GGXShift[\n" + ",\n".join(lines) + "\n]"

    def _enabled(self, ctx: Any) -> tuple[bool, bool]:
        """Whether the lobe and the diffuse light are asked for."""
        glossy = ctx.is_enabled(mi.BSDFFlags.GlossyReflection, 0)
        diffuse = self.int_ior is not None and ctx.is_enabled(mi.BSDFFlags.DiffuseReflection, 1)
        return glossy, diffuse

    def _reach(self, cosine: Any) -> Any:
        """2 cos / G1 of a direction."""
        squared = cosine * cosine
        return cosine + dr.sqrt(dr.abs(squared + self.alpha * self.alpha * (1 - squared)))

    def _share(self, cos_i: Any) -> Any:
        """Part of the samples that follow the lobe of a dielectric: about that of the light which it reflects."""
        surface = mi.fresnel(dr.abs(cos_i), self.int_ior)[0]
        return surface / (surface + self._mean_albedo)

    def _reflected(self, si: Any, cos_d: Any, x: Any, y: Any, z: Any, lobe: Any, lit: Any) -> list[Any]:
        """[channels] `lobe` times Fresnel reflectance and shift; x, y, z lie along the half vector."""
        if self.int_ior is not None:
            values = [lobe * mi.fresnel(cos_d, self.int_ior)[0]] * len(self._channels)
        else:
            eta, k = self.eta.eval(si, lit), self.k.eval(si, lit)
            values = [
                lobe * mi.fresnel_conductor(cos_d, mi.Complex2f(eta[i], k[i])) for i in range(len(self._channels))
            ]
        if self.h is None:
            return values
        slope = 1e-3 * self.h * dr.cos(self.w * dr.atan2(dr.sqrt(x * x + y * y + _NOTHING), z))
        level = 1 - LAMBDA_N * slope
        wavelengths = si.wavelengths if mi.is_spectral else self._channels
        return [value * dr.maximum(level + slope * wavelengths[i], 0.0) for i, value in enumerate(values)]

    def _limited(self, si: Any, cos_i: Any, cos_o: Any, values: list[Any]) -> list[Any]:
        """[channels] `values` divided by the larger albedo of the two directions, where that is above one."""
        rows = [self._at_node(dr.sqrt(dr.maximum(cosine, 0.0)), 0) for cosine in (cos_i, cos_o)]
        limited = []
        for i, value in enumerate(values):
            if mi.is_spectral:
                column = (si.wavelengths[i] - SPECTRUM[0]) / (SPECTRUM[1] - SPECTRUM[0])
            else:
                column = i / max(len(values) - 1, 1)
            column = self._at_node(column, 1)
            one, other = (self._limit.eval(mi.Point2f(column, row))[0] for row in rows)
            limited.append(value / dr.maximum(one, other))
        return limited

    def _at_node(self, place: Any, axis: int) -> Any:
        """Texture coordinate of a place from 0 to 1, the first and the last node of the table."""
        nodes = self._shape[axis]
        return (place * (nodes - 1) + 0.5) / nodes

    def _prepare(self) -> None:
        """What follows from the parameters."""
        self._channels = _channels()
        self._mean_albedo = None if self.diffuse_reflectance is None else self.diffuse_reflectance.mean()
        self._limit: Any = None
        self._largest = 0.0
        if self.int_ior is None and self.h is None:
            return  # facets without a shift reflect no more than falls on them
        wavelengths, albedo = self._albedo()
        self._largest = float(albedo.max())
        if self._largest <= MOST:
            return
        self._shape = albedo.shape
        table = np.maximum(albedo, 1.0)[..., None].astype(np.float32)
        self._limit = mi.Texture2f(mi.TensorXf(table), wrap_mode=dr.WrapMode.Clamp)
        row, column = np.unravel_index(int(albedo.argmax()), albedo.shape)
        mi.Log(
            mi.LogLevel.Warn,
            f"{NAME} would reflect {self._largest:.3f} times the light that falls in at "
            f"{math.degrees(math.acos(_COSINES[row])):.0f} deg and {wavelengths[column]:.0f} nm; "
            "where it is more than all, f is divided by it.",
        )

    def _albedo(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """[columns] wavelengths, nm, and [angles, columns] the albedo there: what a white furnace would show."""
        wavelengths = np.linspace(*SPECTRUM, _COLUMNS) if mi.is_spectral else np.array(self._channels)
        alpha = _number(self.alpha)
        slope = None if self.h is None else (_number(self.h), _number(self.w))
        if self.int_ior is not None:
            ior = _number(self.int_ior)
            n, k = np.array(ior), np.array(0.0)
        else:
            n, k = (_tabulated(texture, wavelengths) for texture in (self.eta, self.k))
        albedo = np.array([_lobe_albedo(cosine, alpha, n, k, slope, wavelengths) for cosine in _COSINES])
        if self.diffuse_reflectance is not None:
            albedo += _tabulated(self.diffuse_reflectance, wavelengths)
        return wavelengths, albedo


def _ndf(sideways: Any, z: Any, length: Any, alpha: Any) -> Any:
    """D of GGX at a half vector of `length` (Eq. 33 of Walter et al.), in a form that is exact for small alpha.

    `sideways` is the square of the half vector's part along the surface, `z` the other one.
    """
    stretched = (sideways / (alpha * alpha) + z * z) / (length * length)
    return 1 / (math.pi * alpha * alpha * stretched * stretched)


def _channels() -> list[float]:
    """Wavelength of each channel of the variant, nm; of a spectral one the ray tells them."""
    if mi.is_spectral:
        return [LAMBDA_N] * dr.size_v(mi.Spectrum)
    return list(RGB_CENTROIDS) if mi.is_rgb else [LUMINANCE_CENTROID]


def _number(value: Any) -> float:
    return float(np.ravel(np.array(dr.detach(value)))[0])


def _tabulated(texture: Any, wavelengths: NDArray[np.float64]) -> NDArray[np.float64]:
    """[wavelengths] a spectrum."""
    if not mi.is_spectral:
        return np.ravel(np.array(dr.detach(texture.eval(dr.zeros(mi.SurfaceInteraction3f))))).astype(float)
    found, size = [], dr.size_v(mi.Spectrum)
    for start in range(0, wavelengths.size, size):
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wavelengths = mi.Spectrum(*wavelengths[start : start + size].tolist())
        found.append(np.ravel(np.array(dr.detach(texture.eval(si)))))
    return np.concatenate(found).astype(float)


def _lobe_albedo(
    cos_i: float,
    alpha: float,
    n: NDArray[np.float64],
    k: NDArray[np.float64],
    slope: tuple[float, float] | None,
    wavelengths: NDArray[np.float64],
) -> NDArray[np.float64]:
    """[wavelengths] directional albedo of the surface alone, n and k [wavelengths].

    Summed over half vectors, with dω_o = 4 cos_d dω_m (Walter et al. 2007, Eq. 14) and tan theta_m = alpha tan(t).
    """
    t = (np.arange(64) + 0.5) / 64 * (math.pi / 2)
    azimuth = (np.arange(24) + 0.5) / 24 * math.pi
    theta = np.arctan(alpha * np.tan(t))
    by_t = alpha / (np.cos(t) ** 2 + (alpha * np.sin(t)) ** 2) * (math.pi / 2 / 64)
    z, across = np.cos(theta)[:, None], np.sin(theta)[:, None]
    cos_d = z * cos_i + across * math.sqrt(1 - cos_i**2) * np.cos(azimuth)
    cos_o = 2 * cos_d * z - cos_i
    reach_i, reach_o = (c + np.sqrt(c**2 + alpha**2 * (1 - c**2)) for c in (cos_i, np.maximum(cos_o, 0)))
    lit = (cos_d > 0) & (cos_o > 0)
    facets = lit * _ndf(across**2, z, 1.0, alpha) * cos_o / (reach_i * reach_o)
    weight = facets * 4 * cos_d * (across * by_t[:, None]) * (2 * math.pi / 24)
    reflected = weight[..., None] * _fresnel(np.where(lit, cos_d, 1.0)[..., None], n, k)
    if slope is not None:
        m = slope[0] * np.cos(slope[1] * theta)[:, None, None]
        reflected = reflected * np.maximum(1 + m * (wavelengths - LAMBDA_N) * 1e-3, 0)
    return np.asarray(np.broadcast_to(reflected.sum(axis=(0, 1)), wavelengths.shape))


def _fresnel(cos_d: NDArray[np.float64], n: NDArray[np.float64], k: NDArray[np.float64]) -> NDArray[np.float64]:
    """Reflectance of an interface to n + ik for unpolarised light, by its two amplitudes."""
    index = n + 1j * k
    inside = np.sqrt(index**2 - 1 + cos_d**2)
    s = (cos_d - inside) / (cos_d + inside)
    p = (index**2 * cos_d - inside) / (index**2 * cos_d + inside)
    return np.asarray(0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2))


def register() -> None:
    """Make the plugin known to the variant that is in use."""
    # a class of Mitsuba has one base only, and it is another one in every variant
    own = {name: value for name, value in vars(GGXShift).items() if name not in {"__dict__", "__weakref__"}}
    mi.register_bsdf(NAME, type(GGXShift.__name__, (mi.BSDF,), own))


def _whenever_a_variant_is_chosen() -> None:
    mi.detail.add_variant_callback(lambda _old, _new: register())
    if mi.variant() is not None:
        register()


_whenever_a_variant_is_chosen()

if __name__ == "__main__":
    mi.set_variant(*sys.argv[3:4] or ["scalar_spectral"])
    mi.Bitmap(mi.render(mi.load_file(sys.argv[1]))).write(sys.argv[2])
