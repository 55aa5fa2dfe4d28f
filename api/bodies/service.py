"""What the service tells of itself, and how it says that something was not done."""

from typing import Literal

from pydantic import Field

from api.bodies.base import Body


class Health(Body):
    """That the service answers and reaches its database."""

    status: Literal["ok"]


class About(Body):
    """What this service is."""

    version: str = Field(description="Of this program.")
    simulated: bool = Field(description="Whether the bench is the simulated one.")


PROBLEM = "application/problem+json"
"""Media type of a `Problem`."""


class Fault(Body):
    """One thing that is wrong with what was sent."""

    where: str = Field(description='Key or parameter, as "samples[0].name"; empty for the whole.')
    message: str = Field(description="What is wrong and what would be right.")


class Problem(Body):
    """Why something was not done (RFC 9457)."""

    type: str = Field(description="Names the kind of problem for a program.", examples=["urn:goniometer:not-in-store"])
    title: str = Field(description="The status in words.", examples=["Not Found"])
    status: int = Field(description="The status of the response.", examples=[404])
    detail: str = Field(description="What is wrong, where, and what would be right.")
    errors: list[Fault] = Field(default=[], description="All that is wrong with what was sent.")
