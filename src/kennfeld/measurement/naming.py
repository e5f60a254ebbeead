"""Names for channels that a file calls the same."""

from collections.abc import Sequence

__all__ = ["distinct"]


def distinct(names: Sequence[str]) -> list[str]:
    """The names, each once: the second `Speed` becomes `Speed (2)`; empty ones stay empty.

    >>> distinct(["Speed", "Torque", "Speed", "", ""])
    ['Speed', 'Torque', 'Speed (2)', '', '']
    """
    taken = set(names)
    seen: set[str] = set()
    last: dict[str, int] = {}
    found = []
    for name in names:
        free, k = name, last.get(name, 1)
        while name and (free in seen or (free != name and free in taken)):
            k += 1
            free = f"{name} ({k})"
        last[name] = k
        seen.add(free)
        found.append(free)
    return found
