"""Who asks, whether they may, and on which addresses the service may be offered at all."""

import ipaddress
import socket
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, cast

from fastapi import Depends, Request
from fastapi.exceptions import RequestValidationError

from api.access.accounts import all_users, at_least
from api.access.callers import Shown
from api.access.tokens import Caller
from api.choices import Role
from api.errors import NotAllowed, Unauthorised
from goniometer.errors import ConfigurationError
from goniometer.storage.database import Database


@dataclass(frozen=True)
class Access:
    """How the service is reached."""

    loopback: bool
    """Only from this machine."""
    secure: bool
    """By https, here or at a proxy; cookies then go no other way."""
    hosts: frozenset[str] = frozenset()
    """Names under which it is known besides "localhost" and the machine's own; lower case."""

    def answers_to(self, host: str) -> bool:
        """Whether `host`, as a Host header has it, names this service.

        A page of another site can make a name of its own lead here, but no number and none of ours.
        """
        name = host.rpartition("]")[0].removeprefix("[") if host.startswith("[") else host.partition(":")[0]
        return _names_us(name.lower(), self.hosts)


LOCAL = Access(loopback=True, secure=False)
"""On the loopback interface, by http."""


def _needs(role: Role) -> Any:
    """The caller, who must have this role or a higher one; the parameter of an endpoint.

    Raises `Unauthorised` where nobody knows who asks, `NotAllowed` where they may not, and `RequestValidationError` for
    a parameter in the query that the endpoint does not have.
    """

    async def caller(request: Request) -> Caller:
        known = cast(Caller | None, request.state.caller)  # as the gate has found it
        if known is None:
            raise Unauthorised("Nobody knows who asks; log in, or send a token as: Authorization: Bearer TOKEN")
        if not at_least(known.role, role):
            raise NotAllowed(f"This needs the role {role}, and {known.name} has the role {known.role} here")
        _check_query(request)
        return known

    return Depends(caller)


Viewer = Annotated[Caller, _needs("viewer")]
"""The caller, as an endpoint takes it; who asks must have the role of that name, or a higher one."""
Operator = Annotated[Caller, _needs("operator")]
Metrologist = Annotated[Caller, _needs("metrologist")]
Admin = Annotated[Caller, _needs("admin")]


def _check_query(request: Request) -> None:
    """Refuse a parameter that is misspelt, which must not count as one that is left out."""
    known = sorted(each.alias for each in request.scope["route"].dependant.query_params)
    if unknown := sorted(request.query_params.keys() - set(known)):
        # of ten at most: a short request must not be answered at any length
        told = [f"there is no such parameter; there is {', '.join(known) or 'none'}"] + 9 * ["nor is there this one"]
        raise RequestValidationError([{"loc": ("query", n), "msg": m} for n, m in zip(unknown, told, strict=False)])


def shown_by(request: Request, access: Access) -> Shown | None:
    """What a request brings to show who asks; a token goes before a session, and None is neither."""
    given = request.headers.get("authorization")
    if given is not None:
        scheme, _, token = given.partition(" ")
        return "token", token.strip() if scheme.lower() == "bearer" else ""
    session = request.cookies.get(cookie_name(access))
    return None if session is None else ("session", session)


def cookie_name(access: Access) -> str:
    """Name of the session's cookie; a browser takes one of the first form only by https, from this very host."""
    return "__Host-goniometer" if access.secure else "goniometer"


def check_listen(
    host: str, store: Database, *, tls: bool = False, behind_proxy: bool = False, hosts: tuple[str, ...] = ()
) -> Access:
    """How the service may be reached when it listens on `host`.

    `tls`: it has a certificate; `behind_proxy`: something in front of it has, and nobody comes past it; `hosts`: names
    under which it is known. Raises `ConfigurationError` where others than this machine could reach it although nobody
    could log in, or where passwords would cross the network readably.
    """
    local = is_loopback(host) and not behind_proxy
    if not local and not any(user.has_password and not user.disabled for user in all_users(store)):
        raise ConfigurationError(
            f"{host} can be reached from other machines, and there is no user who could log in; "
            f"add one with: goniometer user add NAME --role admin"
        )
    if not local and not (tls or behind_proxy):
        raise ConfigurationError(
            f"On {host} passwords and tokens would cross the network readably; give --tls-cert and --tls-key, or "
            f"--behind-proxy where a proxy in front of it speaks https"
        )
    return Access(local, tls or behind_proxy, frozenset(map(str.lower, hosts)))


def is_loopback(host: str) -> bool:
    """Whether an address to listen on can be reached from this machine only."""
    address = _address(host)
    return host == "localhost" or (address is not None and address.is_loopback)


@lru_cache(maxsize=64)
def _names_us(name: str, hosts: frozenset[str]) -> bool:
    return name in {"localhost", socket.gethostname().lower(), *hosts} or _address(name) is not None


def _address(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(text)
    except ValueError:
        return None
