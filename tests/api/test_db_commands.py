"""Who keeps the database does it at the command line."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

from tests.goniometer.old_databases import SCHEMAS, build


def test_a_database_is_backed_up_checked_spoilt_and_restored(cli: Any, small: tuple[Path, dict[str, Any]]) -> None:
    folder, _ = small
    told = json.loads(cli("db", "check", "goniometer.db", "--json", cwd=folder).stdout)
    assert told["whole"]
    assert told["exposures"] > 100
    assert told["datasets"] == 2
    backed_up = cli("db", "backup", "copy.db", cwd=folder)
    assert (backed_up.returncode, backed_up.stderr) == (0, "")
    with closing(sqlite3.connect(folder / "goniometer.db")) as connection, connection:
        connection.execute("DROP TRIGGER log_no_update")
        connection.execute("UPDATE log SET who = 'nobody'")
    spoilt = cli("db", "check", cwd=folder)
    assert spoilt.returncode == 1
    assert "of the log was changed after it was written" in spoilt.stdout
    refused = cli("db", "restore", "copy.db", cwd=folder)
    assert refused.returncode == 1
    assert "--replace" in refused.stderr
    restored = json.loads(cli("db", "restore", "copy.db", "--replace", "--json", cwd=folder).stdout)
    assert Path(restored["kept"]).exists()
    assert cli("db", "check", cwd=folder).returncode == 0
    assert "db restore" in cli("log", "show", cwd=folder).stdout


def test_an_old_database_is_upgraded_with_one_command_that_its_refusal_names(cli: Any, tmp_path: Path) -> None:
    build(SCHEMAS[-1], tmp_path / "old.db")
    refused = cli("status", "--database", "old.db", cwd=tmp_path)
    assert refused.returncode == 1
    command = refused.stderr.split("run: goniometer ")[1].split()
    done = json.loads(cli(*command, "--json", cwd=tmp_path).stdout)
    assert [step.split(":")[0] for step in done["steps"]][:2] == ["0001", "0002"]
    assert Path(done["backup"]).exists()
    assert cli("status", "--database", "old.db", cwd=tmp_path).returncode == 0


def test_what_is_not_there_is_bad_input(cli: Any, tmp_path: Path) -> None:
    for arguments in (
        ("check", "no.db"),
        ("backup", "b.db", "-d", "no.db"),
        ("restore", "no.db"),
        ("upgrade", "no.db"),
    ):
        refused = cli("db", *arguments, cwd=tmp_path)
        assert refused.returncode == 2
        assert "There is no" in refused.stderr
    assert not list(tmp_path.glob("*.db"))
