"""Coming in and going out: with a password or a token, to a session that the browser keeps in a cookie."""

from typing import Annotated, Any

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Path, Request, Response
from starlette.concurrency import run_in_threadpool

from api.access.accounts import all_users, check_password, set_password
from api.access.throttle import count_try, forgive
from api.access.tokens import (
    OLD,
    Caller,
    begin_session,
    csrf_token,
    end_session,
    end_sessions,
    session_of,
    sessions_of,
    token_caller,
)
from api.bodies.access import Login, Me, NewPassword, SessionView
from api.errors import NotAllowed, TooManyFailures, Unauthorised
from api.web.access import Access, Viewer, cookie_name
from api.web.context import Here
from goniometer.storage.database import Database

router = APIRouter(prefix="/api", tags=["access"])

_CROWD = 20
"""Logins that may wait for their turn."""


@router.post("/login")
async def login(request: Request, response: Response, live: Here, given: Login) -> Me:
    """Begin a session, whose secret comes as a cookie that pages cannot read.

    A page that was opened with a token in its address exchanges it here. Logins that fail make the next ones wait
    (429, `Retry-After`).
    """
    request.state.caller = None  # whoever was logged in before is not who fails now
    caller = await _in_turn(request, live.store, given)
    request.state.caller = caller
    old = request.cookies.get(cookie_name(request.app.state.access))
    secret = await run_in_threadpool(begin_session, live.store, caller.name, caller.token_id, old)
    response.set_cookie(value=secret, max_age=int(OLD.total_seconds()), **_cookie(request.app.state.access))
    response.headers["Cache-Control"] = "no-store"
    return Me(name=caller.name, role=caller.role, via="session", csrf=csrf_token(secret))


@router.post("/logout", status_code=204)
def logout(request: Request, response: Response, live: Here, caller: Viewer) -> None:
    """End the session; a token stays what it is."""
    if caller.via == "session":
        end_session(live.store, request.cookies[cookie_name(request.app.state.access)])
    response.delete_cookie(**_cookie(request.app.state.access))


@router.get("/me")
def me(request: Request, response: Response, caller: Viewer) -> Me:
    """Who asks, and what they may do."""
    response.headers["Cache-Control"] = "no-store"
    session = request.cookies.get(cookie_name(request.app.state.access)) if caller.via == "session" else None
    csrf = None if session is None else csrf_token(session)
    return Me(name=caller.name, role=caller.role, via=caller.via, csrf=csrf)


@router.post("/me/password", status_code=204)
async def change_password(request: Request, live: Here, given: NewPassword, caller: Viewer) -> None:
    """Take another password; all one's sessions end, this one too."""
    try:
        await _in_turn(request, live.store, Login(name=caller.name, password=given.current_password))
    except Unauthorised:  # who asks is known, and stays logged in
        raise NotAllowed("The current password is another one; type it again") from None
    await run_in_threadpool(set_password, live.store, caller.name, given.password.get_secret_value())


@router.get("/me/sessions")
def my_sessions(request: Request, live: Here, caller: Viewer) -> list[SessionView]:
    """Where one is logged in, newest first."""
    secret = request.cookies.get(cookie_name(request.app.state.access)) if caller.via == "session" else None
    this = None if secret is None else session_of(secret)
    return [
        SessionView(id=each.id, created=each.created, used=each.used, token=each.token_id, this=each.id == this)
        for each in sessions_of(live.store, caller.name)
    ]


@router.delete("/me/sessions/{session}", status_code=204)
def end_my_session(session: Annotated[str, Path(pattern="^[0-9a-f]{16}$")], live: Here, caller: Viewer) -> None:
    """Log out there."""
    end_sessions(live.store, caller.name, session)


async def _in_turn(request: Request, store: Database, given: Login) -> Caller:
    """`_known` with few others at a time: each takes 64 MB and a core, and a crowd must not slow down the bench."""
    limiter: CapacityLimiter = request.app.state.logins
    if limiter.statistics().tasks_waiting >= _CROWD:
        raise TooManyFailures("Too many log in at once; try again in a few seconds", 5.0)
    return await to_thread.run_sync(_known, request, store, given, limiter=limiter)


def _known(request: Request, store: Database, given: Login) -> Caller:
    """Who has given this; raises `Unauthorised`, the same whatever is wrong, and `TooManyFailures`."""
    address = request.client.host if request.client else ""
    name = (given.name or "").strip().lower()
    count_try(store, name, address)
    if given.token is not None:
        request.state.about["login"] = "token"
        caller = token_caller(store, given.token.get_secret_value())
        wrong = "This token opens nothing here: it was revoked, has expired, or never was one"
    else:
        assert given.password is not None  # the model has made sure
        # what is typed as a name may be a password, so the log only holds names that there are
        request.state.about["login"] = name if any(u.name == name for u in all_users(store)) else "an unknown name"
        user = check_password(store, name, given.password.get_secret_value())
        caller = None if user is None else Caller(user.name, user.role)
        wrong = "Nobody with this name and this password may come in"
    if caller is None:
        raise Unauthorised(wrong)
    forgive(store, name, address)
    return caller


def _cookie(access: Access) -> dict[str, Any]:
    return {"key": cookie_name(access), "path": "/", "httponly": True, "samesite": "strict", "secure": access.secure}
