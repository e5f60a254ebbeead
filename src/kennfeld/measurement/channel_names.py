"""Names of channels in files with several groups: each channel has names from short to unique, all of which mean it."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Protocol, Self, TypeVar

from kennfeld.base.errors import Finding, Findings, Fix, Location
from kennfeld.base.formatting import join_names, nearest
from kennfeld.measurement.source import MeasurementFile
from kennfeld.measurement.table import Selection

TIME = "time"
_MAX_LISTED = 6  # names in a message
CHANNEL = "channel"  # the key of a fix that names another channel in place of one, wherever it is named


class NamedChannel(Protocol):
    """A channel of a file."""

    @property
    def name(self) -> str:
        """The name under which it is listed or was requested."""

    @property
    def forms(self) -> tuple[str, ...]:
        """The names that may mean it, from short to certain."""

    @property
    def is_array(self) -> bool:
        """True if its elements are channels."""

    def named(self, name: str) -> Self:
        """Return the channel under another name."""


_C = TypeVar("_C", bound=NamedChannel)  # Python 3.11


def unique_forms(candidates: Sequence[tuple[str, ...]]) -> list[str]:
    """Return the first name of each that no other channel, nor the time, has.

    >>> unique_forms([("n", "10ms/n"), ("n", "100ms/n"), ("time", "10ms/time"), ("T", "10ms/T")])
    ['10ms/n', '100ms/n', '10ms/time', 'T']
    """
    names = [forms[0] for forms in candidates]
    for level in range(1, len(candidates[0])):
        count = Counter([*names, TIME])
        names = [c[level] if count[name] > 1 else name for name, c in zip(names, candidates, strict=True)]
    return names


def choose(
    source: MeasurementFile,
    entries: Sequence[_C],
    selection: Selection,
    explain: Callable[[str], str] | None = None,
) -> list[_C]:
    """Return the requested channels, by their name or, for an element of an array, by that of the array.

    With `explain`, a channel that is not there is an error, whose remedy it returns if the names are no help.
    """
    if selection.channels is None:
        return list(entries)
    meanings = _meanings(entries)
    chosen: dict[_C, None] = {}
    findings = Findings()
    for asked in selection.channels:
        arrays = [entry for entry in meanings.get(without_indices(asked), ()) if entry.is_array]
        named = meanings.get(asked, ())
        if len(named) == 1:
            chosen[named[0].named(asked)] = None
        elif len(named) > 1:
            findings.add(several_channels(source.location, asked, [entry.name for entry in named]))
        elif len(arrays) == 1:
            chosen[arrays[0].named(without_indices(asked))] = None
        elif explain is not None:
            names = [entry.name for entry in entries]
            remedy = explain(asked) or nearest(asked, names) or f"It has {join_names(names)}."
            findings.error(source.location, f"has no channel {asked}", remedy)
    findings.finish()
    # if no channel matches, the group that is read lets the message list the available ones
    return list(chosen) or [entries[0]]


def several_channels(location: Location, asked: str, names: Sequence[str]) -> Finding:
    """Return the error that a name means several channels; `names` mean one each."""
    message = f"{len(names)} channels are named {asked}"
    fix = Fix(f"Read {asked} from", (((CHANNEL, asked), ""),), tuple(names))
    return Finding(location, message, f"Name one of them: {', '.join(names[:_MAX_LISTED])}.", fixes=(fix,))


def _meanings(entries: Sequence[_C]) -> dict[str, list[_C]]:
    """Return the channels that each name may mean; the name under which a channel is listed means no other."""
    meanings: dict[str, list[_C]] = {}
    for entry in entries:
        for form in dict.fromkeys(entry.forms):
            meanings.setdefault(form, []).append(entry)
    # later entries win: a listed name before the forms of others, and `time` before all, as it is never a channel
    return meanings | {entry.name: [entry] for entry in entries} | {TIME: []}


def without_indices(name: str) -> str:
    """Return the name of the array of an element, `Map` of `Map[0][1]`."""
    return re.sub(r"(?:\[\d+\])+\Z", "", name)
