"""What can go wrong with a measurement.

GoniometerError
├── InputError            what the user gave cannot be right (exit code 2)
│   ├── CampaignError     a campaign file
│   ├── ConfigurationError  an instrument file
│   ├── GeometryError     an angle that the bench cannot take
│   ├── DataFileError     a file of measured data
│   ├── OptionError       something that must be said, or has no use; each face calls it by its own name
│   └── CertificateError  a reference certificate
├── StoreError            the database
│   ├── StoreBusy         another process is running on it
│   ├── StoreFull         no room left on the disk, or it takes nothing there
│   ├── RawDamaged        a raw exposure is not as it was written
│   ├── ArchiveMissing    a file of archived counts is not where it was written
│   ├── StoreOutdated     its tables are those of an older version of this program
│   └── NotInStore        what was asked for is not there (exit code 2)
├── ConditionsUnmet       what must hold before a scan did not in time
├── ReferenceIncomplete   points of the reference scan that failed
├── CalibrationError      raw data that cannot be calibrated
├── CharacterisationError what was to be measured of the bench itself does not show
├── BenchUnfit            a device that the doctor would fail
└── RunAborted            the operator ended the run

Every message is one sentence that says what is wrong, where, and what would be right.
"""

_LONGEST = 1500
"""Characters of a message."""


class GoniometerError(Exception):
    """Base of everything that this floor raises."""

    exit_code = 1


class InputError(GoniometerError):
    """What the user gave cannot be right.

    What is quoted of it stays on one line, with control characters as escapes, and of a line without end the middle is
    left out.
    """

    exit_code = 2

    def __init__(self, message: str) -> None:
        if len(message) > _LONGEST:
            message = f"{message[: _LONGEST // 2]} ... {message[-_LONGEST // 2 :]}"
        super().__init__("".join(c if c.isprintable() else ascii(c)[1:-1] for c in message))


class CampaignError(InputError):
    """A campaign file that cannot be run."""


class ConfigurationError(InputError):
    """An instrument file that cannot be used."""


class GeometryError(InputError):
    """An angle that the bench cannot take."""


class DataFileError(InputError):
    """A file of data measured elsewhere that cannot be imported."""


class OptionError(InputError):
    """Something that must be said, or has no use.

    `message` names it in braces, as "{dark_subtracted}", by the names of `fields`. As text, it names the options of the
    command line, which `called` has where they are not called as the field; `by_field` is for who sends JSON.
    """

    def __init__(self, message: str, *fields: str, **called: str) -> None:
        super().__init__(_named(message, {name: f"--{name.replace('_', '-')}" for name in fields} | called))
        self.by_field = str(InputError(_named(message, {name: name for name in (*fields, *called)})))


def _named(message: str, names: dict[str, str]) -> str:
    for field, name in names.items():
        message = message.replace(f"{{{field}}}", name)
    return message


class CertificateError(InputError):
    """A reference certificate that cannot be used."""


class StoreError(GoniometerError):
    """The database refuses."""


class StoreBusy(StoreError):
    """Another process is running on this database."""


class StoreFull(StoreError):
    """There is no room left on the disk, or it takes nothing at that place."""


class StoreOutdated(StoreError):
    """The tables are those of an older version of this program; they can be upgraded."""


class RawDamaged(StoreError):
    """The raw exposure `exposure_id` is not as it was written."""

    def __init__(self, exposure_id: int) -> None:
        super().__init__(
            f"Exposure {exposure_id} is not as it was written: the database was damaged or changed from outside; "
            f"restore it from a backup (goniometer db restore), and see with goniometer db check what else is wrong"
        )
        self.exposure_id = exposure_id


class ArchiveMissing(StoreError):
    """The file `path` with the counts of a scan is not where it was written, or is not that file."""

    def __init__(self, scan_id: int, path: str, why: str) -> None:
        super().__init__(
            f"The raw counts of scan {scan_id} are archived in {path}, {why}; put the file back there, or say where it "
            f"is now: goniometer db archive --scan {scan_id} --to FOLDER"
        )
        self.path = path


class NotInStore(StoreError):
    """What was asked for is not in the database."""

    exit_code = 2


class ConditionsUnmet(GoniometerError):
    """What a campaign asks for before a scan did not hold in time."""


class ReferenceIncomplete(GoniometerError):
    """Points of the reference scan failed, and every sample needs them."""


class CalibrationError(GoniometerError):
    """Raw data that cannot be calibrated."""


class CharacterisationError(GoniometerError):
    """What was to be measured of the bench itself does not show in what was read."""


class BenchUnfit(GoniometerError):
    """Devices are in a state in which nothing should be measured; `lines` says for each what is wrong."""

    def __init__(self, lines: list[str]) -> None:
        super().__init__("The bench is not fit to measure: " + " | ".join(lines))
        self.lines = lines


class RunAborted(GoniometerError):
    """The operator ended the run."""
