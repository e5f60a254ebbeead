"""The databases that decode a bus log: their files, and the buses that they describe."""

from collections.abc import Iterable, Mapping
from dataclasses import field, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from kennfeld.base.errors import ArgumentError, InputError, Location
from kennfeld.base.file_errors import convert_errors, nearest_file
from kennfeld.base.file_state import while_unchanged
from kennfeld.base.lazy_dataclass import dataclass

if TYPE_CHECKING:
    from kennfeld.measurement.bus_messages import BusDatabase

Network = Literal["CAN", "LIN"]
_KEYS = ("file", "bus", "network")
_EXAMPLE = 'write "engine.dbc", or {"file": "engine.dbc", "bus": 1}'


@dataclass(frozen=True)
class DatabaseFile:
    """A database in DBC format.

    Attributes:
        path: its file.
        bus: the number of the channel that it describes, from 1 on; None for all.
        network: the kind of bus.
        content: its bytes, if the file may be missing where it is used.
    """

    path: Path
    bus: int | None = None
    network: Network = "CAN"
    content: bytes | None = field(default=None, repr=False)

    def describes(self, network: str, bus: int) -> bool:
        """Return whether frames of this bus are described here."""
        return network == self.network and self.bus in (None, bus)

    def loaded(self) -> "DatabaseFile":
        """Return the database with the bytes of its file. Raises `InputError` if it cannot be read."""
        with convert_errors(self.path, "cannot be read"):
            return replace(self, content=self.path.read_bytes())

    def read(self) -> "BusDatabase":
        """Return the content. Raises `InputError` if the file cannot be read or describes no message."""
        if self.content is not None:
            return _parse_once(self.path.name, self.content)
        if not self.path.is_file():
            remedy = nearest_file(self.path) or "Check the path of the CAN database."
            raise InputError.of(Location(str(self.path)), "there is no such file", remedy)
        return _read_once(self.path)


@while_unchanged(16)
def _read_once(path: Path) -> "BusDatabase":
    """Read a file, which many recordings may need."""
    from kennfeld.measurement.dbc import read_database  # most runs read no bus log

    return read_database(path)


@lru_cache(maxsize=16)
def _parse_once(name: str, content: bytes) -> "BusDatabase":
    from kennfeld.measurement.dbc import parse_content

    return parse_content(name, content)


AnyDatabase = str | Path | Mapping[str, str | int] | DatabaseFile


def to_databases(values: AnyDatabase | Iterable[AnyDatabase]) -> tuple[DatabaseFile, ...]:
    """Return the databases that a caller names; an address may end in a bus: `engine.dbc@1`, `body.dbc@LIN`.

    >>> to_databases(["engine.dbc", "body.dbc@LIN2"])[1].bus
    2

    Raises:
        ArgumentError: a value is neither a file nor a mapping with `file`.
    """
    items = [values] if isinstance(values, (str, Path, Mapping, DatabaseFile)) else list(values)
    return tuple(dict.fromkeys(map(_to_database, items)))


def _to_database(value: AnyDatabase) -> DatabaseFile:
    if isinstance(value, DatabaseFile):
        return value
    if isinstance(value, Path):
        return DatabaseFile(value)
    if isinstance(value, str):
        return _of_address(value)
    if not isinstance(value, Mapping) or "file" not in value or set(value) - set(_KEYS):
        raise ArgumentError(f"dbc={value!r} must be a file; {_EXAMPLE}")
    bus, network = value.get("bus"), value.get("network", "CAN")
    if not (bus is None or (isinstance(bus, int) and not isinstance(bus, bool) and bus >= 1)):
        raise ArgumentError(f"dbc={value!r}: bus={bus!r} must be the number of a channel >= 1")
    if network not in ("CAN", "LIN"):
        raise ArgumentError(f'dbc={value!r}: network={network!r} must be "CAN" or "LIN"')
    return DatabaseFile(Path(str(value["file"])), bus, "LIN" if network == "LIN" else "CAN")


def _of_address(address: str) -> DatabaseFile:
    whole, _, suffix = address.rpartition("@")
    number = suffix.upper().removeprefix("CAN").removeprefix("LIN")
    is_bus = int(number) > 0 if number.isdecimal() else suffix.upper() in ("CAN", "LIN")
    # a file may itself be called `engine.dbc@1`
    if not whole or not is_bus or Path(address).exists():
        return DatabaseFile(Path(address))
    network: Network = "LIN" if suffix.upper().startswith("LIN") else "CAN"
    return DatabaseFile(Path(whole), int(number) if number else None, network)
