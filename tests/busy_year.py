"""The database of a lab that measures day and night for a year, written in bulk.

A campaign measures the panel and nine samples: 350 and 294 or 295 spectra, 100 directions a sample. Of ten datasets
nine are of a campaign, and one is a recalibration, an import or a simulation. Numbers of a few drawn datasets and their
fits, and a thousand drawn spectra, serve for all; everything else of every row is its own. Rows are made by the
functions that make them when a bench measures.
"""

import json
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import Connection, create_engine, event, insert

from analysis.fits.analyse import analyse
from analysis.fits.fit_json import analysis_to_json, fit_to_json
from drivers.interfaces import Spectrum
from goniometer.campaigns.campaign import Campaign, Sample
from goniometer.certificates.certificate_file import certificate_csv
from goniometer.constants import BenchData, Constants
from goniometer.datasets.dataset import Check, Dataset, Flag
from goniometer.geometry import Geometry
from goniometer.storage import tables
from goniometer.storage.catalogue import facts_of
from goniometer.storage.derived import software_version
from goniometer.storage.records import constants_json, exposure_row, pack_dataset
from goniometer.storage.service_tables import queue
from goniometer.storage.store import Store
from goniometer.uncertainty import ErrorSource
from simulators.materials.materials import PANEL_CERTIFICATE
from tests.drawn_dataset import drawn_dataset

SAMPLES = 9
"""Of a campaign."""
PIXELS = 1044
NAMES = 2500
"""Different samples of the year."""
BEGINNING = datetime(2025, 1, 1, tzinfo=UTC)
_POINTS = 100
_REFERENCE_POINTS = 160
_SPECTRA = 1000
_FOUND = "What was found, in a sentence or two; with numbers. " * 3


@dataclass(frozen=True)
class Drawn:
    """A dataset that serves many rows."""

    dataset: Dataset
    facts: dict[str, object]
    arrays: bytes
    fits: dict[str, str]


def spectra_of(campaigns: int) -> int:
    """Spectra of so many campaigns."""
    return campaigns * (350 + SAMPLES * 294 + 5)


def write_year(file: Path, datasets: int, share: float = 1.0, seed: int = 1) -> None:
    """Write the database `file`, which is not there yet; a `share` of the campaigns has its numbers, the others' lack.

    Every tenth campaign, and so on by `share`, counted from the newest, so that those are spread over the year.
    """
    Store.open(file).close()
    engine = create_engine(f"sqlite:///{file}")

    @event.listens_for(engine, "connect")
    def fast(connection: Any, _: object) -> None:
        for pragma in ("journal_mode=OFF", "synchronous=OFF", "cache_size=-200000"):
            connection.execute(f"PRAGMA {pragma}")

    year = _Year(np.random.default_rng(seed), datasets, share)
    for campaign in range(1, year.campaigns + 1):
        with engine.begin() as connection:
            year.write(connection, campaign)
    with engine.begin() as connection:
        year.write_others(connection)
    engine.dispose()


