"""The errors of all floors by their names, as a service, or the process that drives its bench, tells them.

Name and message are all that is told. What is made of more, as `RawDamaged` of the number of its exposure, is told as
the nearest of its bases that is made of its message alone, here `StoreError`.
"""

import re

import analysis.errors
import api.errors
import drivers.errors
import goniometer.errors
import simulators.errors

_TREES = (drivers.errors, goniometer.errors, analysis.errors, simulators.errors, api.errors)


def error_named(name: str, message: str) -> Exception | None:
    """The error of a name, in which neither hyphens nor capitals count; None where no floor has one of that name.

    >>> error_named("NotInStore", "There is no scan 7."), error_named("raw-damaged", "Exposure 7 is not as it was.")
    (NotInStore('There is no scan 7.'), StoreError('Exposure 7 is not as it was.'))
    """
    kind = _KNOWN.get(name.replace("-", "").lower())
    return None if kind is None else kind(message)


def name_of(kind: type[Exception]) -> str:
    """What a problem or a job calls a kind of error for programs.

    >>> name_of(goniometer.errors.NotInStore)
    'not-in-store'
    """
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", kind.__name__).lower()


def _told_as(known: type[Exception]) -> type[Exception]:
    """The nearest base of `known`, itself included, that is made of its message alone; `Exception` is."""
    alone = {Exception.__init__, goniometer.errors.InputError.__init__}
    return next(base for base in known.__mro__ if issubclass(base, Exception) and base.__init__ in alone)


_KNOWN: dict[str, type[Exception]] = {
    name.lower(): _told_as(known)
    for tree in _TREES
    for name, known in vars(tree).items()
    if isinstance(known, type) and issubclass(known, Exception)
}
