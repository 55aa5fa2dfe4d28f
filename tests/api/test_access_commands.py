"""The commands that say who may use the service, and the log of what the command line did."""

import json
import sqlite3
from pathlib import Path
from typing import Any

import pytest
from argon2 import PasswordHasher

from api.access.audit import entries
from api.access.tokens import token_caller
from goniometer.storage.store import Store

PASSWORD = "correct horse battery staple"
CURVES = "theta_in,theta_out,wavelength,brdf\n" + "".join(
    f"{theta_in},{theta_out},{wavelength},{0.3 + 0.001 * theta_out}\n"
    for theta_in in (20, 45)
    for theta_out in (-40, -5, 10, 30, 60)
    for wavelength in (450, 550, 650)
)


@pytest.fixture(scope="module")
def bench(cli: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder whose database knows anna, admin, and bert, viewer."""
    folder = tmp_path_factory.mktemp("access")
    for name, role in (("anna", "admin"), ("bert", "viewer")):
        done = cli("user", "add", name, "--role", role, cwd=folder, typed=f"{PASSWORD}\n")
        assert done.returncode == 0
        made = name == "anna"  # a name that was misspelt is seen by it
        assert done.stderr.endswith("goniometer.db was not there and has been made.\n") if made else done.stderr == ""
    return folder


def logged(folder: Path) -> list[tuple[str, dict[str, Any]]]:
    """Actions and what the log tells of them, oldest first."""
    store = Store.open(folder / "goniometer.db")
    found = [(entry.action, json.loads(entry.about)) for entry in reversed(entries(store, limit=200))]
    store.close()
    return found


def test_who_was_added_at_the_command_line_can_log_in_with_what_was_piped_in(bench: Path) -> None:
    with sqlite3.connect(bench / "goniometer.db") as connection:
        [(stored,)] = connection.execute("SELECT password FROM users WHERE name = 'anna'")
    connection.close()
    assert PasswordHasher().verify(stored, PASSWORD)


def test_a_database_of_users_alone_is_said_to_be_empty(cli: Any, bench: Path) -> None:
    told = cli("status", cwd=bench)
    assert (told.returncode, told.stdout) == (0, "Nothing has been measured in goniometer.db yet.\n")


def test_a_token_of_the_command_line_works_and_what_was_done_is_in_the_log(cli: Any, bench: Path) -> None:
    before = len(logged(bench))
    made = json.loads(cli("token", "create", "night", "--user", "bert", "--days", 1, "--json", cwd=bench).stdout)
    store = Store.open(bench / "goniometer.db")
    caller = token_caller(store, made["token"])
    store.close()
    assert caller is not None
    assert (caller.name, caller.role) == ("bert", "viewer")
    listed = cli("token", "list", "--json", cwd=bench)
    assert [each["label"] for each in json.loads(listed.stdout)["tokens"]] == ["night"]
    assert made["token"] not in listed.stdout
    (bench / "curves.csv").write_text(CURVES)
    stated = {
        "relative-uncertainty": 0.02, "relative-noise": 0.001, "aperture": 0, "angle-uncertainty": 0.1,
        "quantity": "brdf", "angles": "deg", "wavelengths": "nm",
    }  # fmt: skip
    options = [each for name, value in stated.items() for each in (f"--{name}", value)]
    done = cli("import", "curves.csv", *options, cwd=bench)
    assert done.returncode == 0, done.stderr
    assert cli("user", "disable", "bert", cwd=bench).returncode == 0
    found = logged(bench)[before:]
    assert [action for action, _ in found] == ["token create", "import", "user disable"]
    assert found[0][1] == {
        "label": "night", "user": "bert", "days": 1.0, "number": made["id"], "outcome": "done",
    }  # fmt: skip
    assert (found[1][1]["file"], found[1][1]["aperture"], found[1][1]["outcome"]) == ("curves.csv", 0.0, "done")
    assert made["token"] not in json.dumps(found)
    store = Store.open(bench / "goniometer.db")
    assert token_caller(store, made["token"]) is None
    store.close()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["user", "role", "anna", "viewer"], "anna is the only admin"),
        (["user", "add", "anna"], "There is a user anna already"),
        (["user", "add", "carl"], "characters"),
        (["user", "remove", "carl"], "no user carl"),
        (["token", "create", "x", "--user", "bert", "--role", "admin"], "cannot have the role admin"),
        (["token", "revoke", "99"], "no token 99"),
        (["user", "role", "anna", "king"], "king"),
        (["user"], "Missing command"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line_and_not_logged(
    cli: Any, bench: Path, arguments: list[str], words: str
) -> None:
    before = logged(bench)
    typed = "short\n" if "carl" in arguments else f"{PASSWORD}\n"
    done = cli(*arguments, cwd=bench, typed=typed)
    assert done.returncode == 2, done.stderr
    assert words in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert logged(bench) == before


def test_the_log_can_be_read_verified_and_found_to_be_tampered_with(cli: Any, bench: Path, tmp_path: Path) -> None:
    head = cli("log", "head", cwd=bench).stdout.strip()
    shown = json.loads(cli("log", "show", "-n", 2, "--json", cwd=bench).stdout)["log"]
    assert (len(shown), shown[-1]["hash"]) == (2, head)
    whole = cli("log", "verify", "--head", head, cwd=bench)
    assert whole.returncode == 0
    assert head in whole.stdout
    with sqlite3.connect(bench / "goniometer.db") as source, sqlite3.connect(tmp_path / "goniometer.db") as copy:
        source.backup(copy)
        copy.executescript("DROP TRIGGER log_no_update; UPDATE log SET who = 'nobody' WHERE sequence = 1")
    source.close()
    copy.close()
    changed = cli("log", "verify", "--json", cwd=tmp_path)
    assert changed.returncode == 1
    assert "Row 1 " in json.loads(changed.stdout)["fault"]
    assert cli("log", "verify", "--head", "0" * 63 + "1", cwd=bench).returncode == 1
