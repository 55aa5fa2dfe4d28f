"""Rows that nobody may change or delete: the database itself refuses it."""

from sqlalchemy import Connection, text

VERBS = ("UPDATE", "DELETE")


def protect(connection: Connection, table: str) -> None:
    """Let SQLite refuse every change of a row of `table`; what is protected already stays so."""
    if connection.dialect.name != "sqlite":
        return
    for verb in VERBS:
        connection.execute(
            text(
                f"CREATE TRIGGER IF NOT EXISTS {table}_no_{verb.lower()} BEFORE {verb} ON {table} "
                f"BEGIN SELECT RAISE(ABORT, '{table} are only ever added'); END"
            )
        )


def unprotect(connection: Connection, table: str) -> None:
    """Take back `protect`, for a revision that changes rows; it protects them again in the same transaction."""
    if connection.dialect.name != "sqlite":
        return
    for verb in VERBS:
        connection.execute(text(f"DROP TRIGGER {table}_no_{verb.lower()}"))
