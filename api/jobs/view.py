"""Jobs as answers show them."""

import json
from dataclasses import fields

from api.bodies.jobs import JobView
from api.jobs.kinds import KINDS
from api.jobs.rows import Job


def job_view(job: Job) -> JobView:
    """A job as an answer shows it."""
    values = {field.name: getattr(job, field.name) for field in fields(job)}
    return JobView(**(values | {"title": KINDS[job.kind].about, "arguments": json.loads(job.arguments)}))
