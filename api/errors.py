"""What the service refuses, beside what the floors below refuse.

GoniometerError
└── ServiceError
    ├── Conflict        what is asked for is not possible now; the message says why and what is possible
    │   └── BenchEnded  the process that drives the bench has ended, so that nobody does what was asked
    ├── Unauthorised    nobody knows who asks
    ├── NotAllowed      who asks may not do this
    ├── Outdated        it was changed since it was read
    ├── TooLarge        more was sent than is read
    ├── Misdirected     whoever asks calls the service by a name that it does not have
    ├── TooManyFailures logins failed, so that the next must wait
    └── ClusterError    the machines to which work was sent do not do it
        └── VersionsDiffer  a worker there runs other software than this program

Every message is one sentence that says what is wrong, where, and what would be right.
"""

from goniometer.errors import GoniometerError


class ServiceError(GoniometerError):
    """Base of what only the service refuses."""


class Conflict(ServiceError):
    """Not possible in the state in which the bench, the queue or a job is now."""


class BenchEnded(Conflict):
    """The process that drives the bench has ended, so that nobody does what was asked; it is started anew."""


class Unauthorised(ServiceError):
    """Nobody knows who asks."""


class NotAllowed(ServiceError):
    """Who asks may not do this."""


class Outdated(ServiceError):
    """It was changed since whoever wants to change it has read it."""


class TooLarge(ServiceError):
    """More was sent than is read."""


class Misdirected(ServiceError):
    """Whoever asks calls the service by a name that it does not have."""


class TooManyFailures(ServiceError):
    """Logins failed so often that the next must wait for `seconds`."""

    def __init__(self, message: str, seconds: float) -> None:
        super().__init__(message)
        self.seconds = seconds


class ClusterError(ServiceError):
    """A cluster does not answer, does not fit this program, or does not do its work."""


class VersionsDiffer(ClusterError):
    """A worker runs other software than this program."""
