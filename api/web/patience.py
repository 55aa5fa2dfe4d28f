"""How long the service waits for whoever asks, and how much it listens to before it knows what they want.

A connection that never says what it wants, says it a byte at a time or without end would else be kept, and a few
hundred of them leave no room for others.
"""

import asyncio
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

HEAD_TIME = 20.0
"""Seconds in which the head of a request must have come, from the connection or from its first byte on."""
BODY_TIME = 30.0
"""Seconds in which the next part of a body must have come, or all that is left of one that was answered unread."""
LARGEST_HEAD = 1 << 16
"""Bytes of a head."""


class Patient(HttpToolsProtocol):
    """uvicorn's protocol that ends a connection whose next head is late or long."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._late: asyncio.TimerHandle | None = None
        self._head = 0
        self._rest: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn has it
        """Begin to wait for a head."""
        super().connection_made(transport)
        self._expect_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no more."""
        self._head_is_there()
        self._body_is_there()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take what has come."""
        super().data_received(data)
        if self._late is not None:
            self._head += len(data)
            if self._head > LARGEST_HEAD:
                self.transport.abort()

    def on_message_begin(self) -> None:
        """Wait for the head that begins here."""
        super().on_message_begin()
        if self._late is None:
            self._expect_head()

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take a line of the head; one that comes after the body is left alone, for nothing here reads it."""
        if self._late is not None:
            super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """The head is there."""
        self._head_is_there()
        super().on_headers_complete()

    def on_message_complete(self) -> None:
        """All of a request is there."""
        self._body_is_there()
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """An answer is out; what is left of its request is not wanted, but who is sending it does not listen yet."""
        if self.cycle.more_body:
            self._rest = self.loop.call_later(BODY_TIME, self.transport.abort)
        super().on_response_complete()

    def _expect_head(self) -> None:
        self._head = 0
        self._late = self.loop.call_later(HEAD_TIME, self.transport.abort)

    def _head_is_there(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None

    def _body_is_there(self) -> None:
        if self._rest is not None:
            self._rest.cancel()
            self._rest = None
