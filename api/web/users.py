"""Who may use the service."""

from typing import Annotated

from fastapi import APIRouter, Path, Request
from pydantic import BaseModel, ConfigDict, Field, SecretStr

from api.access import accounts
from api.access.accounts import LONGEST_PASSWORD
from api.choices import Role
from api.web.access import Caller, needs
from api.web.context import Here
from api.web.paging import DEFAULT_LIMIT, After, Limit, Page, page

router = APIRouter(prefix="/api/users", tags=["access"])
Admin = Annotated[Caller, needs("admin")]
Name = Annotated[str, Path(max_length=64, examples=["anna"])]
Password = Annotated[SecretStr, Field(max_length=LONGEST_PASSWORD)]


class User(BaseModel):
    """Somebody who may use the service."""

    model_config = ConfigDict(from_attributes=True)

    name: str
    role: Role
    disabled: bool = Field(description="Known, but not let in.")
    has_password: bool = Field(description="Without one, only tokens let them in.")
    created: str = Field(description="ISO 8601, UTC.")


class NewUser(BaseModel):
    """Somebody who is to be let in."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"examples": [{"name": "anna", "role": "operator", "password": "a long one of hers"}]},
    )

    name: str = Field(max_length=64, description="Lower-case letters, digits, dot, underscore and hyphen.")
    role: Role
    password: Password | None = Field(default=None, description="null: only tokens let them in.")


class Change(BaseModel):
    """What is to be otherwise of a user; what is not given stays."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"role": "metrologist"}]})

    role: Role | None = None
    disabled: bool | None = None
    password: Password | None = None


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
