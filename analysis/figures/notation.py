"""How a person reads a number with its uncertainty."""

import math
from decimal import Decimal

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def with_uncertainty(value: float, standard_uncertainty: float) -> str:
    """Concise notation (JCGM 100:2008, 7.2.2): two digits of the uncertainty in brackets, on the last digits.

    >>> with_uncertainty(1.23412, 0.01234)
    '1.234(12)'
    >>> with_uncertainty(0.0000123412, 1.234e-7)
    '1.234(12) × 10⁻⁵'

    A value without a finite positive uncertainty is written with six digits and says so.
    """
    if not math.isfinite(value):
        return "no value"
    if not (math.isfinite(standard_uncertainty) and standard_uncertainty > 0):
        return f"{value:.6g} (uncertainty not determined)".replace("-", "−")
    size = max(abs(value), standard_uncertainty)
    power = math.floor(math.log10(size))
    power = 0 if -4 <= power < 6 else power
    last = math.floor(math.log10(standard_uncertainty)) - 1
    digits = round(standard_uncertainty * 10.0**-last)
    if digits == 100:  # 0.0996 is 0.10, with two digits again
        digits, last = 10, last + 1
    places = power - last
    scaled = Decimal(repr(float(value))).scaleb(-power)
    if places <= 0:
        return f"{round(scaled, places) + 0:.0f}({digits * 10**-places:d}){_times(power)}".replace("-", "−")
    shown = f"{digits / 10**places:.{max(places, 0)}f}" if places == 1 and digits >= 10 else str(digits)
    return f"{scaled:.{places}f}({shown}){_times(power)}".replace("-", "−")


def roughly(value: float) -> str:
    """A value that nobody should quote: two digits and no uncertainty, because the fit behind it is not trusted.

    >>> roughly(0.0045018)
    '≈ 0.0045'
    """
    return f"≈ {value:.2g}".replace("-", "−")


def uncertainty(value: float) -> str:
    """An uncertainty on its own, with two digits (JCGM 100:2008, 7.2.6).

    >>> uncertainty(0.00471), uncertainty(0.0000551), uncertainty(0.0996)
    ('0.0047', '5.5 × 10⁻⁵', '0.10')
    """
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    digits, exponent = f"{value:.1e}".split("e")
    power = int(exponent)
    if -4 <= power < 2:
        return f"{float(f'{value:.1e}'):.{1 - power}f}"
    return f"{digits}{_times(power)}"


def superscript(power: int) -> str:
    """A whole number as an exponent.

    >>> superscript(-12)
    '⁻¹²'
    """
    return str(power).translate(_SUPERSCRIPT)


def _times(power: int) -> str:
    return f" × 10{superscript(power)}" if power else ""
