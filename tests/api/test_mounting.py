"""On a real bench a person mounts the samples: no scan begins before that is confirmed."""

import asyncio
import io
import os
import pty
import sys
import time

import pytest

from api.terminal import ask_to_mount
from goniometer.errors import RunAborted
from goniometer.storage.records import Scan

SCAN = Scan(1, 1, 1, "sample", "Sample 1", "sample-1", "running", None, "", None, None, None)


def test_a_scan_begins_when_enter_is_pressed_and_not_before(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    writing, reading = pty.openpty()
    with os.fdopen(reading) as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)

        async def scenario() -> None:
            os.write(writing, b"\n")  # typed before the question: no answer to it
            asked = asyncio.ensure_future(ask_to_mount(SCAN))
            await asyncio.sleep(0.2)
            assert not asked.done()
            os.write(writing, b"\n")
            await asyncio.wait_for(asked, 5)

        asyncio.run(scenario())
    os.close(writing)
    assert "Sample 1" in capsys.readouterr().err


@pytest.mark.parametrize("stdin", [None, io.StringIO("\n\n\n")])
def test_without_a_terminal_nobody_confirms_and_nothing_is_measured(
    monkeypatch: pytest.MonkeyPatch, stdin: io.StringIO | None
) -> None:
    monkeypatch.setattr(sys, "stdin", stdin)
    with pytest.raises(RunAborted, match="Sample 1 is mounted"):
        asyncio.run(ask_to_mount(SCAN))


def test_an_abort_does_not_wait_for_a_key(monkeypatch: pytest.MonkeyPatch) -> None:
    writing, reading = pty.openpty()
    with os.fdopen(reading) as keyboard:
        monkeypatch.setattr(sys, "stdin", keyboard)

        async def scenario() -> None:
            with pytest.raises(asyncio.TimeoutError):
                await asyncio.wait_for(ask_to_mount(SCAN), 0.1)

        began = time.monotonic()
        asyncio.run(scenario())
        assert time.monotonic() - began < 60
        os.close(writing)
