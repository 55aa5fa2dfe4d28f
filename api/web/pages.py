"""The pages of the service, as they were built into `api/static`, and the headers that keep browsers careful."""

from pathlib import Path

from fastapi import APIRouter
from fastapi.responses import FileResponse, Response
from starlette.datastructures import MutableHeaders
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

STATIC = Path(__file__).parent.parent / "static"
FOR_EVER = "public, max-age=31536000, immutable"
"""For files whose names change with what is in them."""
POLICY = "default-src 'self'; base-uri 'none'; frame-ancestors 'none'; form-action 'self'; object-src 'none'"
_HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
}

router = APIRouter()


class Careful:
    """Gives every answer of `app` the headers that it does not bring itself."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""

        async def sending(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
                # what is measured is for who asked for it; what has a tag may be kept, but is asked for again
                headers.setdefault("cache-control", "private, no-cache" if "etag" in headers else "no-store")
            await send(message)

        await self._app(scope, receive, sending if scope["type"] == "http" else send)


@router.get("/{path:path}", include_in_schema=False)
async def page(path: str) -> Response:
    """A file of the pages; any other place is one inside the application, which its first page finds.

    Raises a 404 where there is no such file, also where the pages were not built.
    """
    try:
        file = (STATIC / path).resolve()
        there = bool(path) and file.is_relative_to(STATIC.resolve()) and file.is_file()
    except (ValueError, OSError):  # no file can have such a name
        there = False
    if there:
        lasting = path.startswith("assets/")
        return FileResponse(file, headers={"Cache-Control": FOR_EVER if lasting else "no-cache"})
    index = STATIC / "index.html"
    if path.startswith(("api/", "assets/")) or "." in path.rpartition("/")[2]:
        raise HTTPException(404)
    if not index.is_file():
        raise HTTPException(404, "The pages were not built into this installation; /api/openapi.json describes REST.")
    return FileResponse(index, headers={"Cache-Control": "no-cache"})
