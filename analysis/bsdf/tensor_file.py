"""The `tensor_file` container that Mitsuba 3 and PBRT read measured materials from.

Layout, little-endian: the 12 bytes `tensor_file\\0`, version 1.0 as two u8, u32 number of fields; for each
field u16 length of the name, the name, u16 number of dimensions, u8 type code, u64 offset of the data from
the start of the file, one u64 per dimension; then the data in C order. Data starts on multiples of 8 bytes.
Source: the material database format of Dupuy and Jakob, ACM TOG 37, 6 (2018).
"""

import math
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goniometer.errors import InputError

Tensor = NDArray[Any]

MAGIC = b"tensor_file\0"
VERSION = (1, 0)
TYPES: dict[int, str] = {1: "<u1", 10: "<f4"}
"""Type codes of the container that this project writes and reads, as NumPy types."""

_ALIGNMENT = 8


def encode(fields: Mapping[str, Tensor]) -> bytes:
    """The file as bytes; u8 arrays stay u8, every other array is stored as f32. Order of fields is kept."""
    arrays = {
        name: np.ascontiguousarray(array, dtype="<u1" if array.dtype == np.uint8 else "<f4")
        for name, array in fields.items()
    }
    head = sum(2 + len(name.encode()) + 2 + 1 + 8 + 8 * array.ndim for name, array in arrays.items())
    position = len(MAGIC) + 2 + 4 + head
    table, data = [], []
    for name, array in arrays.items():
        padding = -position % _ALIGNMENT
        position += padding
        code = 1 if array.dtype == np.uint8 else 10
        table.append(struct.pack("<H", len(name.encode())) + name.encode())
        table.append(struct.pack(f"<HBQ{array.ndim}Q", array.ndim, code, position, *array.shape))
        data.append(bytes(padding) + array.tobytes())
        position += array.nbytes
    return MAGIC + struct.pack("<BBI", *VERSION, len(arrays)) + b"".join(table) + b"".join(data)


def decode(content: bytes) -> dict[str, Tensor]:
    """The fields of a file, by name.

    Raises `InputError` where the bytes are no such file, are cut short, or hold a type not in `TYPES`.
    """
    if content[: len(MAGIC)] != MAGIC:
        raise InputError("This is not a tensor file: it does not begin with the word tensor_file.")
    try:
        *version, count = struct.unpack_from("<BBI", content, len(MAGIC))
        if tuple(version) != VERSION:
            raise InputError(f"This tensor file has version {version[0]}.{version[1]}; only 1.0 is known.")
        position = len(MAGIC) + 6
        fields = {}
        for _ in range(count):
            (length,) = struct.unpack_from("<H", content, position)
            name = content[position + 2 : position + 2 + length].decode()
            position += 2 + length
            dimensions, code, offset = struct.unpack_from("<HBQ", content, position)
            shape = struct.unpack_from(f"<{dimensions}Q", content, position + 11)
            position += 11 + 8 * dimensions
            if code not in TYPES:
                raise InputError(f"Field {name} of this tensor file has type {code}; only u8 and f32 are known.")
            values = np.frombuffer(content, TYPES[code], math.prod(shape), offset)
            fields[name] = values.reshape(shape)
    except (struct.error, ValueError) as fault:  # ValueError: fewer bytes than the shape promises
        raise InputError(f"This tensor file is cut short or damaged: {fault}.") from fault
    return fields
