"""What was measured elsewhere: a file is sent first, and then a job makes a dataset of it."""

from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool

from api.bodies.jobs import ImportAsked, JobView, Upload
from api.errors import TooLarge
from api.jobs.uploads import LARGEST, new_upload, uploaded
from api.web.access import Operator
from api.web.context import Here
from api.web.jobs import submit
from goniometer.errors import InputError, StoreFull

router = APIRouter(prefix="/api", tags=["imports"])


@router.post(
    "/uploads",
    status_code=201,
    max_body_size=2 * LARGEST,  # the limit that tells what to do comes first
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
        }
    },
)
async def upload(
    request: Request,
    live: Here,
    caller: Operator,
    name: Annotated[str, Query(min_length=1, max_length=120, description="Of the file.", examples=["sample.csv"])],
) -> Upload:
    """Send a file, as it is, to be imported; it is kept until some 50 later ones have come."""
    token, path = await run_in_threadpool(new_upload, live.output, name)
    request.state.about["file"] = name
    try:
        size = await _received(request, path, name)
    except BaseException:  # whoever sent it has gone, too; what came of it is no file
        path.unlink(missing_ok=True)
        path.parent.rmdir()
        raise
    return Upload(upload=token, name=name, size=size)


async def _received(request: Request, path: Path, name: str) -> int:
    """How many bytes of a body came and were written to `path`."""
    size = 0
    try:
        with path.open("wb") as file:
            async for chunk in request.stream():
                size += len(chunk)
                if size > LARGEST:
                    told = f"{name} is larger than {LARGEST // 2**20} MiB; import it on the command line of the machine"
                    raise TooLarge(told)
                await run_in_threadpool(file.write, chunk)
    except OSError as error:
        raise StoreFull(f"{name} cannot be kept ({error.strerror}); make room on the disk of the service.") from error
    if size == 0:
        raise InputError(f"{name}: nothing was sent; send the content of the file as the body of the request.")
    return size


@router.post("/datasets/import", status_code=202)
def import_file(asked: ImportAsked, live: Here, caller: Operator) -> JobView:
    """Make a dataset of what was uploaded; what the file does not say, whoever asks states."""
    for token in (asked.upload, asked.reference, asked.certificate, asked.darks):
        if token is not None:
            uploaded(live.output, token)
    return submit(live, caller, "import", asked)
