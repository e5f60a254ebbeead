"""The key `steady` of a `[[dataset]]`."""

import math
from typing import Any

from kennfeld.project.schema import DatasetEntry, SteadyEntry
from kennfeld.project.section import Section

__all__ = ["check_steady", "steady_entries"]

_EXAMPLE = 'Write steady = { channel = "Speed", window = 5.0, tolerance = 10 }.'


def steady_entries(section: Section) -> tuple[SteadyEntry, ...]:
    """The conditions under which a recording is steady: one table, or a list of them."""
    given: Any = section.get("steady")
    if given is None:
        return ()
    tables = [given] if isinstance(given, dict) else given
    if not isinstance(tables, list) or not tables or not all(isinstance(item, dict) for item in tables):
        section.report("steady", "it must be a table, or a list of tables", _EXAMPLE)
        return ()
    made: list[SteadyEntry] = []
    for number, item in enumerate(tables, 1):
        place = f"{section.place} steady" + (f" {number}" if len(tables) > 1 else "")
        entry = _entry(Section(item, place, section.findings))
        if entry.channel in [other.channel for other in made]:
            section.report(f"steady {number}", f"channel {entry.channel} is named twice", "Remove one.")
        made.append(entry)
    return tuple(made)


def _entry(section: Section) -> SteadyEntry:
    for key in ("channel", "window", "tolerance"):
        if not section.has(key):
            section.report(key, "the key is missing", _EXAMPLE)
    entry = SteadyEntry(
        channel=section.text("channel"),
        window=section.number("window", math.inf, 0.0, above=True),
        tolerance=section.number("tolerance", 0.0, 0.0),
    )
    section.end()
    return entry


def check_steady(section: Section, entry: DatasetEntry) -> None:
    """Keys that points made of plateaus have no use for."""
    if not section.has("steady"):
        return
    if section.has("warmup"):
        mend = f'Write where = "t > {entry.warmup:g}", or remove it.'
        section.report("warmup", "warmup is for recordings that a function runs through, steady makes points", mend)
    if entry.unknown_shifts:
        what = "a shift cannot be found on the points that steady makes"
        section.report("shift", what, f"Write {entry.unknown_shifts[0]} = ... in s.")
