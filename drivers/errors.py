"""What can go wrong between this computer and a device.

DriverError
├── DeviceNotFound        nothing answers at the configured address
├── DeviceDisconnected    it answered before and is gone now
├── DeviceTimeout         it did not answer, or did not finish, in time
├── ProtocolError         it answered something malformed, or to another request
├── DeviceRefused         it understood and said no
└── DeviceFault           it reports a fault of its own

Every message is one sentence that names the device, says what is wrong and what would be right.
"""


class DriverError(Exception):
    """Base of everything that a driver raises."""


class DeviceNotFound(DriverError):
    """Nothing answers at the configured address."""


class DeviceDisconnected(DriverError):
    """The device answered before and is gone now."""


class DeviceTimeout(DriverError):
    """The device did not answer, or did not finish, in time."""


class ProtocolError(DriverError):
    """The answer is malformed or belongs to another request."""


class DeviceRefused(DriverError):
    """The device understood the request and refused it."""


class DeviceFault(DriverError):
    """The device reports a fault of its own."""
