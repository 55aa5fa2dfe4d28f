"""What a person is asked to lay on the bench, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from goniometer.storage.records import Scan


def mount_request(scan: Scan) -> tuple[str, str]:
    """What to do, and what to check then, as two sentences without their full stops."""
    what = "the reference panel (Spectralon)" if scan.kind == "reference" else scan.sample
    check = "check that it lies flat against the holder"
    if scan.kind == "spot":
        return f"Turn {what} by 90° about its normal, or move it so that the light falls on another place", check
    return f"Mount {what}", check
