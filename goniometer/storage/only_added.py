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


_REFUSE_BUT_MOVE = """
CREATE OR REPLACE FUNCTION let_counts_move() RETURNS trigger LANGUAGE plpgsql AS $$
DECLARE kept exposures%ROWTYPE := NEW;
BEGIN
    kept.counts := OLD.counts;
    IF kept IS NOT DISTINCT FROM OLD AND length(OLD.counts) * length(NEW.counts) = 0
       AND EXISTS (SELECT 1 FROM archives WHERE scan_id = OLD.scan_id) THEN
        RETURN NEW;
    END IF;
    RAISE EXCEPTION 'exposures are only ever added' USING ERRCODE = 'integrity_constraint_violation';
END $$
"""
_KEEP_ARCHIVE = """
CREATE OR REPLACE FUNCTION keep_archive() RETURNS trigger LANGUAGE plpgsql AS $$
BEGIN
    IF EXISTS (SELECT 1 FROM exposures WHERE scan_id = OLD.scan_id AND length(counts) = 0) THEN
        RAISE EXCEPTION 'counts are in this archive only' USING ERRCODE = 'integrity_constraint_violation';
    END IF;
    RETURN OLD;
END $$
"""


def let_counts_move(connection: Connection) -> None:
    """Let the counts of an exposure of a scan that has an archive become empty, and be there again; nothing else.

    Comes after `protect`. An archive stays in its table as long as counts are nowhere else.
    """
    if connection.dialect.name == "postgresql":
        statements = [
            "DROP TRIGGER exposures_only_added ON exposures",
            _REFUSE_BUT_MOVE,
            _KEEP_ARCHIVE,
            "CREATE TRIGGER exposures_only_added BEFORE DELETE OR TRUNCATE ON exposures "
            "EXECUTE FUNCTION refuse_change()",
            "CREATE TRIGGER exposures_only_moved BEFORE UPDATE ON exposures "
            "FOR EACH ROW EXECUTE FUNCTION let_counts_move()",
            "CREATE TRIGGER archives_no_delete BEFORE DELETE ON archives FOR EACH ROW EXECUTE FUNCTION keep_archive()",
        ]
    else:
        columns = connection.execute(text("PRAGMA table_info(exposures)")).all()
        same = " AND ".join(f"OLD.{row.name} IS NEW.{row.name}" for row in columns if row.name != "counts")
        statements = [
            "DROP TRIGGER exposures_no_update",
            f"CREATE TRIGGER exposures_no_update BEFORE UPDATE ON exposures WHEN NOT ({same} "  # nosec B608 # columns only
            f"AND length(OLD.counts) * length(NEW.counts) = 0 "
            f"AND EXISTS (SELECT 1 FROM archives WHERE scan_id = OLD.scan_id)) "
            f"BEGIN SELECT RAISE(ABORT, 'exposures are only ever added'); END",
            "CREATE TRIGGER archives_no_delete BEFORE DELETE ON archives "
            "WHEN EXISTS (SELECT 1 FROM exposures WHERE scan_id = OLD.scan_id AND length(counts) = 0) "
            "BEGIN SELECT RAISE(ABORT, 'counts are in this archive only'); END",
        ]
    for statement in statements:
        connection.execute(text(statement))
