"""Commands of the command line that the log tells of."""

import getpass
import os
from pathlib import Path
from typing import Any

from typer import Exit
from typer.core import TyperCommand

from analysis.errors import AnalysisError
from drivers.errors import DriverError
from goniometer.errors import GoniometerError, StoreError


class Logged(TyperCommand):
    """A command that changes something in its --database: logged with its arguments and how it ended.

    What was refused as bad input has done nothing, and neither has what the database itself refused. A command may put
    more to be logged into the dictionary `context.meta`, under keys that begin with "log ".
    """

    def invoke(self, ctx: Any) -> Any:
        """Run the command and log it."""
        outcome: str | None = "stopped"
        try:
            result = super().invoke(ctx)
            outcome = "done"
            return result
        except (Exit, SystemExit) as error:
            code = error.exit_code if isinstance(error, Exit) else error.code
            outcome = "failed" if code else "done"
            raise
        except StoreError:
            outcome = None
            raise
        except (GoniometerError, AnalysisError) as error:
            outcome = None if error.exit_code == 2 else str(error)
            raise
        except DriverError as error:
            outcome = str(error)
            raise
        finally:
            if outcome is not None:
                _log(ctx, outcome)


def _log(context: Any, outcome: str) -> None:
    from api.access.audit import record
    from goniometer.storage.store import Store

    database = context.params.get("database")
    if database is None or not ("://" in str(database) or Path(database).exists()):
        return
    about = {key: _shown(value) for key, value in context.params.items() if _is_said(value)}
    about |= {key.removeprefix("log "): value for key, value in context.meta.items() if key.startswith("log ")}
    for key in ("database", "as_json"):
        about.pop(key, None)
    store = Store.open(database)
    try:
        action = " ".join(context.command_path.split()[1:])
        record(store, account(), action, about | {"outcome": outcome}, "cli")
    finally:
        store.close()


def account() -> str:
    """Name of the machine's account in which this process runs."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # in a container it may have a number only
        return str(os.getuid())


def _is_said(value: object) -> bool:
    """Whether it is something: 0 is, an empty list and a switch that is off are not."""
    return value is not None and value is not False and not (isinstance(value, list | tuple) and not value)


def _shown(value: object) -> object:
    if isinstance(value, list | tuple):
        return [_shown(each) for each in value]
    return value if type(value) in {int, float, str, bool} else str(value)
