"""The campaigns of a database and their scans: what was asked for, how far each scan is, and what it was told."""

import json
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Row, bindparam, case, delete, func, literal, or_, select, update

from goniometer.campaigns.campaign import Campaign, changed_content
from goniometer.certificates.certificate_file import read_certificate
from goniometer.constants import Constants
from goniometer.errors import CampaignError, NotInStore, StoreError
from goniometer.states import ACTIVE_PHASES, Command, Outcome, Phase
from goniometer.storage import look_up, tables
from goniometer.storage.database import insert_row
from goniometer.storage.derived import Derived
from goniometer.storage.records import Scan, constants_json, now, to_constants, to_scan

REMAINING = ("remaining", "remaining_low", "remaining_high")
"""Columns of a scan: the bench time that is left, and its limits, seconds."""
_STALE = "Its process ended before the scan did; run the campaign again to go on."
_COMMAND = select(tables.scans.c.command).where(tables.scans.c.id == bindparam("scan"))
"""Built once, for a scan that runs asks many times a second."""


class Campaigns(Derived):
    """The part of an open database that holds campaigns and scans; `goniometer.storage.store.Store` is the whole."""

    def add_campaign(self, campaign: Campaign, certificate: str | None = None) -> int:
        """Id of the campaign; it is written, with its scans and its certificate, unless it is there already.

        `certificate` is the text of the panel's where the campaign names no file. A campaign of this name that has no
        point yet gives way to a changed one; of one that has, only who overrides its certificate may change. Each
        sample is followed by a spot scan where homogeneity is asked for. Raises `CampaignError` when a campaign that
        has begun was started with other content or another certificate, or is one of another bench, `CertificateError`
        when the certificate cannot be read.
        """
        path = campaign.reference.certificate
        certificate = certificate if path is None else read_certificate(Path(path))
        with self.alone() as connection:
            known = self._begun(connection, campaign, certificate)
            if known is not None:
                mine = tables.scans.c.campaign_id == known.id
                if known.hash == campaign.hash and known.certificate == certificate:
                    # a certificate may have expired since, and somebody answers for it
                    connection.execute(
                        update(tables.campaigns)
                        .where(tables.campaigns.c.id == known.id)
                        .values(json=campaign.canonical_json)
                    )
                    for each in campaign.samples:  # the file of a material may have been moved
                        connection.execute(
                            update(tables.scans)
                            .where(mine, tables.scans.c.kind != "reference", tables.scans.c.sample == each.name)
                            .values(material=each.material)
                        )
                    return int(known.id)
                connection.execute(delete(tables.scans).where(mine))
                connection.execute(delete(tables.campaigns).where(tables.campaigns.c.id == known.id))
            campaign_id = insert_row(
                connection,
                tables.campaigns,
                name=campaign.name,
                json=campaign.canonical_json,
                hash=campaign.hash,
                certificate=certificate,
                created=now(),
                bench=self.bench,
            )
            kinds = ("sample",) if campaign.homogeneity is None else ("sample", "spot")
            things: list[tuple[str, str, str]] = []
            for _, sample in campaign.series:
                if sample is None:
                    things.append(("reference", "reference", "spectralon"))
                else:
                    things += [(kind, sample.name, sample.material) for kind in kinds]
            for number, (kind, name, material) in enumerate(things):
                insert_row(
                    connection,
                    tables.scans,
                    campaign_id=campaign_id,
                    number=number,
                    kind=kind,
                    sample=name,
                    material=material,
                    phase="idle",
                )
            return campaign_id

    def check_begun(self, campaign: Campaign, certificate: str | None) -> None:
        """Raise `CampaignError` where `add_campaign` would."""
        with self.reading() as connection:
            self._begun(connection, campaign, certificate)

    def _begun(self, connection: Connection, campaign: Campaign, certificate: str | None) -> Row[Any] | None:
        """The campaign of this name, None where there is none; raises `CampaignError` for one that stays another."""
        known = connection.execute(select(tables.campaigns).where(tables.campaigns.c.name == campaign.name)).first()
        if known is None:
            return None
        if known.bench != self.bench:
            raise CampaignError(
                f'The campaign "{campaign.name}" in {self.where} belongs to the bench {known.bench}; run it there, or '
                f"give this one another name"
            )
        points = select(tables.points.c.id).join(tables.scans).where(tables.scans.c.campaign_id == known.id).limit(1)
        same = known.hash == campaign.hash and known.certificate == certificate
        if not same and connection.execute(points).first() is not None:
            changed = changed_content(Campaign.model_validate_json(known.json), campaign)
            raise CampaignError(
                f'The campaign "{campaign.name}" in {self.where} was started with {changed}; undo the change to '
                f"resume it, or give the changed campaign another name"
            )
        return known

    def campaign(self, campaign_id: int) -> Campaign:
        """The campaign as it was started; raises `NotInStore`."""
        row = self.row(select(tables.campaigns).where(tables.campaigns.c.id == campaign_id), f"campaign {campaign_id}")
        return Campaign.model_validate_json(row.json)

    def certificate(self, campaign_id: int) -> str | None:
        """Text of the certificate file that a campaign was started with, None without one; raises `NotInStore`."""
        query = select(tables.campaigns.c.certificate).where(tables.campaigns.c.id == campaign_id)
        text: str | None = self.row(query, f"campaign {campaign_id}").certificate
        return text

    def campaigns(self) -> dict[int, str]:
        """Name of every campaign by its id, oldest first."""
        here = tables.campaigns.c
        return {row.id: row.name for row in self.rows(select(here.id, here.name).order_by(here.id))}

    def benches(self) -> dict[int, str]:
        """Name of the bench of every campaign by its id, oldest first."""
        here = tables.campaigns.c
        return {row.id: row.bench for row in self.rows(select(here.id, here.bench).order_by(here.id))}

    def scan(self, scan_id: int) -> Scan:
        """One scan; raises `NotInStore`."""
        return to_scan(self.row(look_up.scan_rows().where(tables.scans.c.id == scan_id), f"scan {scan_id}"))

    def scans(self, campaign_id: int | None = None) -> list[Scan]:
        """Scans of one campaign or of all, in the order in which they are run."""
        every, of_one = look_up.listed_scans()
        rows = self.rows(every) if campaign_id is None else self.rows(of_one, {"campaign": campaign_id})
        return [to_scan(row) for row in rows]

    def reference_scan(self, scan_id: int) -> Scan:
        """The last reference scan of its campaign up to `scan_id`, which serves it; raises `NotInStore`."""
        scan = self.scan(scan_id)
        before = self.scans(scan.campaign_id)[: scan.number + 1]
        return next(s for s in reversed(before) if s.kind == "reference")

    def explain(self, scan_id: int, reason: str) -> None:
        """Note why a scan that runs does not measure, as a sentence; empty when it does."""
        self._update(tables.scans, scan_id, reason=reason)

    def set_phase(self, scan_id: int, phase: Phase) -> None:
        """Note what a scan is doing; the first "running" is its start, and forgets how it ended before."""
        values: dict[str, object] = {"phase": phase}
        if phase == "running":
            values |= {"outcome": None, "reason": "", "finished": None}
            values["started"] = func.coalesce(tables.scans.c.started, now())
        self._update(tables.scans, scan_id, **values)

    def finish_scan(self, scan_id: int, outcome: Outcome, reason: str = "") -> None:
        """Note how a scan ended; a point that was being measured then is pending again."""
        nothing = dict.fromkeys(("expected_points", *REMAINING)) if outcome == "completed" else {}
        with self.writing() as connection:
            connection.execute(
                update(tables.points)
                .where(tables.points.c.scan_id == scan_id, tables.points.c.status == "running")
                .values(status="pending")
            )
            connection.execute(
                update(tables.scans)
                .where(tables.scans.c.id == scan_id)
                .values(phase="finished", outcome=outcome, reason=reason, command=None, finished=now(), **nothing)
            )

    def end_stale_scans(self) -> None:
        """Note that scans of this bench whose process was killed have ended; only for who holds `exclusive`."""
        for scan in look_up.scans_in_phases(self, ACTIVE_PHASES):
            if look_up.campaign_row(self, scan.campaign_id).bench == self.bench:
                self.finish_scan(scan.id, "aborted", _STALE)

    def request(self, scan_id: int, command: Command) -> None:
        """Ask the process that runs a scan to pause (after the point in hand), to resume, or to abort (at once).

        Nothing takes back an abort. Raises `NotInStore` where the scan is not being run, or is being aborted.
        """
        if not self.in_use(self.benches()[self.scan(scan_id).campaign_id]):
            raise NotInStore(
                f"Scan {scan_id} cannot {command}, because no process runs it; run its campaign to go on where it stood"
            )
        here = tables.scans.c
        phase = {
            "pause": case((here.phase == "running", "pausing"), else_=here.phase),
            "resume": here.phase,
            "abort": "aborting",
        }[command]
        with self.writing() as connection:
            asked = connection.execute(
                update(tables.scans)
                .where(here.id == scan_id, here.phase.not_in(("idle", "finished")))
                .where(or_(literal(command == "abort"), here.command.is_distinct_from("abort")))
                .values(command=command, phase=phase)
            )
        if asked.rowcount == 0:
            if self.command(scan_id) == "abort":
                raise NotInStore(f"Scan {scan_id} is being aborted, so it cannot {command}; run its campaign again")
            raise NotInStore(f"Scan {scan_id} is not running, so it cannot {command}; name a scan that is running")

    def command(self, scan_id: int) -> Command | None:
        """What was asked for and not taken up yet."""
        rows = self.rows(_COMMAND, {"scan": scan_id})
        return rows[0].command if rows else None

    def clear_command(self, scan_id: int, taken: Command | None = None) -> None:
        """Note that the command `taken` has been taken up, and leave one that came meanwhile; None clears any."""
        here = tables.scans.c
        with self.writing() as connection:
            connection.execute(
                update(tables.scans)
                .where(here.id == scan_id, literal(taken is None) | (here.command == taken))
                .values(command=None)
            )

    def save_constants(self, scan_id: int, constants: Constants) -> None:
        """Write what calibration needs to know about the devices.

        Raises `StoreError` when the scan, or the reference scan of its campaign, began with another spectrometer or
        other settings: raw data must not be mixed. A stage may be exchanged, and need not know who it is.
        """
        known = self._constants_json(scan_id)
        begun = known or self._constants_json(self.reference_scan(scan_id).id) or constants_json(constants)
        before, after = json.loads(begun), json.loads(constants_json(constants))
        changed = [name.replace("_", " ") for name in after if name != "stages" and after[name] != before.get(name)]
        if changed:
            raise StoreError(
                f"The campaign of scan {scan_id} began with another {' and '.join(changed)}; "
                f"connect and set what it began with, or start a campaign of another name"
            )
        if known is None:
            self._update(tables.scans, scan_id, constants=constants_json(constants))

    def constants(self, scan_id: int) -> Constants:
        """What calibration needs to know about the devices of a scan; raises `NotInStore`."""
        text = self._constants_json(scan_id)
        if text is None:
            raise NotInStore(f"Scan {scan_id} has not begun, so {self.where} holds nothing about its devices")
        return to_constants(text)

    def _constants_json(self, scan_id: int) -> str | None:
        row = self.row(select(tables.scans.c.constants).where(tables.scans.c.id == scan_id), f"scan {scan_id}")
        return None if row.constants is None else str(row.constants)
