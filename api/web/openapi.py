"""Prints the OpenAPI document, from which the types of the pages are made: `python -m api.web.openapi`."""

import json
import sys
import tempfile
from pathlib import Path

from api.web.app import make_app
from api.web.live import open_live


def main() -> None:
    """Write the document to stdout."""
    with tempfile.TemporaryDirectory() as folder, open_live(Path(folder) / "none.db", Path(folder)) as live:
        json.dump(make_app(live).openapi(), sys.stdout)


if __name__ == "__main__":
    main()
