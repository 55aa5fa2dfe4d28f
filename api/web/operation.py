"""Whether the service lives, what it counts, and what it is."""

from fastapi import APIRouter

from api.bodies.service import About, Health
from api.web.access import Viewer
from api.web.context import Here
from goniometer.storage import look_up
from goniometer.storage.derived import software_version

router = APIRouter(tags=["operation"])


@router.get("/health")
def health(live: Here) -> Health:
    """Answers as soon as the database does."""
    look_up.campaign_rows(live.store, 0, 1)
    return Health(status="ok")


@router.get("/api/about")
def about(live: Here, caller: Viewer) -> About:
    """What this service is, and which bench it drives."""
    return About(version=software_version(), simulated=live.settings is None)
