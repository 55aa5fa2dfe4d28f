"""The container of .bsdf files."""

import struct

import numpy as np
import pytest

from analysis.bsdf.tensor_file import decode, encode
from goniometer.errors import InputError


def test_another_reader_of_the_container_finds_every_field() -> None:
    content = encode({"flag": np.ones(1, np.uint8), "values": np.arange(6.0).reshape(2, 3)})
    assert content[:18] == b"tensor_file\0\x01\x00" + struct.pack("<I", 2)
    name, shape_at = content.index(b"values"), content.index(b"values") + 6
    assert struct.unpack_from("<H", content, name - 2) == (6,)
    dimensions, dtype, offset, rows, columns = struct.unpack_from("<HBQQQ", content, shape_at)
    assert (dimensions, dtype, rows, columns) == (2, 10, 2, 3)
    assert offset % 8 == 0
    assert struct.unpack_from("<6f", content, offset) == (0, 1, 2, 3, 4, 5)
    np.testing.assert_array_equal(decode(content)["values"], [[0, 1, 2], [3, 4, 5]])


@pytest.mark.parametrize("damage", [slice(0, 8), slice(0, 40), slice(0, -4), slice(3, None)])
def test_a_damaged_file_is_refused_in_one_sentence(damage: slice) -> None:
    content = encode({"values": np.arange(6.0)})
    with pytest.raises(InputError, match="tensor file"):
        decode(content[damage])
