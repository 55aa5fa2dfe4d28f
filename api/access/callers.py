"""Who asks the service for something: what `api.access.tokens` knows, remembered for a moment.

A page sends many requests at a time, and each would ask the database the same. What another process changes, as
`goniometer token revoke` does, counts after `REMEMBERED` at the latest; whatever changes something in this one calls
`forget`, and counts at once.
"""

import hashlib
from time import monotonic
from typing import Literal

from starlette.concurrency import run_in_threadpool

from api.access.tokens import Caller, session_caller, token_caller
from api.errors import Unauthorised
from goniometer.storage.database import Database

REMEMBERED = 1.0
"""Seconds for which it is not asked anew whose a token or a session is."""
_MOST = 1000
"""Tokens and sessions that are remembered."""

Shown = tuple[Literal["token", "session"], str]
"""What somebody shows, and its text."""


class Callers:
    """Whom tokens and sessions of a database belong to; to be asked in one event loop."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._known: dict[bytes, tuple[float, Caller]] = {}
        self._changes = 0

    async def of(self, shown: Shown) -> Caller | None:
        """As `anew`, or as it was found a moment ago."""
        key = hashlib.sha256(":".join(shown).encode()).digest()  # no secret stays in memory
        until, caller = self._known.get(key, (0.0, None))
        if caller is not None and monotonic() < until:
            return caller
        changes = self._changes
        caller = await self.anew(shown)
        if caller is not None and changes == self._changes:
            if len(self._known) >= _MOST:
                self._known.clear()
            self._known[key] = monotonic() + REMEMBERED, caller
        return caller

    async def anew(self, shown: Shown) -> Caller | None:
        """Whom it belongs to; None for a session that has ended.

        Raises `Unauthorised` for a token that is none.
        """
        kind, secret = shown
        if kind == "session":
            return await run_in_threadpool(session_caller, self._database, secret)
        caller = await run_in_threadpool(token_caller, self._database, secret)
        if caller is None:
            raise Unauthorised("This token opens nothing here: it was revoked, has expired, or never was one")
        return caller

    def forget(self) -> None:
        """Ask the database again from now on: something was changed."""
        self._changes += 1
        self._known.clear()
