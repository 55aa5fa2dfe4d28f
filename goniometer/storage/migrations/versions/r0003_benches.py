"""Several benches use one database: campaigns, the queue, the lease and characterisations name theirs."""

from alembic import op
from sqlalchemy import BigInteger, Boolean, Column, Integer, String, column, select, table

revision = "0003"
down_revision = "0002"


def upgrade() -> None:
    """Everything before was done on the bench that is called "bench"."""
    for name in ("campaigns", "characterisations", "queue"):
        op.add_column(name, Column("bench", String, nullable=False, server_default="bench"))
    _write_lease_anew()
    if op.get_bind().dialect.name == "postgresql":  # whose integers have a sign, other than the number of the device
        op.alter_column("exposures", "device_count", type_=BigInteger)


def _write_lease_anew() -> None:
    """Its row was the only one, by a constraint that SQLite cannot drop."""
    names = ("id", "term", "beat", "holder", "host", "process", "url", "taken")
    old = table("lease", *(column(name) for name in names), column("stop", Boolean))
    rows = [dict(row) for row in op.get_bind().execute(select(old)).mappings()]
    op.drop_table("lease")
    lease = op.create_table(
        "lease",
        Column("id", Integer, primary_key=True),
        Column("term", Integer, nullable=False),
        Column("beat", Integer, nullable=False),
        Column("holder", String),
        Column("host", String, nullable=False),
        Column("process", Integer, nullable=False),
        Column("url", String, nullable=False),
        Column("taken", String, nullable=False),
        Column("stop", Boolean, nullable=False, default=False),
        Column("bench", String, nullable=False, unique=True, server_default="bench"),
    )
    op.bulk_insert(lease, rows)
