"""Databases as every version of the program that there ever was made them, with rows in every table."""

import io
import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

SCHEMAS = sorted(Path(__file__).with_name("old_schemas").glob("*.sql"))
"""The tables, as SQLite told them of a database that the program of that time had made."""

TAKEN = "2026-01-02T03:04:05.678+00:00"
COUNTS = np.arange(1044, dtype="<u4").tobytes()
CAMPAIGNS = {
    1: {
        "incident": {"start": 0.0, "step": 10.0, "stop": 80.0},
        "integration": {"fill": 0.7, "maximum": 30.0, "minimum": 0.008, "scans": 1},
        "name": "First",
        "outgoing": {"start": -85.0, "stop": 85.0},
        "reference": {"certificate": None, "scans": 2, "step": 10.0},
        "resolution": {"coarse_step": 10.0, "minimum_step": 0.5, "tolerance": 0.02},
        "samples": [{"description": "", "material": "sample-1", "name": "A", "preparation": ""}],
        "seed": 0,
    },
    5: {
        "conditions": {
            "cooler_stable": True,
            "lamp_change": None,
            "lamp_change_within": 60.0,
            "lamp_warm": None,
            "patience": 3600.0,
        },
        "homogeneity": None,
        "incident": {"start": 0.0, "step": 10.0, "stop": 80.0},
        "integration": {
            "exposures": 1,
            "fill": 0.7,
            "maximum": 30.0,
            "minimum": 0.008,
            "scans": 1,
            "signal_to_noise": None,
            "time_limit": 120.0,
        },
        "monitor": {"every": 600.0},
        "name": "First",
        "outgoing": {"start": -85.0, "stop": 85.0},
        "prescan": None,
        "reference": {
            "certificate": None,
            "diameter": 50.0,
            "every_round": False,
            "override": None,
            "scans": 2,
            "step": 10.0,
        },
        "resolution": {
            "colour_tolerance": 0.2,
            "minimum_step": 0.2,
            "mode": "dynamic",
            "points": None,
            "step": 1.0,
            "time": None,
            "tolerance": 0.005,
        },
        "rounds": 1,
        "samples": [
            {
                "description": "",
                "diameter": 50.0,
                "material": "sample-1",
                "name": "A",
                "preparation": "",
                "repeats": 1,
                "wait": 0.0,
            }
        ],
        "seed": 0,
        "stray_light": True,
    },
}
"""A campaign as the program wrote it from a version on."""
CONSTANTS = {
    "spectrometer": "QE Pro",
    "stages": {"sample stage": "SMC100"},
    "wavelengths": [400.0, 700.0],
    "nonlinearity": [1.0, 0.0],
    "saturation": 200000,
}
BENCH = {"gain": 4.5, "u_angle": 0.006, "aperture": 1.1}
LINEAGE = json.dumps({"scan": 2})
COMMON: dict[str, dict[str, Any]] = {
    "campaigns": {"id": 1, "name": "First", "hash": "h", "certificate": "text", "created": TAKEN},
    "scans": {
        "id": 2,
        "campaign_id": 1,
        "number": 0,
        "kind": "sample",
        "sample": "A",
        "material": "m",
        "phase": "finished",
        "outcome": "completed",
        "reason": "",
        "started": TAKEN,
        "finished": TAKEN,
    },
    "points": {
        "id": 3,
        "scan_id": 2,
        "number": 0,
        "theta_in": 10.0,
        "theta_out": 20.0,
        "read_theta_in": 10.01,
        "read_theta_out": 20.02,
        "status": "done",
        "attempts": 1,
        "reason": "",
        "seconds": 4.5,
        "finished": TAKEN,
    },
    "fits": {"id": 5, "dataset_id": 4, "model": "global", "json": "{}", "software_version": "0.1.0", "created": TAKEN},
    "exports": {"id": 6, "dataset_id": 4, "path": "a.json", "format": "json", "sha256": "s", "created": TAKEN},
    "characterisations": {"id": 7, "kind": "noise", "json": "{}", "software_version": "0.1.0", "created": TAKEN},
    "users": {"name": "ada", "role": "admin", "disabled": 0, "created": TAKEN},
    "tokens": {"id": 8, "user": "ada", "label": "l", "role": "admin", "hash": "t", "created": TAKEN},
    "sessions": {"hash": "s", "user": "ada", "token_id": 8, "created": TAKEN, "used": TAKEN},
    "logins": {"name": "ada", "address": "::1", "failures": 1, "failed": 1.0, "succeeded": 2.0},
    "log": {
        "sequence": 1,
        "time": TAKEN,
        "who": "ada",
        "via": "cli",
        "action": "run",
        "about": "{}",
        "previous": "0",
        "hash": "1",
    },
    "lease": {"id": 1, "term": 2, "beat": 3, "host": "h", "process": 4, "url": "u", "taken": TAKEN, "stop": 0},
    "queue": {
        "id": 9,
        "position": 1,
        "name": "First",
        "json": "{}",
        "campaign_id": 1,
        "phase": "queued",
        "reason": "",
        "who": "ada",
        "created": TAKEN,
    },
    "jobs": {
        "id": 10,
        "kind": "fit",
        "who": "ada",
        "state": "done",
        "words": "",
        "reason": "",
        "runner": "r",
        "beat": 1.0,
        "created": TAKEN,
        "arguments": "{}",
    },
    "certificates": {"sha256": "c", "name": "panel", "text": "t", "who": "ada", "created": TAKEN},
}
DATASET = {
    "id": 4,
    "scan_id": 2,
    "sample": "A",
    "kind": "measured",
    "points": 2,
    "incident_angles": 1,
    "shortest": 400.0,
    "longest": 700.0,
    "flags": 1,
    "flagged": 1,
    "checks_failed": 1,
    "content_hash": "hash of its time",
    "software_version": "0.1.0",
    "created": TAKEN,
    "checks": json.dumps([{"name": "reciprocity", "passed": False, "message": "Not so."}]),
    "lineage": LINEAGE,
}


