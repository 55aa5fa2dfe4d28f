"""A client of the service that needs no network: what it sends goes straight into the application."""

import asyncio
from typing import Any

import httpx
from fastapi import FastAPI

from api.web.access import LOCAL, Access
from api.web.app import make_app
from api.web.live import Live


class Client:
    """Keeps cookies as a browser does; every request seems to come from `address`."""

    def __init__(
        self, live: Live, access: Access = LOCAL, address: str = "127.0.0.1", app: FastAPI | None = None
    ) -> None:
        self.app: FastAPI = make_app(live, access)
        self.address = address
        self.base_url = "https://localhost" if access.secure else "http://127.0.0.1:8000"
        self.cookies = httpx.Cookies()
        self.headers: dict[str, str] = {}

    def request(self, method: str, path: str, **rest: Any) -> httpx.Response:
        """One request and its response."""

        async def ask() -> httpx.Response:
            transport = httpx.ASGITransport(self.app, client=(self.address, 4242))
            async with httpx.AsyncClient(
                transport=transport, base_url=self.base_url, cookies=self.cookies, headers=self.headers
            ) as client:
                response = await client.request(method, path, **rest)
                self.cookies = client.cookies
                return response

        return asyncio.run(ask())

    def get(self, path: str, **rest: Any) -> httpx.Response:
        """Read something."""
        return self.request("GET", path, **rest)

    def post(self, path: str, json: object = None, **rest: Any) -> httpx.Response:
        """Change something."""
        return self.request("POST", path, json=json, **rest)

    def login(self, name: str, password: str) -> httpx.Response:
        """Begin a session, and send its X-CSRF-Token from now on."""
        response = self.post("/api/login", {"name": name, "password": password})
        if response.is_success:
            self.headers["X-CSRF-Token"] = response.json()["csrf"]
        return response
