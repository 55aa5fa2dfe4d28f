"""A job that failed tells programs what kind of fault it was."""

from alembic import op
from sqlalchemy import Column, String

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """What failed before tells its sentence only."""
    op.add_column("jobs", Column("fault", String))
