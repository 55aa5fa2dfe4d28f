"""Materials of the simulated bench that are files: `file:PATH` in a campaign.

Once a run knows what is in the file, the name also says that: `file:PATH#sha256=DIGEST;nm=LOWEST-HIGHEST`. So what was
mounted stands in the database, another file in its place is noticed, and nothing is calibrated at wavelengths of which
the file knows nothing.
"""

import re
from pathlib import Path
from typing import NamedTuple

_PREFIX = "file:"
_NAME = re.compile(r"file:(?P<path>.+?)(#sha256=(?P<sha256>[0-9a-f]{64});nm=(?P<lowest>[\d.]+)-(?P<highest>[\d.]+))?")


class Content(NamedTuple):
    """What is in the file."""

    sha256: str
    """In hexadecimal digits."""
    lowest: float
    """Shortest wavelength, nm."""
    highest: float
    """Longest wavelength, nm."""


class MaterialFile(NamedTuple):
    """What a name says of the file that a material is read from."""

    path: Path
    content: Content | None = None
    """None where the name does not say it."""

    def __str__(self) -> str:
        """The name, which `material_file` reads."""
        known = "" if self.content is None else "#sha256={};nm={!r}-{!r}".format(*self.content)
        return f"{_PREFIX}{self.path}{known}"

    @property
    def identity(self) -> str:
        """What stays the same when the file is moved: its content, or its bare name where that is not known."""
        return self.path.name if self.content is None else self.content.sha256


def material_file(material: str) -> MaterialFile | None:
    """The file of a material; None for one that is no file.

    >>> material_file("sample-1")
    >>> str(material_file("file:waves.npz"))
    'file:waves.npz'
    """
    found = _NAME.fullmatch(material)
    if found is None:
        return None
    content = found["sha256"] and Content(found["sha256"], float(found["lowest"]), float(found["highest"]))
    return MaterialFile(Path(found["path"]), content or None)
