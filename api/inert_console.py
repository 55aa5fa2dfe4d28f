"""A console that nothing which comes from a file or another person can command."""

import os
import sys
from typing import Any

from rich.console import Console
from rich.text import Text

from goniometer.wording import inert

LONGEST_LINE = 10_000
"""Characters of a line that goes to no terminal."""


class InertConsole(Console):
    """Prints texts as they are, without what a terminal would take for an order.

    In a log or a pipe a sentence stays one line, so that it can be searched for.
    """

    def __init__(self, **how: Any) -> None:
        super().__init__(**how)
        if not self.is_terminal:
            self.width = LONGEST_LINE

    def on_broken_pipe(self) -> None:
        """Whoever read has gone: progress falls silent, as no scan may end of that; a result ends with the command."""
        if not self.stderr:
            super().on_broken_pipe()
        self.quiet = True
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stderr.fileno())
        os.close(nowhere)

    def render_str(self, text: str, **how: Any) -> Text:
        """A text as it is shown, also that of a cell of a table."""
        return super().render_str(inert(text), **how)
