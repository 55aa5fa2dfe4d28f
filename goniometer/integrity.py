"""Whether a database is as it was written: what can be told of its file and of its rows."""

import sqlite3
from collections.abc import Iterator


def damage(connection: sqlite3.Connection) -> Iterator[str]:
    """What is wrong with the file and with the references between its rows, a sentence each."""
    try:
        for (fault,) in connection.execute("PRAGMA integrity_check(20)"):
            if fault != "ok":
                yield f"The file is damaged: {' '.join(fault.split())}"
        for table, row, parent, _ in connection.execute("PRAGMA foreign_key_check"):
            yield f"Row {row} of {table} refers to a row of {parent} that is not there"
    except sqlite3.DatabaseError as error:
        yield f"The file is damaged: {error}"
