"""What is wrong with a certificate is said before anything moves, and only what is wrong."""

import asyncio
import itertools
import sqlite3
from pathlib import Path

import pytest

from api.service import Watch, run
from goniometer.campaigns.campaign import Campaign, OutgoingRange, Reference, Sample
from goniometer.errors import CertificateError, GoniometerError
from goniometer.storage.records import Scan
from goniometer.storage.store import Store

HEADERS = "# serial_number: PANEL\n# calibrated: 2001-01-01\n# valid_until: {valid_until}\n"


async def never(scan: Scan) -> None:
    """Nothing may be mounted in these tests."""
    raise AssertionError(f"{scan.sample} is to be mounted")


def attempt(store: Store, campaign: Campaign, folder: Path) -> None:
    """Run a campaign on the simulated bench; every one here is refused before the bench is opened."""
    asyncio.run(run(store, campaign, folder, None, Watch(lambda _: None, lambda _: None, never)))


def certified(path: Path, text: str, **changes: object) -> Campaign:
    """A campaign of one sample and one incident angle with this certificate."""
    path.write_text(text)
    campaign = Campaign(
        name="Test",
        samples=(Sample(name="A", material="no-such-material"),),
        incident=(30.0,),
        reference=Reference(certificate=str(path)),
    )
    return campaign.model_copy(update=changes)


def test_a_certificate_that_does_not_reach_the_reflected_angles_is_refused_before_anything_moves(
    tmp_path: Path,
) -> None:
    rows = itertools.product((0, 60), (-60, 60), (350, 1100))
    table = "\n".join(f"{t},{out},{wavelength},0.31,0.002" for t, out, wavelength in rows)
    text = f"{HEADERS}theta_in,theta_out,wavelength_nm,brdf,standard_uncertainty\n{table}\n".format(
        valid_until="2199-12-31"
    )
    store = Store.open(tmp_path / "bench.db")
    with pytest.raises(CertificateError, match=r"covers theta_out from -60 to 60 deg, but -85 to 85 deg is needed"):
        attempt(store, certified(tmp_path / "panel.csv", text), tmp_path)
    narrow = certified(tmp_path / "panel.csv", text, outgoing=OutgoingRange(start=-60.0, stop=60.0))
    with pytest.raises(GoniometerError, match="no-such-material"):  # the next thing that is wrong
        attempt(store, narrow, tmp_path)
    store.close()


def test_a_certificate_that_expired_after_the_reference_scan_serves_the_rest_of_the_campaign(tmp_path: Path) -> None:
    text = HEADERS.format(valid_until="2006-12-31") + (
        "wavelength_nm,reflectance,standard_uncertainty\n350,0.98,0.002\n1100,0.98,0.002\n"
    )
    store = Store.open(tmp_path / "bench.db")
    campaign = certified(tmp_path / "panel.csv", text)
    store.add_campaign(campaign)
    with pytest.raises(CertificateError, match="expired on 2006-12-31"):
        attempt(store, campaign, tmp_path)
    with sqlite3.connect(tmp_path / "bench.db") as database:
        database.execute("UPDATE scans SET started = '2005-06-07T08:09:10.000+00:00' WHERE kind = 'reference'")
    database.close()
    with pytest.raises(GoniometerError, match="no-such-material"):  # the next thing that is wrong
        attempt(store, campaign, tmp_path)
    store.close()
