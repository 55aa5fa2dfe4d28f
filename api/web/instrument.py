"""The bench: what it does, and what operators let it do."""

from functools import lru_cache
from typing import Annotated, Any

from fastapi import APIRouter, Header, Request, Response

from api.bench.messages import Snapshot
from api.bench.operated import conflict
from api.bodies.bench import BenchState, Expose, Jog, Moment, Spectrum
from api.bodies.jobs import DoctorArguments, JobView
from api.errors import Conflict
from api.web.access import Operator, Viewer
from api.web.context import Here
from api.web.jobs import submit
from api.web.paging import etag, unchanged
from goniometer.errors import NotInStore

router = APIRouter(prefix="/api/instrument", tags=["instrument"])

BINARY = "application/octet-stream"


@router.get("", response_model=BenchState)
async def state(request: Request, response: Response, live: Here, caller: Viewer) -> Response:
    """What the bench is and does now."""
    shown = live.worker.shown
    tag = _tag(shown)
    return unchanged(request, response, tag) or Response(shown, media_type="application/json", headers={"ETag": tag})


@router.post("/connect")
async def connect(live: Here, caller: Operator) -> BenchState:
    """Open all devices, switch the lamp on and find the reference marks: look before, the stages turn.

    Answers when that is done; a warm detector takes minutes to cool. Nothing happens where it is done already.
    """
    await live.worker.call("connect")
    return live.worker.state


@router.post("/disconnect")
async def disconnect(live: Here, caller: Operator) -> BenchState:
    """Stop the stages, close the shutter and let go of all devices."""
    await live.worker.call("disconnect")
    return live.worker.state


@router.post("/home")
async def home(live: Here, caller: Operator) -> BenchState:
    """Find both reference marks again; answers when they are found."""
    await live.worker.call("home")
    return live.worker.state


@router.post("/jog")
async def jog(live: Here, caller: Operator, order: Jog) -> BenchState:
    """Turn the stages; answers when they rest."""
    sample, detector = order.standing
    await live.worker.call("jog", sample=sample, detector=detector)
    return live.worker.state


@router.post("/expose")
async def expose(live: Here, caller: Operator, order: Expose) -> BenchState:
    """Read a spectrum, which `spectrum` shows then; answers when it is read."""
    await live.worker.call("expose", integration_time=order.integration_time, dark=order.dark)
    return live.worker.state


@router.post("/stop")
async def stop(live: Here, caller: Operator) -> BenchState:
    """Stop the stages and close the shutter at once, whatever the bench does and whichever service drives it.

    A campaign that runs is aborted, and goes on where it stood when it is started again; nothing that is queued begins
    before somebody starts it. Answers when the stages rest.
    """
    await live.worker.stop()
    return live.worker.state


@router.post("/doctor", status_code=202)
def doctor(live: Here, caller: Operator, asked: DoctorArguments) -> JobView:
    """Examine every device of a bench that is not connected: a job, whose result is what `doctor --json` prints."""
    bench = live.worker.state
    if bench.driver is None or not bench.driver.here:
        raise Conflict(bench.doing.rstrip("."))
    if "doctor" not in bench.possible:
        raise conflict("doctor", bench.phase, bench.doing)
    return submit(live, caller, "doctor", asked)


@router.get("/spectrum", responses={200: {"model": Spectrum, "content": {BINARY: {"schema": {"type": "string"}}}}})
async def spectrum(
    live: Here, caller: Viewer, accept: Annotated[str, Header(include_in_schema=False)] = ""
) -> Response:
    """The last spectrum; as octets, it is the wavelengths and then the counts as little-endian float64."""
    seen = live.worker.snapshot
    if seen is None:
        raise NotInStore("No spectrum was read since the service was started; connect the bench and expose")
    tag = f'"{seen.number}-{seen.moment}"'
    headers = {"ETag": tag, "Cache-Control": "no-cache", "Vary": "Accept"}
    if BINARY in accept:
        content = seen.wavelengths.astype("<f8").tobytes() + seen.counts.astype("<f8").tobytes()
        return Response(content, media_type=BINARY, headers=headers)
    return Response(_shown(seen).model_dump_json(), media_type="application/json", headers=headers)


@router.get("/history")
async def history(live: Here, caller: Viewer) -> list[Moment]:
    """Cooler and lamp in the last hour, oldest first."""
    return [Moment(**vars(past)) for past in live.worker.past]


@lru_cache(maxsize=2)  # many ask between two changes
def _tag(shown: str) -> str:
    return etag(shown)


def _shown(seen: Snapshot) -> Spectrum:
    known: dict[str, Any] = vars(seen) | {"wavelengths": seen.wavelengths.tolist(), "counts": seen.counts.tolist()}
    return Spectrum(**known)
