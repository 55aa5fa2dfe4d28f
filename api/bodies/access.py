"""Who asks, who may, and what was done."""

from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, SecretStr, model_validator

from api.bodies.base import Asked, Body, Page
from api.choices import Role

LONGEST_PASSWORD = 1024
"""Characters; who sends more makes the service work for nothing."""

Via = Literal["session", "token", "cli", "service", "nobody"]
"""How somebody was known: browser, script, command line; what the service does of itself; and who was not known."""


class Login(Asked):
    """Either a name and its password, or a token."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"name": "anna", "password": "a long one of hers"}, {"token": "gonio_..."}]},
    )

    name: str | None = Field(default=None, max_length=64)
    password: SecretStr | None = Field(default=None, max_length=LONGEST_PASSWORD)
    token: SecretStr | None = Field(default=None, max_length=200)

    @model_validator(mode="after")
    def _is_one_of_both(self) -> Self:
        if (self.name is None) != (self.password is None) or (self.name is None) == (self.token is None):
            raise ValueError("give either name and password, or token")
        return self


class Me(Body):
    """Who asks."""

    name: str
    role: Role = Field(description="What they may do with what they have shown.")
    via: str = Field(description='"session" or "token".', examples=["session"])
    csrf: str | None = Field(
        description="What to send as X-CSRF-Token with everything but reading; null where a token is sent."
    )


class SessionView(Body):
    """A browser in which one is logged in."""

    id: str = Field(examples=["0123456789abcdef"])
    created: str = Field(description="ISO 8601, UTC.")
    used: str = Field(description="When something was last asked for in it, about.")
    token: int | None = Field(description="Number of the token that it began with; null: a password.")
    this: bool = Field(description="Whether it is the one that asks.")


class NewPassword(Asked):
    """Another password of one's own."""

    current_password: SecretStr = Field(max_length=LONGEST_PASSWORD)
    password: SecretStr = Field(max_length=LONGEST_PASSWORD, description="The one that is to hold from now on.")


Password = Annotated[SecretStr, Field(max_length=LONGEST_PASSWORD)]


class User(Body):
    """Somebody who may use the service."""

    model_config = ConfigDict(from_attributes=True)

    name: str
    role: Role
    disabled: bool = Field(description="Known, but not let in.")
    has_password: bool = Field(description="Without one, only tokens let them in.")
    created: str = Field(description="ISO 8601, UTC.")


class NewUser(Asked):
    """Somebody who is to be let in."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"name": "anna", "role": "operator", "password": "a long one of hers"}]},
    )

    name: str = Field(max_length=64, description="Lower-case letters, digits, dot, underscore and hyphen.")
    role: Role
    password: Password | None = Field(default=None, description="null: only tokens let them in.")


class Change(Asked):
    """What is to be otherwise of a user; what is not given stays."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"role": "metrologist"}]})

    role: Role | None = None
    disabled: bool | None = None
    password: Password | None = None


class Token(Body):
    """What is known of a token."""

    model_config = ConfigDict(from_attributes=True)

    id: int
    user: str = Field(description="In whose name it works.")
    label: str = Field(description="What it is for.")
    role: Role = Field(description="It may do no more than this, and no more than its owner.")
    created: str = Field(description="ISO 8601, UTC.")
    expires: str | None = Field(description="ISO 8601, UTC; null: never.")
    used: str | None = Field(description="When it was last used, to a minute; null: never.")


class MadeToken(Token):
    """A new token: what it is, this once."""

    token: str = Field(description="The token; it is shown only now.")


class NewToken(Asked):
    """A token that is to be made."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"label": "night script", "role": "operator", "days": 30}]}
    )

    label: str = Field(min_length=1, max_length=100, description="What it is for.")
    role: Role | None = Field(default=None, description="null: what who asks may do.")
    days: float | None = Field(default=None, gt=0, le=36500, description="For which it holds; null: for ever.")


class Row(Body):
    """One thing that somebody did."""

    sequence: int = Field(description="Counted from 1 without gaps.")
    time: str = Field(description="ISO 8601, UTC.")
    who: str = Field(description='Name of a user; of an account of the machine where `via` is "cli".')
    via: Via = Field(description="How they were known.")
    action: str = Field(examples=["POST /api/queue"])
    about: dict[str, Any] = Field(description="What with, and with which outcome.")
    hash: str = Field(description="SHA-256 of the row and the hash before it.")


class Verified(Body):
    """Whether the log is as it was written."""

    rows: int
    head: str = Field(description="Hash of the last row; note it elsewhere, to compare later.")
    fault: str | None = Field(description="The first thing that is wrong; null: nothing.")


class Log(Page[Row]):
    """A part of the log, newest first."""

    verified: Verified | None = Field(description="Of the whole log; null where `verify` does not ask for it.")
