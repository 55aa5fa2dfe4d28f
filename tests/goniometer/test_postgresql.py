"""What a server refuses is said in one sentence that tells what to do."""

import re

import pytest
from sqlalchemy import text
from sqlalchemy.engine import make_url
from sqlalchemy.exc import IntegrityError

from goniometer.errors import StoreError, StoreFull
from goniometer.storage.store import Store
from goniometer.upkeep.archiving import archive_scan, unarchive_scan
from tests.databases import fresh_database, outside
from tests.goniometer.test_store import CAMPAIGN, CONSTANTS, spectrum


@pytest.fixture
def server(postgresql):
    """Address of a database with our tables."""
    with fresh_database(postgresql) as url:
        yield url


def refused(store, kind, words):
    """Write something, which must be refused in one line of these words; nothing of it stays."""
    with pytest.raises(kind, match=words) as caught:
        store.add_characterisation("noise", "{}")
    assert "\n" not in str(caught.value)
    assert store.characterisations() == []


@pytest.mark.parametrize(
    ("state", "kind", "words"),
    [
        ("53100", StoreFull, "no room left on its server"),
        ("57P01", StoreError, "see that the server runs"),
        ("40P01", StoreError, "locked by somebody else"),
        ("XX001", StoreError, "cannot be used"),
    ],
)
def test_what_the_server_refuses_is_told_by_what_to_do_about_it(server, state, kind, words):
    with outside(server) as other:
        other.execute(
            text(
                "CREATE FUNCTION refuse() RETURNS trigger LANGUAGE plpgsql AS "
                f"$$ BEGIN RAISE EXCEPTION E'It will not.\\nNo.' USING ERRCODE = '{state}'; END $$"
            )
        )
        other.execute(text("CREATE TRIGGER a BEFORE INSERT ON characterisations EXECUTE FUNCTION refuse()"))
    store = Store.open(server)
    refused(store, kind, words)
    store.close()


def test_a_server_that_can_only_be_read_is_read(server):
    url = make_url(server).update_query_dict({"options": "-c default_transaction_read_only=on"})
    store = Store.open(url.render_as_string(hide_password=False))
    refused(store, StoreError, "can only be read")
    store.close()


def test_who_may_only_read_is_told_so(server):
    with outside(server) as other:
        other.execute(text("DROP ROLE IF EXISTS reader"))
        other.execute(text("CREATE ROLE reader LOGIN"))
        other.execute(text("GRANT SELECT ON ALL TABLES IN SCHEMA public TO reader"))
    store = Store.open(make_url(server).set(username="reader").render_as_string(hide_password=False))
    refused(store, StoreError, "does not allow this")
    store.close()
    with outside(server) as other:
        other.execute(text("DROP OWNED BY reader"))
        other.execute(text("DROP ROLE reader"))


def test_the_database_of_another_program_is_refused_and_left_as_it_is(postgresql):
    with fresh_database(postgresql, empty=True) as url:
        with outside(url) as other:
            other.execute(text("CREATE TABLE songs (title TEXT)"))
        with pytest.raises(StoreError, match="another program"):
            Store.open(url)


@pytest.mark.parametrize(
    "address",
    [
        "postgresql://anna:hunter2@127.0.0.1:1/x",
        "postgresql://anna@127.0.0.1:1/x?password=hunter2",
        "postgresql://anna:hunter2@127.0.0.1:port/x",
        "mysql://anna:hunter2@127.0.0.1/x",
    ],
)
def test_no_refusal_tells_a_password(address):
    with pytest.raises(StoreError) as caught:
        Store.open(address)
    assert "\n" not in str(caught.value)
    assert re.search("hunter2", str(caught.value)) is None


def test_raw_counts_move_to_an_archive_and_back_and_are_otherwise_only_added(server, tmp_path):
    store = Store.open(server)
    scan = store.scans(store.add_campaign(CAMPAIGN))[1].id
    store.save_constants(scan, CONSTANTS)
    store.add_exposures(scan, "dark", [spectrum(i) for i in range(5)], "one", 0.0)
    store.set_phase(scan, "running")
    store.finish_scan(scan, "completed")
    before = [each.counts.tobytes() for each in store.exposures(scan)]
    changes = ["UPDATE exposures SET counts = ''", "UPDATE exposures SET moment = 7"]
    for statement in changes:
        with pytest.raises(IntegrityError, match="only ever added"), outside(server) as other:
            other.execute(text(statement))
    moved = archive_scan(store, scan, tmp_path)
    with outside(server) as other:
        assert other.execute(text("SELECT sum(length(counts)) FROM exposures")).scalar() == 0
    assert [each.counts.tobytes() for each in store.exposures(scan)] == before
    for statement in ("UPDATE exposures SET moment = 7", "DELETE FROM archives", "DELETE FROM exposures"):
        with pytest.raises(IntegrityError, match=r"only ever added|in this archive only"), outside(server) as other:
            other.execute(text(statement))
    assert unarchive_scan(store, scan).freed == -moved.freed
    assert [each.counts.tobytes() for each in store.exposures(scan)] == before
    store.close()
