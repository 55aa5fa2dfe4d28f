"""How long somebody must wait after logins that failed, so that guessing passwords leads nowhere.

Failures are counted by name and address for an hour, in the database, so that a restart forgives nothing. After a few,
each further one doubles the wait; a try that comes too early is refused unseen and counts for nothing. So that nobody
can keep somebody else out from afar, who has logged in from an address before is only held up by failures of just this
name from just this address, and never for longer than a minute.
"""

import ipaddress
import math
import time
from dataclasses import dataclass

from sqlalchemy import ColumnElement, Connection, and_, delete, func, insert, select, update

from api.errors import TooManyFailures
from goniometer.storage.database import Database
from goniometer.storage.service_tables import logins as table

_HOUR = 3600.0
_REMEMBERED = 90 * 24 * _HOUR
"""For which an address from which somebody has logged in is known, seconds."""


@dataclass(frozen=True)
class Limit:
    """How many failures are free, and the longest wait, seconds, after more."""

    free: int
    longest: float

    def wait(self, failures: int, since: float) -> float:
        """Seconds still to wait, `since` seconds after the last of `failures`.

        >>> limit = Limit(free=3, longest=60.0)
        >>> [limit.wait(failures, 0.5) for failures in (2, 3, 4, 5, 100)]
        [0.0, 0.5, 1.5, 3.5, 59.5]
        """
        if failures < self.free:
            return 0.0
        return max(0.0, min(2.0 ** min(failures - self.free, 30), self.longest) - since)


PAIR = Limit(free=5, longest=60.0)
"""Of one name from one address."""
NAME = Limit(free=20, longest=30.0)
"""Of one name from all addresses from which it never logged in."""
ADDRESS = Limit(free=20, longest=60.0)
"""Of all names from one address."""


def count_try(database: Database, name: str, address: str) -> None:
    """Count a login as failed before it is looked at, so that many at once are no way around; `forgive` takes it back.

    Raises `TooManyFailures`, and counts nothing, where it comes too early.
    """
    name, address = name[:64], network(address)
    with database.reading() as connection:  # a flood of tries that come too early holds up no writing
        _check_wait(connection, name, address)
    now = time.time()
    with database.alone() as connection:
        _check_wait(connection, name, address)
        forgotten = (table.c.failed < now - _HOUR) & (table.c.succeeded < now - _REMEMBERED)
        connection.execute(delete(table).where(forgotten))
        mine = _pair(name, address)
        row = connection.execute(select(table).where(mine)).first()
        if row is None:
            connection.execute(insert(table).values(name=name, address=address, failures=1, failed=now))
        else:
            failures = 1 if row.failed < now - _HOUR else row.failures + 1
            connection.execute(update(table).where(mine).values(failures=failures, failed=now))


def forgive(database: Database, name: str, address: str) -> None:
    """Note that a login that was counted did not fail: its name is known at its address from now on."""
    with database.writing() as connection:
        mine = update(table).where(_pair(name[:64], network(address)))
        connection.execute(mine.values(failures=0, failed=0.0, succeeded=time.time()))


def network(address: str) -> str:
    """What counts as one address: of IPv6 all that one customer commonly has, a /64.

    >>> network("192.0.2.7"), network("2001:db8::1:2:3:4"), network("::ffff:192.0.2.7")
    ('192.0.2.7', '2001:db8::/64', '192.0.2.7')
    """
    try:
        known = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address[:64]  # of a socket that has no address
    if isinstance(known, ipaddress.IPv6Address):
        known = known.ipv4_mapped or known
    return str(known) if known.version == 4 else str(ipaddress.ip_network((int(known), 64), strict=False))


def _check_wait(connection: Connection, name: str, address: str) -> None:
    now, mine = time.time(), _pair(name, address)
    known = connection.execute(select(table.c.name).where(mine, table.c.succeeded > now - _REMEMBERED)).first()
    limits = [(PAIR, mine)]
    if known is None:
        limits += [(NAME, table.c.name == name), (ADDRESS, table.c.address == address)]
    seconds = 0.0
    for limit, which in limits:
        count = select(func.sum(table.c.failures), func.max(table.c.failed))
        failures, last = connection.execute(count.where(which, table.c.failed > now - _HOUR)).one()
        seconds = max(seconds, limit.wait(failures or 0, now - (last or 0.0)))
    if seconds > 0:
        raise TooManyFailures(f"Too many logins have failed; wait {math.ceil(seconds)} s and try again", seconds)


def _pair(name: str, address: str) -> ColumnElement[bool]:
    return and_(table.c.name == name, table.c.address == address)
