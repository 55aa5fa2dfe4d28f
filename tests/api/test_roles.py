"""Every endpoint against every role: who may call it, and that nobody else is let in.

A new endpoint without an entry in `WHO_MAY` fails here. Endpoints are really asked; only, where one that may be called
reaches for the bench or the database, it is stopped there.
"""

from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.routing import iter_route_contexts
from starlette.exceptions import HTTPException

from api.access.accounts import add_user, at_least
from api.access.tokens import create_token
from api.choices import ROLES, Role
from api.web.live import open_live
from tests.api.service_client import Client

WHO_MAY: dict[str, Role | None] = {
    "GET /health": None,
    "GET /metrics": None,
    "GET /{path:path}": None,
    "GET /api/openapi.json": None,
    "POST /api/login": None,
    "POST /api/logout": "viewer",
    "GET /api/me": "viewer",
    "POST /api/me/password": "viewer",
    "GET /api/me/sessions": "viewer",
    "DELETE /api/me/sessions/{session}": "viewer",
    "GET /api/users": "admin",
    "POST /api/users": "admin",
    "PATCH /api/users/{name}": "admin",
    "DELETE /api/users/{name}": "admin",
    "GET /api/tokens": "viewer",
    "POST /api/tokens": "viewer",
    "DELETE /api/tokens/{token_id}": "viewer",
    "GET /api/log": "operator",
    "GET /api/about": "viewer",
    "GET /api/events": "viewer",
    "GET /api/instrument": "viewer",
    "GET /api/instrument/spectrum": "viewer",
    "GET /api/instrument/history": "viewer",
    "POST /api/instrument/connect": "operator",
    "POST /api/instrument/disconnect": "operator",
    "POST /api/instrument/home": "operator",
    "POST /api/instrument/jog": "operator",
    "POST /api/instrument/expose": "operator",
    "POST /api/instrument/stop": "operator",
    "POST /api/instrument/doctor": "operator",
    "POST /api/campaigns/validate": "viewer",
    "POST /api/campaigns/preview": "viewer",
    "GET /api/campaigns": "viewer",
    "GET /api/campaigns/{number}": "viewer",
    "GET /api/queue": "viewer",
    "POST /api/queue": "operator",
    "GET /api/queue/{number}": "viewer",
    "PATCH /api/queue/{number}": "operator",
    "DELETE /api/queue/{number}": "operator",
    "POST /api/queue/{number}/start": "operator",
    "POST /api/queue/{number}/pause": "operator",
    "POST /api/queue/{number}/resume": "operator",
    "POST /api/queue/{number}/abort": "operator",
    "POST /api/queue/{number}/mounted": "operator",
    "GET /api/scans": "viewer",
    "GET /api/scans/{number}": "viewer",
    "GET /api/scans/{number}/points": "viewer",
    "GET /api/scans/{number}/brdf": "viewer",
    "GET /api/points/{number}": "viewer",
    "GET /api/exposures/{number}": "viewer",
    "POST /api/uploads": "operator",
    "POST /api/datasets/import": "operator",
    "GET /api/datasets": "viewer",
    "GET /api/datasets/{number}": "viewer",
    "GET /api/datasets/{number}/map": "viewer",
    "GET /api/datasets/{number}/points/{point}": "viewer",
    "GET /api/datasets/{number}/slopes": "viewer",
    "GET /api/datasets/{number}/distributions": "viewer",
    "GET /api/datasets/{number}/models": "viewer",
    "GET /api/datasets/{number}/checks": "viewer",
    "GET /api/datasets/{number}/budget": "viewer",
    "GET /api/datasets/{number}/lineage": "viewer",
    "GET /api/datasets/{number}/spectra": "viewer",
    "GET /api/samples": "viewer",
    "GET /api/samples/{name}": "viewer",
    "GET /api/datasets/{number}/fits": "viewer",
    "POST /api/datasets/{number}/fits": "operator",
    "GET /api/fits/{number}": "viewer",
    "GET /api/exports/formats": "viewer",
    "GET /api/datasets/{number}/exports": "viewer",
    "POST /api/datasets/{number}/exports": "operator",
    "POST /api/datasets/{number}/report": "operator",
    "GET /api/exports/{number}/file": "viewer",
    "GET /api/certificates": "viewer",
    "POST /api/certificates": "metrologist",
    "GET /api/certificates/{sha256}": "viewer",
    "GET /api/references": "viewer",
    "GET /api/history": "viewer",
    "GET /api/characterisations": "viewer",
    "POST /api/datasets/{number}/recalibrate": "metrologist",
    "POST /api/tradeoff": "operator",
    "GET /api/tradeoff/{number}": "viewer",
    "POST /api/stability": "operator",
    "GET /api/stability/{number}": "viewer",
    "GET /api/stability/{number}/ensemble": "viewer",
    "POST /api/choose": "operator",
    "GET /api/choose/{number}": "viewer",
    "GET /api/choose/{number}/pictures/{by}/{name}": "viewer",
    "GET /api/jobs": "viewer",
    "GET /api/jobs/{number}": "viewer",
    "GET /api/jobs/{number}/result": "viewer",
    "GET /api/jobs/{number}/page": "viewer",
    "POST /api/jobs/{number}/again": "operator",
    "DELETE /api/jobs/{number}": "operator",
}
"""The least role that may call an endpoint; None: everybody."""


class OutOfReach:
    """Stands for the running service: whoever reaches for a part of it has been let in, and gets no further."""

    def __getattr__(self, name: str) -> Any:
        raise HTTPException(418, name)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Client, dict[Role | None, str | None]]]:
    """The service, and a token of each role; None: no token."""
    folder = tmp_path_factory.mktemp("roles")
    with open_live(folder / "bench.db", folder) as live:
        tokens: dict[Role | None, str | None] = {None: None}
        for role in ROLES:
            add_user(live.store, role, role, None)
            tokens[role], _ = create_token(live.store, role, "test")
        client = Client(live)
        client.app.state.live = OutOfReach()
        yield client, tokens


def endpoints(client: Client) -> set[str]:
    """Every method and path that the application answers, whether its document tells of it or not."""
    found = iter_route_contexts(client.app.routes)
    return {f"{method} {route.path}" for route in found for method in route.methods or () if method != "HEAD"}


def test_nobody_may_call_what_is_above_their_role_and_everybody_what_is_not(service: Any) -> None:
    client, tokens = service
    assert endpoints(client) - WHO_MAY.keys() == set(), "these have no entry"
    assert WHO_MAY.keys() - endpoints(client) == set(), "these entries are left over"
    wrong = []
    for endpoint, least in WHO_MAY.items():
        method, path = endpoint.split()
        for role, token in tokens.items():
            headers = {} if token is None else {"Authorization": f"Bearer {token}"}
            status = client.request(method, path.replace("{", "").replace("}", ""), headers=headers).status_code
            if least is None or (role is not None and at_least(role, least)):
                fine = status not in {401, 403, 405, 500}
            else:
                fine = status == (401 if role is None else 403)
            if not fine:
                wrong.append(f"{endpoint} as {role or 'nobody'}: {status}")
    assert not wrong
