"""What the service logs on stderr: one JSON object a line, and for who sits at a terminal one sentence a line."""

import logging
import sys
from typing import Any

from pythonjsonlogger.core import RESERVED_ATTRS
from pythonjsonlogger.json import JsonFormatter

from goniometer.wording import inert


class _Sentences(logging.Formatter):
    """Time, level and message; nothing in them commands the terminal or looks like a line of its own."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802  (as logging calls it)
        record.message = inert(record.message).replace("\n", "\\n")
        return super().formatMessage(record)

    def formatException(self, ei: Any) -> str:  # noqa: N802  (as logging calls it)
        return inert(super().formatException(ei))


def log_to_stderr(level: int = logging.INFO) -> None:
    """Let everything that this process logs be one line: a sentence in a terminal, elsewhere a JSON object."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        _Sentences("{asctime} {levelname}: {message}", style="{", datefmt="%H:%M:%S")
        if sys.stderr.isatty()
        else JsonFormatter(
            "{asctime}{levelname}{name}{message}{process}",
            style="{",
            rename_fields={"asctime": "time", "levelname": "level", "name": "logger"},
            datefmt="%Y-%m-%dT%H:%M:%S%z",
            reserved_attrs=[*RESERVED_ATTRS, "color_message"],  # uvicorn's, for terminals
        )
    )
    logging.basicConfig(handlers=[handler], level=level, force=True)
    # a spoilt reply is no news: the drivers ask again, and say what comes of it
    logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)
