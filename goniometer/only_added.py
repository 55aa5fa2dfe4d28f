"""Rows that nobody may change or delete: the database itself refuses it."""

from sqlalchemy import Connection, text

VERBS = ("UPDATE", "DELETE")

_REFUSE_CHANGE = """
CREATE OR REPLACE FUNCTION refuse_change() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    RAISE EXCEPTION '% are only ever added', TG_TABLE_NAME USING ERRCODE = 'integrity_constraint_violation';
END $$
"""


def protect(connection: Connection, table: str) -> None:
    """Let the database refuse every change of a row of `table`; what is protected already stays so."""
    if connection.dialect.name == "postgresql":
        connection.execute(text(_REFUSE_CHANGE))
        connection.execute(
            text(
                f"CREATE OR REPLACE TRIGGER {table}_only_added BEFORE UPDATE OR DELETE OR TRUNCATE ON {table} "
                f"EXECUTE FUNCTION refuse_change()"
            )
        )
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
    if connection.dialect.name == "postgresql":
        connection.execute(text(f"DROP TRIGGER {table}_only_added ON {table}"))
        return
    for verb in VERBS:
        connection.execute(text(f"DROP TRIGGER {table}_no_{verb.lower()}"))