def version_of(schema: Path) -> int:
    """The number that `about` gives a database of this schema."""
    return int(schema.stem.split("_")[1])


def build(schema: Path, file: Path) -> None:
    """Make a database of an old version."""
    version = version_of(schema)
    with closing(sqlite3.connect(file)) as connection, connection:
        connection.executescript(schema.read_text())
        _insert(connection, "about", {"application": "goniometer", "schema_version": version})
        tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        constants = CONSTANTS | (BENCH if version < 3 else {"bench": BENCH})
        own = {
            "campaigns": {
                "json": json.dumps(CAMPAIGNS[1 if version < 5 else 5], sort_keys=True, separators=(",", ":"))
            },
            "scans": {"constants": json.dumps(constants, sort_keys=True)},
        }
        for table, row in COMMON.items():
            if table in tables:
                _insert(connection, table, row | own.get(table, {}))
        _insert(connection, "datasets", DATASET | {"arrays": packed(version, "3_cert" in schema.stem)})
        for values in ({"id": 11, "kind": "dark"}, {"id": 12, "kind": "light", "point_id": 3}):
            where = {"theta_in": 10.01, "theta_out": 20.02} if values["kind"] == "light" else {}
            read = {"integration_time": 0.25, "counts": COUNTS, "device_count": 7, "detector_temperature": -10.125}
            clock = {"session": "s1", "moment": 12.5, "taken": TAKEN}
            _insert(connection, "exposures", {"scan_id": 2} | values | where | read | clock)


def _insert(connection: sqlite3.Connection, table: str, row: dict[str, Any]) -> None:
    """Add a row with what this version of the table has columns for."""
    columns = [column for _, column, *_ in connection.execute(f"PRAGMA table_info({table})") if column in row]
    marks = ", ".join("?" * len(columns))
    connection.execute(f"INSERT INTO {table} ({', '.join(columns)}) VALUES ({marks})", [row[c] for c in columns])


def packed(version: int, with_zero: bool = False) -> bytes:
    """The numbers of two points at two wavelengths, as this version stored them."""
    brdf = np.array([[0.1, 0.2], [np.nan, 0.4]])
    arrays: dict[str, Any] = {
        "theta_in": np.array([10.01, 10.0]),
        "theta_out": np.array([20.02, 30.0]),
        "wavelengths": np.array([400.0, 700.0]),
        "brdf": brdf,
        "u_angle": 0.02,
        "aperture": 1.5,
    }
    noise, shared = brdf / 100, brdf / 50
    if version <= 2:
        arrays |= {"u_random": noise, "u_reference": shared, "saturated": np.array([False, True])}
        if version == 2:
            arrays |= {"u_dark": shared, "u_reference_dark": shared, "integration_time": np.array([0.25, 0.5])}
    else:
        about = [{"name": "random", "part": "random", "shared_by_wavelengths": False}]
        arrays |= {"flags": np.array([0, 1], dtype=np.uint16), "sources": json.dumps(about)}
        arrays["source_0"] = np.nan_to_num(noise)
        if version > 3 or with_zero:
            arrays["u_zero"] = 0.03
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()
