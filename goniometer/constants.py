"""What calibration needs to know about the devices and the bench, besides the counts."""

from dataclasses import dataclass

from drivers.arrays import FloatArray


@dataclass(frozen=True)
class BenchData:
    """What is known of a bench beyond what its devices say: from data sheets and from characterisation.

    Everything that begins with `u_` is a standard uncertainty (coverage factor 1) and enters every budget.
    """

    gain: float = 5.0
    """Electrons per count, for the shot noise."""
    aperture: float = 1.0
    """Full angle of the detector's round aperture, degrees."""
    u_aperture: float = 0.02
    """Of `aperture`, degrees."""
    field_of_view: float = 2.5
    """Diameter of what the detector sees of the sample at normal view, mm; it is longer by 1 / cos(theta_out)."""
    u_field_of_view: float = 0.1
    """Of `field_of_view`, mm."""
    u_angle: float = 0.005
    """How well one stage position repeats, degrees; independent between moves of a stage."""
    u_zero: float = 0.01
    """Of the zero of each stage, degrees; the same error for all positions."""
    u_nonlinearity: float = 0.002
    """Relative error that the detector's own polynomial leaves at full scale; proportional to the counts."""
    wavelength_offset: float = 0.0
    """To be added to the wavelengths that the spectrometer's coefficients give, nm."""
    u_wavelength: float = 0.1
    """Of the wavelength scale, nm; the same shift for all pixels."""
    u_stray_light: float = 1e-4
    """Of the stray light where none was measured, as BRDF times cos(theta_in), 1/sr."""
    u_lamp: float = 0.005
    """Relative drift of the lamp over a scan, and between two scans, that no monitor exposures tell of."""


@dataclass(frozen=True)
class Constants:
    """What stays as it is during a scan; stored with every scan."""

    spectrometer: str
    """What the spectrometer calls itself: maker, model, serial number."""
    stages: dict[str, str]
    """What each stage calls itself, by its name; some know no more than the address they answer at."""
    wavelengths: FloatArray
    """[pixels] nanometres, from the spectrometer's own coefficients."""
    nonlinearity: FloatArray
    """[coefficients] of the polynomial in dark-subtracted counts by which these are divided."""
    saturation: int
    """Counts at and above which a pixel is saturated."""
    bench: BenchData
