"""Two benches on one database: each service drives its own, and everybody sees what was measured on both."""

import json
import time
from functools import partial
from pathlib import Path

import pytest
from sqlalchemy import text
from sqlalchemy.engine import make_url

from goniometer.errors import StoreError
from goniometer.storage.store import Store
from tests.api.conftest import Cli
from tests.databases import fresh_database, outside
from tests.drawn_dataset import drawn_dataset
from tests.served import LONG, TINY, Served, served, wait_for

ENDING = 60_000
"""Milliseconds that the end of a connection may take; without them PostgreSQL asks it to end and waits for nothing."""


def is_finished(service: Served, number: int) -> bool:
    return bool(service.entry(number)["phase"] == "finished")


def is_under_way(service: Served, number: int) -> bool:
    return bool(service.entry(number)["points_done"] > 3)


@pytest.mark.slow
@pytest.mark.parametrize("database", ["postgresql"], indirect=True)
def test_two_services_measure_at_once_on_one_database_and_each_lists_the_datasets_of_both(
    tmp_path: Path, database: Path | str
) -> None:
    folders = {bench: tmp_path / bench for bench in ("left", "right")}
    with (
        served(folders["left"], database, bench="left", mounts_by_itself=True) as left,
        served(folders["right"], database, bench="right", mounts_by_itself=True) as right,
    ):
        services = {"left": left, "right": right}
        entries = {bench: service.ordered(TINY, name=f"On the {bench}") for bench, service in services.items()}
        for bench, service in services.items():
            wait_for(partial(is_finished, service, entries[bench]))
            ended = service.entry(entries[bench])
            assert (ended["outcome"], ended["reason"]) == ("completed", "")
            assert service.state()["name"] == bench
            assert service.state()["driver"]["here"]
        for service in services.values():
            found = service.client.get("/api/datasets").json()["items"]
            assert {(row["campaign"], row["bench"]) for row in found} == {
                ("On the left", "left"),
                ("On the right", "right"),
            }
            scans = service.client.get("/api/scans").json()["items"]
            assert {scan["outcome"] for scan in scans} == {"completed"}
        for bench in services:
            assert (folders[bench] / "results" / f"on-the-{bench}" / "sample-1" / "report.html").exists()
        assert left.client.get(f"/api/queue/{entries['right']}").status_code == 404


def test_a_stop_stops_its_own_bench_only(tmp_path: Path, database: Path | str) -> None:
    with (
        served(tmp_path, database, bench="left", mounts_by_itself=True) as left,
        served(tmp_path, database, bench="right", mounts_by_itself=True) as right,
    ):
        entries = {service: service.ordered(LONG, name=service.url) for service in (left, right)}
        for service, number in entries.items():
            wait_for(partial(is_under_way, service, number))
        assert left.client.post("/api/instrument/stop").status_code == 200
        wait_for(lambda: left.entry(entries[left])["phase"] == "finished")
        before = right.entry(entries[right])["points_done"]
        wait_for(lambda: right.entry(entries[right])["points_done"] > before)
        wait_for(lambda: right.client.post(f"/api/queue/{entries[right]}/abort").status_code == 200)


@pytest.mark.slow
def test_a_service_whose_connections_were_all_lost_drives_again_and_measures(tmp_path: Path, postgresql: str) -> None:
    with (
        fresh_database(postgresql) as database,
        served(tmp_path, database, mounts_by_itself=True) as service,
    ):
        number = service.ordered(LONG)
        wait_for(lambda: service.entry(number)["points_done"] > 3)
        process = service.state()["driver"]["process"]
        end_connections(database)
        wait_for(lambda: service.entry(number)["phase"] in {"idle", "finished"})
        before = service.entry(number)["points_done"]
        assert before > 3
        wait_for(lambda: service.state()["driver"] and service.state()["phase"] in {"ready", "disconnected"})
        assert service.state()["shutter"] != "open"
        while (entry := service.entry(number))["points_done"] <= before:  # nothing begins before somebody has looked
            if entry["phase"] in {"idle", "finished"}:
                service.client.post(f"/api/queue/{number}/start")
            time.sleep(0.5)
        assert service.state()["driver"]["process"] == process
        service.client.post(f"/api/queue/{number}/abort")


def end_connections(database: str) -> None:
    """End all connections of a database but one's own, as they do with the server."""
    with outside(database) as other:
        other.execute(
            text(
                f"SELECT pg_terminate_backend(pid, {ENDING}) FROM pg_stat_activity "
                "WHERE datname = current_database() AND pid <> pg_backend_pid()"
            )
        )


def test_commands_work_on_a_server_and_print_no_password(postgresql: str, tmp_path: Path, cli: Cli) -> None:
    with fresh_database(postgresql) as database:
        secret = make_url(database).set(password="hunter2hunter2").render_as_string(hide_password=False)
        shown = make_url(secret).render_as_string(hide_password=True)
        store = Store.open(secret)
        store.add_dataset(None, drawn_dataset("sample-4"))
        store.close()
        export = ("export", 1, "--to", "csv", "-o", "it.csv")
        added = cli(*export, "--database", secret, cwd=tmp_path)
        assert added.returncode == 0, added.stderr
        assert (tmp_path / "it.csv").read_text().count("\n") > 1000
        told = cli("status", "--database", secret, "--json", cwd=tmp_path)
        assert json.loads(told.stdout)["database"] == shown
        logged = cli("log", "show", "--database", secret, "--json", cwd=tmp_path)
        assert "export" in logged.stdout
        nowhere = cli("status", "--database", secret.replace("/test_", "/nowhere_"), cwd=tmp_path)
        assert nowhere.returncode == 1
        assert nowhere.stderr.count("\n") == 1
        for each in (added, told, logged, nowhere):
            assert "hunter2" not in each.stdout + each.stderr


def test_who_loses_the_connection_that_keeps_others_out_writes_nothing_more(postgresql: str) -> None:
    with fresh_database(postgresql) as database:
        store = Store.open(database)
        with store.exclusive():
            store.add_characterisation("noise", "{}")
            with outside(database) as other:
                other.execute(
                    text(
                        f"SELECT pg_terminate_backend(pid, {ENDING}) FROM pg_locks "
                        "WHERE locktype = 'advisory' AND granted "  # of all databases; other tests have theirs here
                        "AND database = (SELECT oid FROM pg_database WHERE datname = current_database())"
                    )
                )
            with pytest.raises(StoreError, match="ended the connection that kept others"):
                store.add_characterisation("noise", "{}")
        with store.exclusive():  # it can be had again
            store.add_characterisation("noise", "{}")
        assert len(store.characterisations()) == 2
        store.close()


def test_a_server_that_restarts_costs_an_open_store_nothing(postgresql: str) -> None:
    with fresh_database(postgresql) as database:
        store = Store.open(database)
        assert store.campaigns() == {}
        end_connections(database)
        assert store.campaigns() == {}
        store.close()
