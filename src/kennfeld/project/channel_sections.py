"""`[channels]` and `[calculated]`, which may also be written `[channels.calculated]`."""

from kennfeld.project.section import Section

__all__ = ["channel_tables"]

_INNER = "calculated"


def channel_tables(root: Section) -> tuple[dict[str, str], dict[str, str]]:
    """The channels of inputs and the formulas of calculated channels, each by name.

    >>> found = []
    >>> text = {"channels": {"Speed": "n", "calculated": {"n": "omega * 30 / pi"}}}
    >>> channel_tables(Section(text, "kennfeld.toml", found)), found
    (({'Speed': 'n'}, {'n': 'omega * 30 / pi'}), [])
    """
    calculated = root.text_table("calculated")
    section = root.section("channels")
    if section is None:
        return {}, calculated
    inner = section.inner(_INNER) if isinstance(section.values.get(_INNER), dict) else None  # a text is a channel
    names = [name for name in section.values if inner is None or name != _INNER]
    channels = {name: text for name in names if (text := section.text(name))}
    return channels, calculated if inner is None else _both(calculated, inner)


def _both(calculated: dict[str, str], inner: Section) -> dict[str, str]:
    """The formulas of both tables; the same name in both is reported."""
    more = {name: text for name in inner.values if (text := inner.text(name))}
    for name in more:
        if name in calculated:
            inner.report(name, "the channel stands in [calculated] too", "Remove one.")
    return more | calculated
