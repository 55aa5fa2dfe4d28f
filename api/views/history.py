"""How the bench has changed from scan to scan: its response to the white panel, lamp, detector and wavelength scale."""

import json
from functools import lru_cache

import numpy as np

from api.bodies.base import Number, number
from api.bodies.calibration import Band, History, ScanHistory, WavelengthHistory
from drivers.arrays import FloatArray
from goniometer.datasets.checks import SAME_DIRECTION
from goniometer.errors import CalibrationError
from goniometer.radiometry.drift import lamp_drift
from goniometer.radiometry.raw import read_raw
from goniometer.radiometry.signal import CORRECTIONS_OF_A_SHOT, linear
from goniometer.storage.look_up import detector_temperatures
from goniometer.storage.records import Scan
from goniometer.storage.store import Store

BANDS_NM = (450.0, 600.0, 750.0)
"""Middles of the bands in which the response is told."""
HALF_BAND_NM = 5.0
"""Over which pixels are averaged on either side."""


def history(store: Store, limit: int) -> History:
    """The newest `limit` scans that are over, and all measurements of the wavelength scale."""
    benches = store.benches()
    mine = (scan for scan in store.scans() if benches[scan.campaign_id] == store.bench)
    over = [scan for scan in mine if scan.phase == "finished" and scan.started is not None]
    over.sort(key=lambda scan: (scan.started or "", scan.id))
    shown = over[-limit:]
    names = store.campaigns()
    temperatures = detector_temperatures(store, [scan.id for scan in shown])
    panel = next((scan for scan in over if scan.kind == "reference" and scan.outcome == "completed"), None)
    stated = store.constants(shown[-1].id).bench if shown else None
    return History(
        bench=store.bench,
        scans=[
            ScanHistory(
                scan=scan.id,
                campaign=names[scan.campaign_id],
                name=scan.name,
                kind=scan.kind,
                started=scan.started or "",
                **dict(zip(_TEMPERATURES, temperatures.get(scan.id, (None, None, None)), strict=True)),
                **_lamp(store, scan),
                response=[] if panel is None or scan.kind != "reference" else _response(store, panel, scan),
            )
            for scan in shown
        ],
        wavelength=[
            WavelengthHistory(
                created=each.created, offset=number(content["offset"]), u_offset=number(content["u_offset"])
            )
            for each in store.characterisations()
            if each.kind == "wavelength" and each.bench == store.bench
            for content in [json.loads(each.json)["result"]]
        ],
        stated_wavelength_offset=None if stated is None else stated.wavelength_offset,
        u_stated_wavelength=None if stated is None else stated.u_wavelength,
        more=len(over) > limit,
    )


_TEMPERATURES = "temperature", "temperature_low", "temperature_high"


# what a finished scan has told does not change, and reading its counts takes longer than all the rest
@lru_cache(maxsize=1024)
def _lamp(store: Store, scan: Scan) -> dict[str, Number]:
    """What the looks at the lamp tell; nothing where there are too few, or saturated ones."""
    try:
        found = lamp_drift(read_raw(store, scan.id))
    except CalibrationError:
        found = None
    if found is None:
        return {"lamp_change": None, "lamp_largest": None, "u_lamp": None}
    return {"lamp_change": found.end[0], "lamp_largest": found.largest, "u_lamp": found.u_interval}


@lru_cache(maxsize=256)
def _signals(store: Store, scan: Scan) -> tuple[FloatArray, FloatArray, FloatArray]:
    """[points, 2] directions in degrees; [points, bands] counts per second and their variance."""
    raw = read_raw(store, scan.id)
    wavelengths = raw.constants.wavelengths
    bands = [np.abs(wavelengths - middle) <= HALF_BAND_NM for middle in BANDS_NM]
    places, rates, variances = [], [], []
    for shot in raw.shots:
        found = linear(raw, shot, CORRECTIONS_OF_A_SHOT)
        if found.saturated.any():
            continue
        places.append((shot.geometry.theta_in, shot.geometry.theta_out))
        rates.append([found.rate[band].mean() for band in bands])
        variances.append([found.variance[band].mean() / band.sum() for band in bands])
    count = len(BANDS_NM)
    return np.reshape(places, (-1, 2)), np.reshape(rates, (-1, count)), np.reshape(variances, (-1, count))


def _response(store: Store, first: Scan, scan: Scan) -> list[Band]:
    """The signal of a scan of the panel against that of the first one, over the directions that both have."""
    (there, before, u2_before), (here, after, u2_after) = _signals(store, first), _signals(store, scan)
    if not here.size or not there.size:
        return []
    apart = np.abs(here[:, None] - there[None]).max(axis=2)
    mine, theirs = np.nonzero(apart <= SAME_DIRECTION)
    if not mine.size:
        return []
    ratio = after[mine] / before[theirs]
    noise = ratio**2 * (u2_after[mine] / after[mine] ** 2 + u2_before[theirs] / before[theirs] ** 2)
    u_noise = np.sqrt(noise.sum(axis=0)) / mine.size
    scatter = ratio.std(axis=0, ddof=1) / np.sqrt(mine.size) if mine.size > 1 else np.zeros(len(BANDS_NM))
    return [
        Band(wavelength_nm=middle, ratio=number(each), u=number(u))
        for middle, each, u in zip(BANDS_NM, ratio.mean(axis=0), np.maximum(u_noise, scatter), strict=True)
    ]
