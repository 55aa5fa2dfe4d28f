"""Whatever is sent to the service, it answers as its OpenAPI document says, and never with a fault of its own."""

import re
from collections.abc import Iterator
from typing import Any

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from schemathesis.checks import not_a_server_error
from schemathesis.core.failures import Failure, FailureGroup
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from tests.served import Served, served, wait_for

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
]
EXAMPLES = 4
"""Of each operation; what one of them breaks at all, mostly breaks at once."""


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A service with nothing in its database."""
    with served(tmp_path_factory.mktemp("openapi"), mounts_by_itself=True) as service:
        wait_for(lambda: service.state()["driver"])
        yield service
        assert service.client.get("/api/me").status_code == 200, "it still knows who asks"


@pytest.fixture(scope="module")
def document(service: Served) -> Any:
    """The OpenAPI document of the whole application, without what has no end or ends the session of the test."""
    found: Any = schemathesis.openapi.from_url(f"{service.url}/api/openapi.json")
    for path in ("/api/events", "/api/logout", "/api/me/password", "/api/tokens/{token_id}", "/api/login"):
        found = found.exclude(path=path)
    return found


@pytest.mark.slow
def test_every_answer_is_one_that_the_document_tells_of(document: Any, service: Served) -> None:
    headers = dict(service.client.headers)
    wrong = []
    for found in document.get_all_operations():
        operation = found.ok()

        @given(case=operation.as_strategy())
        @settings(
            max_examples=EXAMPLES,
            deadline=None,
            derandomize=True,
            database=None,
            phases=[Phase.explicit, Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        def check(case: Any) -> None:
            case.call_and_validate(headers=headers, checks=CHECKS, timeout=60)

        try:
            check()
        except (FailureGroup, Failure) as failure:
            wrong.append(f"{operation.method.upper()} {operation.path}: {failure}")
    assert not wrong, "\n\n".join(wrong)


def test_a_parameter_that_an_endpoint_does_not_have_is_refused_and_nothing_is_done(service: Served) -> None:
    paths = service.client.get("/api/openapi.json").json()["paths"]
    open_to_all = {"/health", "/api/login", "/metrics"}
    asked = [(path, method) for path in paths.keys() - open_to_all for method in paths[path]]
    assert len(asked) > 80
    for path, method in asked:
        address = re.sub(r"\{\w+\}", "1", path)
        answer = service.client.request(method.upper(), address, params={"sampel": "x", "mdoel": "y"})
        assert answer.status_code == 422, (path, method)
        assert [each["where"] for each in answer.json()["errors"]] == ["mdoel", "sampel"], (path, method)
    told = service.client.get("/api/datasets", params={"sampel": "x"}).json()["detail"]
    assert told.startswith("sampel: there is no such parameter; there is after, ")
    assert "sample" in told
