"""Who may use the service."""

from typing import Annotated

from fastapi import APIRouter, Path, Request

from api.access import accounts
from api.bodies.access import Change, NewUser, User
from api.bodies.base import Page
from api.web.access import Admin
from api.web.context import Here
from api.web.paging import DEFAULT_LIMIT, After, Limit, page

router = APIRouter(prefix="/api/users", tags=["access"])
Name = Annotated[str, Path(max_length=64, examples=["anna"])]


@router.get("")
def list_users(live: Here, caller: Admin, limit: Limit = DEFAULT_LIMIT, after: After = None) -> Page[User]:
    """Everybody who may use the service, by name."""
    found = [user for user in accounts.all_users(live.store) if after is None or user.name > after]
    return page(found[: limit + 1], limit, User.model_validate, lambda user: user.name)


@router.post("", status_code=201)
def add_user(request: Request, live: Here, caller: Admin, new: NewUser) -> User:
    """Let somebody in."""
    request.state.about |= {"user": new.name, "role": new.role}
    password = None if new.password is None else new.password.get_secret_value()
    return User.model_validate(accounts.add_user(live.store, new.name, new.role, password))


@router.patch("/{name}")
def change_user(request: Request, live: Here, caller: Admin, name: Name, change: Change) -> User:
    """Give somebody another role or password, keep them out, or let them in again.

    A role counts at once; keeping somebody out and another password end their sessions.
    """
    told = change.model_dump(exclude_none=True, exclude={"password"})
    request.state.about |= told if change.password is None else told | {"new_password": True}
    if change.role is not None:
        accounts.set_role(live.store, name, change.role)
    if change.disabled is not None:
        accounts.set_disabled(live.store, name, disabled=change.disabled)
    if change.password is not None:
        accounts.set_password(live.store, name, change.password.get_secret_value())
    return User.model_validate(accounts.user(live.store, name))


@router.delete("/{name}", status_code=204)
def remove_user(live: Here, caller: Admin, name: Name) -> None:
    """Forget somebody, with their tokens and sessions; the log keeps their name."""
    accounts.remove_user(live.store, name)
