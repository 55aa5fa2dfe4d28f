"""A database of any older version is used on with all that was in it."""

import re
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Boolean, Engine, create_engine, event, text
from sqlalchemy.exc import IntegrityError

from goniometer.campaigns.campaign import Sample
from goniometer.constants import BenchData
from goniometer.errors import StoreError, StoreFull, StoreOutdated
from goniometer.storage import migrations, tables
from goniometer.storage.migrations import baseline
from goniometer.storage.only_added import protect
from goniometer.storage.store import Store
from goniometer.upkeep.upgrade import upgrade
from tests.databases import fresh_database, outside
from tests.goniometer.old_databases import COMMON, COUNTS, DATASET, SCHEMAS, TAKEN, build, version_of


@pytest.fixture(params=SCHEMAS, ids=lambda schema: schema.stem)
def old(request: Any, tmp_path: Path) -> tuple[Path, int]:
    """A database of an old version, and its number."""
    file = tmp_path / "old.db"
    build(request.param, file)
    return file, version_of(request.param)


def rows(file: Path, query: str) -> list[tuple[Any, ...]]:
    """What a query finds, read by SQLite alone."""
    with closing(sqlite3.connect(file)) as connection:
        return connection.execute(query).fetchall()


def shape(file: Path) -> set[tuple[str, str, tuple[str, ...]]]:
    """Every table, index and trigger with the parts that make it; their order and quotes around names do not count."""

    def parts(sql: str) -> tuple[str, ...]:
        head, _, rest = " ".join(sql.replace('"', "").split()).partition("(")
        body, _, tail = rest.rpartition(")")
        commas = r",(?![^()]*\))"  # outside of inner brackets
        return (head.strip(), tail.strip(), *sorted(part.strip() for part in re.split(commas, body)))

    return {
        (kind, name, parts(sql))
        for kind, name, sql in rows(file, "SELECT type, name, sql FROM sqlite_master WHERE sql IS NOT NULL")
    }


def test_every_old_version_has_its_database_here() -> None:
    assert {version_of(schema) for schema in SCHEMAS} == set(range(1, 8))


# those indexes are compared as texts
@pytest.mark.filterwarnings("ignore:Skipped unsupported reflection of expression-based index")
def test_an_upgraded_database_has_the_tables_constraints_and_triggers_of_a_new_one(
    old: tuple[Path, int], tmp_path: Path
) -> None:
    upgrade(old[0])
    engine = create_engine(f"sqlite:///{old[0]}")
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True, "compare_server_default": True})
        assert compare_metadata(context, tables.metadata) == []
    engine.dispose()
    Store.open(tmp_path / "new.db").close()
    assert shape(old[0]) ^ shape(tmp_path / "new.db") == set()
    assert rows(old[0], "PRAGMA integrity_check") == [("ok",)]
    assert rows(old[0], "PRAGMA foreign_key_check") == []
    assert rows(old[0], "SELECT * FROM alembic_version") == [(migrations.head(),)]


def test_no_row_of_an_old_database_is_lost_or_changed(old: tuple[Path, int]) -> None:
    file, version = old
    before = {name for (name,) in rows(file, "SELECT name FROM sqlite_master WHERE type = 'table'")}
    kept = {
        name: [column for _, column, *_ in rows(file, f"PRAGMA table_info({name})")]
        for name in before - {"about", "sqlite_sequence"}
    }
    rewritten = {"arrays"} | ({"json", "constants"} if version < 5 else set())  # they are read below
    queries = {
        name: f"SELECT {', '.join(c for c in columns if c not in rewritten)} FROM {name} ORDER BY 1"
        for name, columns in kept.items()
    }
    read = {name: rows(file, query) for name, query in queries.items()}
    assert all(read.values())
    upgrade(file)
    assert {name: rows(file, query) for name, query in queries.items()} == read
    store = Store.open(file)
    campaign = store.campaign(1)
    assert campaign.samples == (Sample(name="A", material="sample-1"),)
    assert campaign.resolution.minimum_step == (0.5 if version < 5 else 0.2)
    assert store.constants(2).bench == BenchData(gain=4.5, u_angle=0.006, aperture=1.1)
    dark, light = store.exposures(2)
    assert light.counts.astype("<u4").tobytes() == dark.counts.astype("<u4").tobytes() == COUNTS
    assert light.geometry is not None
    assert (light.geometry.theta_in, light.geometry.theta_out) == (10.01, 20.02)
    assert (light.session, light.moment) == {
        True: ("unknown", 1767323045.0),  # TAKEN in seconds since 1970
        False: ("unknown" if version == 3 else "s1", 12.5),
    }[version < 3]
    dataset = store.dataset(4)
    np.testing.assert_array_equal(dataset.brdf, [[0.1, 0.2], [np.nan, 0.4]])
    np.testing.assert_array_equal(dataset.flags, [0, 1])
    # the sources' squares add up: 1 % of random error, and 2 % of every other that the version told apart
    others = {1: 1, 2: 3}.get(version, 0)
    np.testing.assert_allclose(dataset.u[0], dataset.brdf[0] * np.sqrt(1 + 4 * others) / 100)
    (entry,) = [store.entry(4)]
    assert (entry.points, entry.incident_angles, entry.flagged, entry.shortest, entry.longest) == (2, 1, 1, 400, 700)
    assert entry.content_hash == DATASET["content_hash"]
    assert entry.checks_failed == (0 if version < 3 else 1)
    store.close()


