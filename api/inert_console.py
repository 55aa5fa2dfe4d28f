"""A console that nothing which comes from a file or another person can command."""

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

    def render_str(self, text: str, **how: Any) -> Text:
        """A text as it is shown, also that of a cell of a table."""
        return super().render_str(inert(text), **how)
