"""An entry of the queue as people see it: with what the database and the bench know of its campaign."""

from functools import lru_cache

from api.bench import queue
from api.bodies.bench import BenchState, Prompt, Running, Span
from api.bodies.campaigns import EntryPhase, EntryScan, EntryView
from api.display import duration
from api.preview import preview
from api.web.live import Live
from goniometer.bench.route import Motion
from goniometer.campaigns.campaign import Campaign
from goniometer.plans.plan_spec import ORDINARY
from goniometer.scans.duration import DEAD_TIME
from goniometer.states import ACTIVE_PHASES
from goniometer.storage import look_up
from goniometer.storage.records import Expected, Scan


def entry_view(live: Live, entry: queue.Entry, state: BenchState) -> EntryView:
    """An entry with what is known of it; `state` is that of the bench."""
    scans = [] if entry.campaign_id is None else live.store.scans(entry.campaign_id)
    counts = look_up.point_counts(live.store, [scan.id for scan in scans])
    done = {scan.id: counts[scan.id].done + counts[scan.id].failed for scan in scans if scan.id in counts}
    runs = entry.phase == "running"
    active = next((scan for scan in scans if scan.phase in ACTIVE_PHASES), None) if runs else None
    running = None if state.running is None or state.running.entry != entry.id else state.running
    prompt = None if state.prompt is None or state.prompt.entry != entry.id else state.prompt
    expected, remaining = _ahead(live, entry, scans, done, running)
    return EntryView(
        id=entry.id,
        position=entry.position,
        campaign=entry.name,
        campaign_id=entry.campaign_id,
        phase=_phase(entry, scans, active),
        outcome=entry.outcome,
        reason=entry.reason or ("" if active is None else active.reason),
        who=entry.who,
        start_after=entry.start_after,
        created=entry.created,
        started=entry.started,
        finished=entry.finished,
        scans=[
            EntryScan(
                id=scan.id,
                name=scan.name,
                kind=scan.kind,
                phase=scan.phase,
                outcome=scan.outcome,
                points_done=done.get(scan.id, 0),
            )
            for scan in scans
        ],
        scan=None if active is None else active.id,
        points_done=sum(done.values()),
        points_expected=expected,
        remaining=remaining,
        pause_takes_effect=_pause(active, running, prompt),
        prompt=prompt,
    )


def _phase(entry: queue.Entry, scans: list[Scan], active: Scan | None) -> EntryPhase:
    if active is None:
        return "fitting" if queue.is_fitting(entry, scans) else entry.phase
    match active.phase:
        case "pausing" | "paused" | "aborting":
            return active.phase
        case _:
            return "running"


def _pause(active: Scan | None, running: Running | None, prompt: Prompt | None) -> str | None:
    """When a pause takes effect that is asked for now."""
    if active is None or running is None or active.phase not in {"running", "pausing"}:
        return None
    if prompt is not None:
        return "once it is mounted"
    if not running.done:
        return "after this point"
    return f"after this point, about {duration(running.bench_elapsed / running.done)}"


def _ahead(
    live: Live, entry: queue.Entry, scans: list[Scan], done: dict[int, int], running: Running | None
) -> tuple[int | None, Span | None]:
    """Points that there will be in the end, and bench time to go."""
    if entry.phase == "finished":
        return None, None
    motion = ORDINARY if live.settings is None else live.settings.motion
    dead_time = DEAD_TIME if live.settings is None else live.settings.spectrometer.dead_time
    legs = _legs(entry.json, motion, dead_time)
    points, left = 0, Expected(0.0, 0.0, 0.0)
    known = {
        ("reference panel" + scan.name.removeprefix("reference")) if scan.kind == "reference" else scan.name: scan
        for scan in scans
        if scan.kind != "spot"
    }
    for name, (planned, time) in legs.items():
        scan = known.get(name)
        if scan is None or scan.phase == "idle":
            points, left = points + planned, left + time
        elif running is not None and running.scan == scan.id:
            span = running.bench_remaining
            points, left = points + running.expected, left + Expected(span.seconds, span.low, span.high)
        elif scan.outcome == "completed":
            points += done.get(scan.id, 0)
        else:
            points += scan.expected_points or planned
            left += scan.remaining or time
    return points, Span(seconds=left.seconds, low=left.low, high=left.high)


@lru_cache(maxsize=256)
def _legs(json: str, motion: Motion, dead_time: float) -> dict[str, tuple[int, Expected]]:
    """Points and time of every scan of a campaign, by its name in the preview."""
    found = preview(Campaign.model_validate_json(json), motion, dead_time)
    return {leg.name: (leg.points, leg.time) for leg in found.legs}