class _Year:
    """Counts the rows, and writes them campaign by campaign."""

    def __init__(self, random: np.random.Generator, datasets: int, share: float) -> None:
        self.campaigns = max(1, round(0.9 * datasets / SAMPLES))
        self._random = random
        self._others = datasets - self.campaigns * SAMPLES
        self._share = share
        self._drawn = [_drawn(name, random) for name in ("sample-1", "sample-4")]
        self._counts = [_spectrum(random, i) for i in range(_SPECTRA)]
        self._constants = constants_json(
            Constants(
                "QE Pro QEP00001",
                {"sample stage": "SMC100"},
                np.linspace(350, 1100, PIXELS),
                np.array([0.998, 5e-8]),
                200_000,
                BenchData(),
            )
        )
        self._certificate = certificate_csv(PANEL_CERTIFICATE)
        self._scan = self._point = self._exposure = self._dataset = self._fit = 0

    def write(self, connection: Connection, number: int) -> None:
        """A campaign with all that was made of it."""
        begun = BEGINNING + timedelta(days=365) * (number - 1) / self.campaigns
        full = int(number * self._share) > int((number - 1) * self._share)
        names = [f"Sheet {1 + (number * SAMPLES + i) % NAMES:04d}" for i in range(SAMPLES)]
        campaign = Campaign(
            name=f"Campaign {number:04d}", samples=tuple(Sample(name=name, material="sample-1") for name in names)
        )
        connection.execute(
            insert(tables.campaigns).values(
                id=number,
                name=campaign.name,
                json=campaign.canonical_json,
                hash=campaign.hash,
                certificate=self._certificate,
                created=_text(begun),
            )
        )
        ended = _text(begun + timedelta(minutes=450))
        connection.execute(
            insert(queue).values(
                position=0,
                name=campaign.name,
                json=campaign.canonical_json,
                campaign_id=number,
                phase="finished",
                outcome="completed",
                who=f"Operator {number % 5}",
                created=_text(begun),
                ordered=_text(begun),
                started=_text(begun),
                finished=ended,
            )
        )
        reference: dict[str, list[int]] = {}
        for place in range(SAMPLES + 1):
            ends = begun + timedelta(minutes=45) * (place + 1)
            self._scan += 1
            connection.execute(
                insert(tables.scans).values(
                    id=self._scan,
                    campaign_id=number,
                    number=place,
                    kind="sample" if place else "reference",
                    sample=names[place - 1] if place else "reference",
                    material="sample-1" if place else "spectralon",
                    phase="finished",
                    outcome="completed",
                    constants=self._constants,
                    started=_text(ends - timedelta(minutes=45)),
                    finished=_text(ends),
                )
            )
            if not place:
                reference = self._raw(connection, _REFERENCE_POINTS, 320, (8, 18, 4), ends, full=full)
                continue
            spectra = 194 if place < SAMPLES // 2 + 1 else 195
            ids = self._raw(connection, _POINTS, spectra, (60, 18, 22), ends, full=full)
            lineage = {
                "scan": self._scan,
                **ids,
                "reference_scan": self._scan - place,
                **{f"reference_{name}": those for name, those in reference.items()},
                "scans_between": [],
                "certificate": "nominal SRS-99",
                "certificate_override": "Night shift: the panel is being recalibrated.",
                "devices": {"spectrometer": "QE Pro QEP00001", "sample stage": "SMC100"},
                "corrections": {"dark": "made", "drift": "made", "aperture": "not made"},
                "software_version": software_version(),
                "spot_scan": None,
            }
            self._derived(connection, self._scan, names[place - 1], lineage, ends, full=full)

    def write_others(self, connection: Connection) -> None:
        """What came by another way, at the end of the year: recalibrations, imports and simulations."""
        for i in range(self._others):
            when = BEGINNING + timedelta(days=365, minutes=i)
            if i % 2 == 0:
                # the scans of samples of a campaign stand behind that of its reference
                source = int(self._random.integers(self.campaigns * SAMPLES))
                scan = source // SAMPLES * (SAMPLES + 1) + source % SAMPLES + 2
                lineage: dict[str, object] = {"scan": scan, "reference_scan": scan - source % SAMPLES - 1}
                lineage |= {"recalibrated_from": source + 1, "exposures": [], "spot_scan": None, "scans_between": []}
                name = f"Sheet {1 + (SAMPLES + source) % NAMES:04d}"
                self._derived(connection, scan, name, lineage, when, full=self._share == 1 or i % 20 == 0)
            else:
                how = "imported" if i % 4 == 1 else "simulated"
                lineage = {how: f"{how}-{i}.json", "sha256": f"{i:064x}"}
                self._derived(connection, None, f"{how.title()} {i}", lineage, when, full=True)

    def _raw(
        self,
        connection: Connection,
        points: int,
        light: int,
        besides: tuple[int, int, int],
        when: datetime,
        *,
        full: bool,
    ) -> dict[str, list[int]]:
        """Points and exposures of a scan; `besides` are darks, stray light and monitors. Returns ids by kind."""
        rows: list[dict[str, object]] = []
        ids: dict[str, list[int]] = {"exposures": [], "darks": [], "stray": [], "monitors": []}

        def expose(name: str, kind: Any, point: int | None, geometry: Geometry | None, time: float) -> None:
            self._exposure += 1
            # what tells of the lamp in the reference scans is there for all
            told = full or (points == _REFERENCE_POINTS and kind in {"dark", "monitor"})
            counts = self._counts[self._exposure % _SPECTRA] if told else self._counts[0][:1]
            spectrum = Spectrum(counts, time, self._exposure, -10.0)
            # darks were read in a row
            moment = 9.5 * self._scan if kind == "dark" else 9.5 * self._exposure
            row = exposure_row(self._scan, point, kind, geometry, "year", moment, spectrum)
            rows.append(row | {"id": self._exposure})
            ids[name].append(self._exposure)

        for _ in range(besides[0]):
            expose("darks", "dark", None, None, 0.5)
        for _ in range(besides[1]):
            expose("stray", "stray", None, Geometry(30.0, -30.0), 0.5)
        of_points = []
        monitors = np.linspace(0, points - 1, besides[2]).astype(int).tolist()
        for number in range(points):
            self._point += 1
            here = Geometry(10.0 * (number % 9), 1.5 * (number % 97) - 70)
            of_points.append(
                {
                    "id": self._point,
                    "scan_id": self._scan,
                    "number": number,
                    "theta_in": here.theta_in,
                    "theta_out": here.theta_out,
                    "read_theta_in": here.theta_in + 0.001,
                    "read_theta_out": here.theta_out - 0.001,
                    "status": "done",
                    "attempts": 1,
                    "reason": "",
                    "seconds": 21.5,
                    "signal_to_noise": 150.0,
                    "finished": _text(when),
                }
            )
            for _ in range((number + 1) * light // points - number * light // points):
                expose("exposures", "light", self._point, here, 0.5)
            for _ in range(monitors.count(number)):
                expose("monitors", "monitor", None, Geometry(30.0, 30.0), 0.5)
        connection.execute(insert(tables.points), of_points)
        connection.execute(insert(tables.exposures), rows)
        return ids

    def _derived(
        self,
        connection: Connection,
        scan: int | None,
        name: str,
        lineage: dict[str, object],
        when: datetime,
        *,
        full: bool,
    ) -> None:
        """A dataset and its fits."""
        self._dataset += 1
        drawn = self._drawn[self._dataset % len(self._drawn)]
        here = drawn.facts | facts_about(lineage) | {"sample": name, "content_hash": self._random.bytes(32).hex()}
        if self._dataset % 300 == 0:  # a flag that is rare
            here |= {"flags": int(Flag.SATURATED), "flagged": 2}
        connection.execute(
            insert(tables.datasets).values(
                **here,
                id=self._dataset,
                scan_id=scan,
                checks=json.dumps([asdict(check) for check in drawn.dataset.checks]),
                lineage=json.dumps(lineage, sort_keys=True),
                arrays=drawn.arrays if full else b"",
                software_version=software_version(),
                created=_text(when),
            )
        )
        rows = []
        for model, text in drawn.fits.items():
            self._fit += 1
            said = {"id": self._fit, "dataset_id": self._dataset, "model": model, "json": text if full else "{}"}
            rows.append(said | {"software_version": software_version(), "created": _text(when)})
        connection.execute(insert(tables.fits), rows)


def facts_about(lineage: dict[str, object]) -> dict[str, object]:
    """What the lineage changes in the line of a list."""
    kind = "simulated" if "simulated" in lineage else "imported" if "imported" in lineage else "measured"
    return {"kind": kind, "recalibrated_from": lineage.get("recalibrated_from")}


def _drawn(name: str, random: np.random.Generator) -> Drawn:
    """A dataset of as many directions, wavelengths and sources of error as one of the bench has, with its fits."""
    dataset = drawn_dataset(name)
    chosen = np.unique(np.linspace(0, dataset.theta_in.size - 1, _POINTS).astype(np.intp))
    dataset = dataset.at_points(chosen)
    fine = np.linspace(383, 995, 134)
    columns = np.clip(np.searchsorted(dataset.wavelengths, fine), 0, dataset.wavelengths.size - 1)
    dataset = replace(dataset.at_wavelengths(columns), wavelengths=fine)
    parts = [
        ErrorSource(f"part {i}", "reference", 1e-4 * dataset.brdf * random.random(dataset.brdf.shape), None, True)
        for i in range(16)
    ]
    flags = dataset.flags.copy()
    flags[::50] = int(Flag.BELOW_NOISE)
    checks = tuple(Check(f"check {i}", True, _FOUND) for i in range(6))
    dataset = replace(dataset, sources=(*dataset.sources, *parts), flags=flags, checks=checks)
    analysis = analyse(dataset)
    metal = analysis.conductor
    fits = {fit.model: fit_to_json(fit, dataset, analysis.differences[fit.model], metal) for fit in analysis.models}
    fits["analysis"] = analysis_to_json(analysis, metal)
    return Drawn(dataset, facts_of(dataset), pack_dataset(dataset), fits)


def _spectrum(random: np.random.Generator, number: int) -> np.ndarray:
    """[pixels] counts of a lamp at one of many brightnesses, with the noise of photons and of the electronics."""
    pixel = np.arange(PIXELS) / PIXELS
    light = 10 ** random.uniform(2, 5) * (number % 8 > 0) * np.exp(-(((pixel - 0.55) / 0.25) ** 2))
    return np.rint(1500 + random.poisson(light) + random.normal(0, 8, PIXELS)).astype(np.uint32)


def _text(moment: datetime) -> str:
    return moment.isoformat(timespec="milliseconds")


def octets(file: Path) -> dict[str, int]:
    """Octets of every table and index of an SQLite file, by its name."""
    engine = create_engine(f"sqlite:///{file}")
    with engine.connect() as connection:
        rows = connection.exec_driver_sql("SELECT name, sum(pgsize) FROM dbstat GROUP BY name").all()
    engine.dispose()
    return {str(name): int(size) for name, size in rows}
