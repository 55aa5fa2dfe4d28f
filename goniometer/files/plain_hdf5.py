"""Arrays and texts of an HDF5 file that somebody else may have made.

The format can do far more than hold arrays. A link may lead into another file, an array may be kept in one, and a few
kilobytes may unpack to more than any computer holds: by a size that is merely stated, by pieces that are larger than
the array, by more pieces than values, by texts that all name the same place. What is read here must be plain, is
checked before it is unpacked, and is counted.
"""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.arrays import FloatArray
from goniometer.errors import DataFileError
from goniometer.files.dataset_document import LARGEST_ARRAYS

if TYPE_CHECKING:
    from h5py import Dataset, Group

_MOST_TEXTS = 1000
"""Of one array."""
_LARGEST_PIECE = 1 << 20
"""Bytes of a piece of an array, unpacked; h5py makes no larger ones. Deflated, one is a thousandth of it at least."""
_NAMED = 16
"""Bytes by which an array names a text that stands elsewhere in the file."""
_MOST_PIECES = 200_000
"""Of an array; h5py makes pieces of 8 KiB or more."""
_LISTED = 100
"""Bytes of a number in a list of Python."""


class PlainHdf5:
    """Reads arrays and texts below one group of a file, and counts how much that was.

    Raises `DataFileError` for what is missing, is not what it should be, is kept elsewhere, or is too much; the library
    raises errors of many kinds for damaged files.
    """

    def __init__(self, where: str, entry: "Group") -> None:
        self.where = where
        """Names the file in messages."""
        self.entry = entry
        self._left = LARGEST_ARRAYS

    def _at(self, path: str) -> Any:
        found: Any = self.entry
        for name in path.split("/"):
            if not is_plain(self.where, found, name):
                raise DataFileError(f"{self.where}: has no {self.entry.name}/{path}; export it again.")
            found = found[name]
        return found

    def _count(self, octets: int) -> None:
        self._left -= octets
        if self._left < 0:
            raise DataFileError(
                f"{self.where}: its arrays are larger than {LARGEST_ARRAYS / 1e9:g} GB, which is more than is read at "
                f"once; leave out wavelengths, or split it by incident angles."
            )

    def group(self, path: str) -> Any:
        """The group at a path."""
        found = self._at(path)
        if not hasattr(found, "keys"):
            raise DataFileError(f"{self.where}: {found.name} is no group; export it again.")
        return found

    def has(self, path: str, name: str) -> bool:
        """Whether the group at a path has the entry."""
        return is_plain(self.where, self.group(path), name)

    def attribute(self, path: str, name: str) -> Any:
        """A single value that stands beside a group; an empty path is the entry itself. Raises `KeyError`."""
        attributes = (self.group(path) if path else self.entry).attrs
        if attributes.get_id(name).shape != ():
            raise DataFileError(f"{self.where}: {path} has a list as its {name}; export it again.")
        value = attributes[name]
        self._count(len(value) if isinstance(value, str | bytes) else value.nbytes)
        return value

    def numbers(self, path: str) -> FloatArray:
        """The array at a path as numbers."""
        found = self._array(path)
        if found.dtype.kind not in "fiu":
            raise DataFileError(f"{self.where}: {found.name} are no numbers; export it again.")
        self._count(found.size * max(found.dtype.itemsize, 8))
        self._check_pieces(found)
        return np.asarray(found[()], dtype=float)

    def integers(self, path: str) -> list[int]:
        """The numbers at a path as a list."""
        self._count(_LISTED * self._array(path).size)
        return [int(number) for number in self.numbers(path).ravel().tolist()]

    def texts(self, path: str) -> list[str]:
        """The texts at a path."""
        import h5py  # noqa: PLC0415  (is only needed here)

        found = self._array(path)
        if h5py.check_string_dtype(found.dtype) is None or found.size > _MOST_TEXTS or found.ndim > 1:
            raise DataFileError(
                f"{self.where}: cannot be read as HDF5 of a dataset ({found.name} is no list of at most {_MOST_TEXTS} "
                f"texts); export it again."
            )
        self._count(found.size * found.dtype.itemsize)
        self._check_pieces(found)
        texts = []
        for place in [()] if found.ndim == 0 else range(found.size):
            texts.append(bytes(found[place]))  # one by one, for all may name the same place in the file
            self._count(len(texts[-1]))
        return [each.decode() for each in texts]

    def _array(self, path: str) -> "Dataset":
        found = self._at(path)
        if not hasattr(found, "size"):
            raise DataFileError(f"{self.where}: {found.name} is no array; export it again.")
        if found.external or found.is_virtual:
            raise DataFileError(f"{self.where}: {found.name} is kept elsewhere; copy the data into the file.")
        array: Dataset = found
        return array

    def _check_pieces(self, found: "Dataset") -> None:
        """Raise `DataFileError` for an array that is not packed as h5py packs it by itself."""
        import h5py  # noqa: PLC0415  (is only needed here)

        if found.chunks is None:
            return
        made = found.id.get_create_plist()
        filters = {made.get_filter(i)[0] for i in range(made.get_nfilters())}
        pieces = math.prod(-(-length // piece) for length, piece in zip(found.shape, found.chunks, strict=True))
        size = math.prod(found.chunks) * max(found.dtype.itemsize, _NAMED)
        if (
            filters - {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
            or size > _LARGEST_PIECE
            or pieces > _MOST_PIECES
        ):
            raise DataFileError(
                f"{self.where}: {found.name} is packed in another way than by gzip in pieces of at most 1 MiB; export "
                f"it again."
            )
        most = size + size // 100 + 100  # what does not become smaller is deflated to hardly more
        if found.id.chunk_iter(lambda stored: stored.size > most or None):
            raise DataFileError(f"{self.where}: {found.name} has a piece that is larger than it should be.")


def is_plain(where: str, group: "Group", name: str) -> bool:
    """Whether the group has the entry; raises `DataFileError` where it is no part of the file itself."""
    import h5py  # noqa: PLC0415  (is only needed here)

    link = group.get(name, getlink=True)
    if link is not None and not isinstance(link, h5py.HardLink):
        raise DataFileError(f"{where}: {group.name}/{name} is a link to elsewhere; copy the data into the file.")
    return link is not None
