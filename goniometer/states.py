"""Kinds of scans and exposures and the states that they pass through, by name; loads nothing."""

from typing import Literal

Kind = Literal["reference", "sample", "spot"]
"""A spot is another place, or another azimuth, of the sample before it, measured at a few of its directions."""
ExposureKind = Literal["light", "dark", "stray", "monitor", "sweep"]
"""A sweep is a reading of the detector while its arm moves."""
EXPOSURE_KINDS: tuple[ExposureKind, ...] = ("light", "dark", "stray", "monitor", "sweep")
Phase = Literal["idle", "running", "pausing", "paused", "aborting", "finished"]
ACTIVE_PHASES: frozenset[Phase] = frozenset({"running", "pausing", "paused", "aborting"})
"""Of a scan that some process is running, or was when it was killed."""
Outcome = Literal["completed", "aborted", "failed"]
Command = Literal["pause", "resume", "abort"]
Status = Literal["pending", "running", "done", "failed", "skipped"]
