"""What is in the database and what runs on it, and what the scan that runs is asked: status, pause, resume, abort."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from api.commands.arguments import DATABASE, AsJson, BenchName, DatabaseFile, emit, existing
from api.commands.logged import Logged
from api.display import called, span
from api.terminal import stdout

if TYPE_CHECKING:
    from goniometer.states import Command


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    app.command()(status)
    for verb in _OBEYED:
        app.command(name=verb, cls=Logged)(_command(verb))


def status(
    database: DatabaseFile = DATABASE,
    last: Annotated[int, typer.Option(min=1, help="Campaigns, and datasets of none, to show: the newest.")] = 20,
    as_json: AsJson = False,
) -> None:
    """What is in the database, and what is running."""
    from goniometer.datasets.dataset import kind_of
    from goniometer.files.dataset_file import last_file
    from goniometer.scans.exposure import below_wanted
    from goniometer.states import ACTIVE_PHASES
    from goniometer.storage import look_up

    store = existing(database)
    names, running = store.campaigns(), look_up.scans_in_phases(store, ACTIVE_PHASES)
    chosen = sorted({*list(names)[-last:], *(scan.campaign_id for scan in running)})
    scans = [scan for campaign_id in chosen for scan in store.scans(campaign_id)]
    found = [asdict(scan) for scan in scans]
    benches = store.benches()
    in_use = {bench for bench in set(benches.values()) if store.in_use(bench)}
    wanted = {campaign_id: store.campaign(campaign_id).integration.signal_to_noise for campaign_id in chosen}
    for scan, entry in zip(scans, found, strict=True):
        entry["name"] = scan.name
        entry["bench"] = benches[scan.campaign_id]
        entry["interrupted"] = entry["phase"] in ACTIVE_PHASES and entry["bench"] not in in_use
        points = store.points(scan.id)
        entry["points_done"] = sum(point.status == "done" for point in points)
        entry["too_noisy"] = below_wanted(points, wanted[scan.campaign_id])
        entry["datasets"] = list(store.datasets(scan.id))
    alone, of_none = store.without_scan(last)
    lineages = {dataset_id: store.lineage(dataset_id) for dataset_id in alone}
    left_out = {"campaigns": len(names) - len(chosen), "datasets": of_none - len(alone)}
    of_kind: dict[str, list[tuple[int, object]]] = {"measured": [], "imported": [], "simulated": []}
    for i, lineage in lineages.items():
        kind = kind_of(lineage)
        of_kind[kind].append((i, last_file(lineage) if kind == "measured" else lineage[kind]))
    if as_json:
        emit(
            {
                "database": store.where,
                "campaigns": {campaign_id: names[campaign_id] for campaign_id in chosen},
                "scans": found,
                "measured_elsewhere": [
                    {"dataset": i, "sample": alone[i], "file": file} for i, file in of_kind["measured"]
                ],
                "imported": [{"dataset": i, "sample": alone[i], "file": file} for i, file in of_kind["imported"]],
                "simulated": [{"dataset": i, "sample": alone[i], "how": how} for i, how in of_kind["simulated"]],
                "left_out": left_out,
            }
        )
        return
    out = stdout()
    if not scans and not alone:
        out.print(f"Nothing has been measured in {store.where} yet.", markup=False, highlight=False)
    if left_out["campaigns"]:
        out.print(f"Older campaigns, shown with --last: {left_out['campaigns']}", highlight=False)
    for scan, entry in zip(scans, found, strict=True):
        phase = "not begun" if entry["phase"] == "idle" else entry["phase"]
        state = "interrupted" if entry["interrupted"] else entry["outcome"] or phase
        datasets = f", dataset {', '.join(map(str, entry['datasets']))}" if entry["datasets"] else ""
        what = called(scan.name, scan.kind)
        count = f"{entry['points_done']} points"
        if scan.remaining is not None:
            count = f"{entry['points_done']} of about {scan.expected_points} points, {span(scan.remaining)} to go"
        where = f" on {entry['bench']}" if len(set(benches.values())) > 1 else ""
        line = f"{names[entry['campaign_id']]}{where}: {what}: {state}, {count}{datasets}"
        out.print(f"{line}. {entry['reason']}" if entry["reason"] else line, markup=False, highlight=False)
    for made, those in of_kind.items():
        what = "measured elsewhere" if made == "measured" else made
        for i, origin in those:
            out.print(f"{what}: {alone[i]}: {origin}, dataset {i}", markup=False, highlight=False)
    if left_out["datasets"]:
        out.print(f"Older datasets of no campaign, shown with --last: {left_out['datasets']}", highlight=False)


_OBEYED: dict[Command, str] = {
    "pause": "after the point in hand",
    "resume": "in a moment",
    "abort": "at once",
}


def _command(verb: Command) -> Callable[[str, str | None, bool], None]:
    def command(database: DatabaseFile = DATABASE, bench: BenchName = None, as_json: AsJson = False) -> None:
        from api.bench import queue
        from api.service import active_scan
        from goniometer.errors import NotInStore

        store = existing(database)
        try:
            scan = active_scan(store, bench)
        except NotInStore:
            fitting = queue.fitting_entries(store, bench) if verb == "abort" else []
            if not fitting:
                raise
            queue.abort_fits(store, fitting[0].id)
            if as_json:
                emit({"entry": fitting[0].id, "campaign": fitting[0].name, "requested": verb})
            else:
                stdout().print(f"{fitting[0].name}: {queue.FITS_ABORTED}", markup=False, highlight=False)
            return
        store.request(scan.id, verb)
        if as_json:
            emit({"scan": scan.id, "sample": scan.name, "requested": verb})
        else:
            told = f"Asked the scan of {called(scan.name, scan.kind)} to {verb}; it obeys {_OBEYED[verb]}."
            stdout().print(told, markup=False, highlight=False)

    otherwise = "; where none is, the fits of a campaign that the service has measured" if verb == "abort" else ""
    command.__doc__ = f"{verb.capitalize()} the scan that is running on the database{otherwise}."
    return command
