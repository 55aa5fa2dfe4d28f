"""What a call to the service is made of, and how its answer is read."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import httpx
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, TypeAdapter

from drivers.arrays import FloatArray

T = TypeVar("T")

OCTETS = "application/octet-stream"
MOST = 200
"""Items of a page, as many as the service gives."""


@dataclass(frozen=True)
class Call(Generic[T]):
    """One request, and how its answer is read."""

    method: str
    path: str
    read: Callable[[httpx.Response], T]
    query: dict[str, Any] = field(default_factory=dict)
    """None is not sent."""
    content: bytes | None = None
    content_type: str = "application/json"
    accept: str = "application/json"


@dataclass(frozen=True)
class Spectra:
    """All spectra of a dataset."""

    theta_in: FloatArray
    """[points] degrees."""
    theta_out: FloatArray
    """[points] degrees, signed; the mirror direction is +theta_in."""
    wavelengths: FloatArray
    """[wavelengths] nm."""
    brdf: FloatArray
    """[points, wavelengths] 1/sr; NaN where there is no value."""
    u: FloatArray
    """[points, wavelengths] combined standard uncertainty (coverage factor 1), 1/sr."""


def get(path: str, model: Any, **query: Any) -> Call[Any]:
    """Read something that is JSON of a `model`."""
    return Call("GET", path, reader(model), query)


def post(path: str, model: Any, body: BaseModel | dict[str, Any] | None = None) -> Call[Any]:
    """Ask for something; the answer is JSON of a `model`."""
    text = body.model_dump_json() if isinstance(body, BaseModel) else None if body is None else json.dumps(body)
    return Call("POST", path, reader(model), content=None if text is None else text.encode())


def reader(model: Any) -> Callable[[httpx.Response], Any]:
    """How an answer is read that is JSON of a `model`."""
    adapter = TypeAdapter(model)
    return lambda response: adapter.validate_json(response.content)


def floats(content: bytes) -> NDArray[np.float64]:
    """Little-endian 64-bit floats."""
    return np.frombuffer(content, dtype="<f8").astype(np.float64)


def two_halves(response: httpx.Response) -> tuple[FloatArray, FloatArray]:
    """Two arrays of one size in octets."""
    first, second = np.split(floats(response.content), 2)
    return first, second


def read_spectra(response: httpx.Response) -> Spectra:
    """All spectra, as `api.views.spectra.packed_spectra` packs them."""
    points, wavelengths = np.frombuffer(response.content[:8], dtype="<u4").tolist()
    sizes = (wavelengths, points, points, points * wavelengths, points * wavelengths)
    at, theta_in, theta_out, brdf, u = np.split(floats(response.content[8:]), np.cumsum(sizes)[:-1])
    shape = points, wavelengths
    return Spectra(theta_in, theta_out, at, brdf.reshape(shape), u.reshape(shape))