def test_an_old_database_is_backed_up_and_refused_until_it_is_upgraded(old: tuple[Path, int]) -> None:
    file, version = old
    with pytest.raises(StoreOutdated, match="goniometer db upgrade"):
        Store.open(file)
    assert rows(file, "SELECT schema_version FROM about") == [(version,)]
    done = upgrade(file)
    assert done.backup is not None
    assert rows(done.backup, "SELECT schema_version FROM about") == [(version,)]
    assert rows(done.backup, "SELECT counts FROM exposures") == [(COUNTS,), (COUNTS,)]
    assert upgrade(file).steps == []


def test_an_upgrade_that_fails_changes_nothing(tmp_path: Path) -> None:
    file = tmp_path / "old.db"
    build(SCHEMAS[0], file)
    with closing(sqlite3.connect(file)) as connection, connection:
        connection.execute("UPDATE points SET read_theta_in = NULL")  # the exposure's direction is nowhere
    Store.as_it_is(file).close()  # it is in the journal mode that the program uses
    before = shape(file), rows(file, "SELECT * FROM exposures")
    with pytest.raises(StoreError, match="CHECK constraint"):
        upgrade(file)
    assert (shape(file), rows(file, "SELECT * FROM exposures")) == before


def test_an_upgrade_that_finds_no_room_changes_nothing_and_is_made_once_there_is(tmp_path: Path) -> None:
    file = tmp_path / "old.db"
    build(SCHEMAS[0], file)
    Store.as_it_is(file).close()
    before = shape(file), rows(file, "SELECT * FROM exposures")

    def limit(connection: Any, _: object) -> None:
        connection.execute(f"PRAGMA max_page_count = {file.stat().st_size // 4096 + 2}")

    event.listen(Engine, "connect", limit)
    try:
        with pytest.raises(StoreFull):
            upgrade(file)
    finally:
        event.remove(Engine, "connect", limit)
    assert (shape(file), rows(file, "SELECT * FROM exposures")) == before
    assert len(upgrade(file).steps) == len(migrations.known())


def test_a_database_of_a_newer_program_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "new.db"
    Store.open(file).close()
    with closing(sqlite3.connect(file)) as connection, connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    for use in (Store.open, upgrade):
        with pytest.raises(StoreError, match="newer version"):
            use(file)


def test_the_newest_file_is_the_only_head_that_alembic_finds() -> None:
    scripts = ScriptDirectory(str(migrations.FOLDER))
    assert scripts.get_heads() == [migrations.head()]
    assert [script.revision for script in scripts.walk_revisions()][::-1] == list(migrations.known())


def test_what_earlier_programs_are_told_makes_them_refuse(tmp_path: Path) -> None:
    file = tmp_path / "new.db"
    Store.open(file).close()
    ((version,),) = rows(file, "SELECT schema_version FROM about")
    assert version not in {version_of(schema) for schema in SCHEMAS}


def test_a_postgresql_database_is_upgraded_with_all_that_is_in_it(postgresql: str) -> None:
    with fresh_database(postgresql, empty=True) as database:
        with outside(database) as connection:
            baseline.metadata.create_all(connection)
            exposure = {"id": 11, "scan_id": 2, "kind": "dark", "integration_time": 0.25, "counts": COUNTS}
            exposure |= {"device_count": 7, "detector_temperature": -10.125, "session": "s1", "moment": 12.5}
            rows = {
                "about": {"application": "goniometer", "schema_version": 8},
                "campaigns": COMMON["campaigns"] | {"json": "{}"},
                **{name: COMMON[name] for name in ("scans", "characterisations", "lease", "queue")},
                "exposures": exposure | {"taken": TAKEN},
            }
            for name, row in rows.items():
                table = baseline.metadata.tables[name]
                booleans = {column.name for column in table.columns if isinstance(column.type, Boolean)}
                known = {key: bool(value) if key in booleans else value for key, value in row.items()}
                connection.execute(table.insert().values(**known))
            for table in baseline.metadata.sorted_tables:
                if table.info:
                    protect(connection, table.name)
            connection.execute(text("CREATE TABLE alembic_version (version_num VARCHAR(32) PRIMARY KEY)"))
            connection.execute(text("INSERT INTO alembic_version VALUES ('0001')"))
        with pytest.raises(StoreOutdated, match="goniometer db upgrade"):
            Store.open(database)
        assert [step[:4] for step in upgrade(database).steps] == list(migrations.known()[1:])
        store = Store.open(database)
        assert [exposure.counts.astype("<u4").tobytes() for exposure in store.exposures(2)] == [COUNTS]
        store.close()
        with outside(database) as connection:
            opts = {"compare_type": True, "compare_server_default": True}
            context = MigrationContext.configure(connection, opts=opts)
            differences = compare_metadata(context, tables.metadata)
            assert [each for each in differences if "alembic_version" not in str(each)] == []
            assert connection.execute(text("SELECT term, bench FROM lease")).all() == [(2, "bench")]
            assert connection.execute(text("SELECT name, bench FROM campaigns")).all() == [("First", "bench")]
        with pytest.raises(IntegrityError, match="only ever added"), outside(database) as connection:
            connection.execute(text("UPDATE characterisations SET bench = 'other'"))
