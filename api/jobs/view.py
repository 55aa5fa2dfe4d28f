"""Jobs as answers show them."""

import json
from dataclasses import fields
from typing import Any

from pydantic import Field

from api.jobs.kinds import KINDS
from api.jobs.rows import Job, State
from api.views.body import Body


class JobView(Body):
    """A piece of work that takes longer than an answer may."""

    id: int
    kind: str = Field(examples=["fit"])
    title: str = Field(description="What kind it is, for a person.")
    who: str = Field(description="Who asked for it.")
    state: State = Field(description='"interrupted": the service ended before it did; it can be run again.')
    share: float | None = Field(description="How much of it is done, 0 to 1; null where nobody can tell.")
    words: str = Field(description="What it does now.")
    reason: str = Field(description="Why it did not come to its end, as a sentence; empty else.")
    arguments: dict[str, Any] = Field(description="What was asked for.")
    created: str = Field(description="ISO 8601, UTC, as all times here.")
    started: str | None
    finished: str | None
    has_result: bool = Field(description="Whether there is JSON at /api/jobs/{id}/result.")
    has_page: bool = Field(description="Whether there is HTML at /api/jobs/{id}/page.")


def job_view(job: Job) -> JobView:
    """A job as an answer shows it."""
    values = {field.name: getattr(job, field.name) for field in fields(job)}
    return JobView(**(values | {"title": KINDS[job.kind].about, "arguments": json.loads(job.arguments)}))
