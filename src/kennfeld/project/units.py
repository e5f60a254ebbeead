"""Channels of files put into the unit that the function has for them."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace

from kennfeld.dataset import Channel, Dataset
from kennfeld.errors import Finding, nearest
from kennfeld.measurement.conversion import Conversion, compare, says_nothing
from kennfeld.measurement.units import in_seconds, time_unit
from kennfeld.project.schema import ProjectFile

__all__ = ["Units", "check_stated", "restated"]

_Case = tuple[str, str, str, str]  # channel, its unit, the unit it is converted to, and whose that is


@dataclass
class Units:
    """Converts the channels of files, and keeps what was converted.

    `stated` are the units that the project file states, `wanted` the unit of each channel that the function has one
    for, with whose it is: the input Speed. What the function has no unit for follows the first file that has one.
    """

    stated: Mapping[str, str]
    wanted: Mapping[str, tuple[str, str]]
    first: dict[str, tuple[str, str]] = field(default_factory=dict)
    cases: dict[_Case, dict[str, None]] = field(default_factory=dict)

    def converted(self, part: Dataset, name: str) -> Dataset:
        """The recording with its channels converted; `name` is its file's."""
        changed = [self._channel(channel, name) for channel in restated(part, self.stated).channels]
        return replace(part, channels=tuple(changed))

    def _channel(self, channel: Channel, file: str) -> Channel:
        if says_nothing(channel.unit):
            return channel
        unit, whose = self.wanted.get(channel.name) or self.first.setdefault(channel.name, (channel.unit, file))
        found = compare(channel.unit, unit)
        if not isinstance(found, Conversion):
            return channel
        self.cases.setdefault((channel.name, channel.unit, unit, whose), {})[file] = None
        return replace(channel, values=found.of(channel.values), unit=unit)

    def remarks(self, formulas: Collection[str]) -> Iterator[Finding]:
        """What was converted, each case once; `formulas` are the channels that formulas of the project read."""
        for (channel, unit, to, whose), files in self.cases.items():
            names = list(files)
            place = names[0] + (f" and {len(names) - 1} more" if len(names) > 1 else "")
            what = f"channel {channel} is in {unit} and is converted to {to}, the unit of {whose}"
            if channel in formulas:
                what += f"; formulas over {channel} see {to}"
            yield Finding(place, what, severity="remark")


def restated(dataset: Dataset, units: Mapping[str, str]) -> Dataset:
    """The dataset with the units that the project file states; values stay."""
    changed = (replace(c, unit=units[c.name]) for c in dataset.channels if c.name in units)
    return dataset.with_channels(*changed)


def times(stated: Mapping[str, str]) -> dict[str, str]:
    """Return those of the stated units that are units of time, which a column of time may be in.

    >>> times({"Time": "ms", "n": "rpm"})
    {'Time': 'ms'}
    """
    return {name: unit for name, unit in stated.items() if in_seconds(unit) is not None}


def check_stated(
    file: ProjectFile, used: Collection[str], clocks: Collection[str], *, complete: bool
) -> Iterator[Finding]:
    """Units stated for channels that nothing uses, and units of time columns that are none.

    `clocks` are the columns that time was read from; all of them are known only if all data are `complete`.
    """
    for name, unit in file.units.items():
        if name in clocks:
            if in_seconds(unit) is None and name not in used:
                what = f"{unit} is not a unit of time, and {name} is the time"
                yield Finding(file.place(f"[units] {name}"), what, "Write s, ms, us, ns, min or h.")
            continue
        if not complete and time_unit(name, unit) is not None:
            continue
        if name not in used:
            mend = nearest(name, {*used, *clocks}) or "Name a channel of the files or a calculated one."
            yield Finding(file.place(f"[units] {name}"), f"nothing uses a channel {name}", mend)
