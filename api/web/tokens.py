"""Tokens, with which scripts use the service in somebody's name."""

from datetime import UTC, datetime, timedelta
from typing import Annotated

from fastapi import APIRouter, Path, Query, Request, Response

from api.access import tokens
from api.access.accounts import at_least
from api.bodies.access import MadeToken, NewToken, Token
from api.bodies.base import Page
from api.errors import NotAllowed
from api.web.access import Viewer
from api.web.context import Here
from api.web.paging import DEFAULT_LIMIT, After, Limit, after_number, page
from goniometer.errors import NotInStore

router = APIRouter(prefix="/api/tokens", tags=["access"])


@router.get("")
def list_tokens(
    live: Here,
    caller: Viewer,
    limit: Limit = DEFAULT_LIMIT,
    after: After = None,
    everybody: Annotated[bool, Query(description="Not only one's own; for admins.")] = False,
) -> Page[Token]:
    """One's own tokens, oldest first."""
    if everybody and caller.role != "admin":
        raise NotAllowed(f"Tokens of everybody need the role admin, and {caller.name} has the role {caller.role} here")
    start = after_number(after)
    found = [t for t in tokens.all_tokens(live.store, None if everybody else caller.name) if t.id > start]
    return page(found[: limit + 1], limit, Token.model_validate, lambda each: each.id)


@router.post("", status_code=201)
def create_token(live: Here, caller: Viewer, new: NewToken, request: Request, response: Response) -> MadeToken:
    """Make a token for oneself. One that is made with a token may do no more than that, for no longer."""
    role = new.role or caller.role
    if not at_least(caller.role, role):
        raise NotAllowed(f"{caller.name} has the role {caller.role} here, so no token for {role} can be made")
    expires = None if new.days is None else datetime.now(UTC) + timedelta(days=new.days)
    if caller.token_id is not None:
        end = tokens.token(live.store, caller.token_id).expires
        if end is not None:
            last = datetime.fromisoformat(end)
            expires = last if expires is None else min(expires, last)
    text, made = tokens.create_token(live.store, caller.name, new.label, role, expires)
    request.state.about |= {"number": made.id, "label": made.label, "role": made.role, "expires": made.expires}
    response.headers["Cache-Control"] = "no-store"
    return MadeToken(token=text, **Token.model_validate(made).model_dump())


@router.delete("/{token_id}", status_code=204)
def revoke_token(live: Here, caller: Viewer, token_id: Annotated[int, Path(ge=1, lt=2**63)]) -> None:
    """Make a token worthless, with the sessions that began with it; an admin may do so with everybody's."""
    found = tokens.token(live.store, token_id)
    if caller.role != "admin" and found.user != caller.name:
        raise NotInStore(f"There is no token {token_id} of yours; list them with GET /api/tokens")
    if not at_least(caller.role, found.role):
        raise NotAllowed(f"Token {token_id} has the role {found.role}, and {caller.name} has only {caller.role} here")
    tokens.revoke_token(live.store, token_id)
