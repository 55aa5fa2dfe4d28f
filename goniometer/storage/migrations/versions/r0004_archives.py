"""Raw counts may move into archives, and lists of a year's measurements have their indexes."""

from alembic import op
from sqlalchemy import BigInteger, Column, ForeignKey, Integer, String, text

from goniometer.storage.only_added import let_counts_move

revision = "0004"
down_revision = "0003"

_INDEXES = {
    "scans_by_kind": ("scans", "kind", "sample", "campaign_id"),
    "scans_by_phase": ("scans", "phase"),
    "datasets_of_scan": ("datasets", "scan_id", "sample"),
    "datasets_by_kind": ("datasets", "kind"),
    "datasets_by_time": ("datasets", "created"),
    "datasets_by_flags": ("datasets", "flags"),
    "datasets_made_anew": ("datasets", "recalibrated_from"),
    "fits_of_dataset": ("fits", "dataset_id"),
    "exports_of_dataset": ("exports", "dataset_id"),
    "queue_of_campaign": ("queue", "campaign_id"),
}


def upgrade() -> None:
    """See the module."""
    op.create_table(
        "archives",
        Column("id", Integer, primary_key=True),
        Column("scan_id", Integer, ForeignKey("scans.id"), nullable=False, unique=True),
        Column("path", String, nullable=False),
        Column("sha256", String, nullable=False),
        Column("octets", BigInteger, nullable=False),
        Column("exposures", Integer, nullable=False),
        Column("created", String, nullable=False),
    )
    let_counts_move(op.get_bind())
    for name, (table, *columns) in _INDEXES.items():
        op.create_index(name, table, columns)
    for name, table in (("scans_called", "scans"), ("datasets_called", "datasets")):
        op.create_index(name, table, [text("lower(sample)")])
