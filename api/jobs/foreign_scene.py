"""Scenes that somebody has sent: they may name no file and no plugin but Mitsuba's own.

Mitsuba loads what a scene names, be it a file of this machine, of which its messages then quote lines, or a plugin,
which is a program.
"""

import re
from xml.etree.ElementTree import Element  # nosec B405 # nothing is parsed by it

from analysis.mitsuba.scene import parsed_xml
from goniometer.errors import InputError

_PLUGIN = re.compile(r"[a-z][a-z0-9_]*")


def check_foreign_scene(text: str) -> None:
    """Raise `InputError` where the XML of a scene of Mitsuba reaches for a file, or is none."""
    try:
        root = parsed_xml(text)
    except ValueError as error:
        raise InputError(f"scene: it is not valid XML: {error}") from None
    for element in root.iter():
        if (named := _outside(element)) is not None:
            raise InputError(
                f"scene: <{element.tag[:40]}> names {named[:80]!r}, but a scene that is sent may name no file and only "
                f"plugins of Mitsuba itself; describe it by shapes and numbers, or use: goniometer choose"
            )


def _outside(element: Element) -> str | None:
    """What an element names that is no part of the scene; None if nothing."""
    kind, name, value = (element.get(key, "") for key in ("type", "name", "value"))
    if element.tag in {"include", "path"}:
        return element.get("filename") or value
    if "filename" in element.attrib:
        return element.attrib["filename"]
    if "type" in element.attrib and not _PLUGIN.fullmatch(kind):
        return kind
    # "$" takes the place of any part of an attribute
    if "filename" in name.lower() or "$" in name:
        return value or name
    if element.tag in {"string", "default", "spectrum"} and any(each in value for each in "/\\"):
        return value
    return None
