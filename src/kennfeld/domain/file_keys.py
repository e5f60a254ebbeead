"""Declares keys of a project file as fields of dataclasses, with all that reading and writing them needs."""

from collections.abc import Callable, Mapping
from dataclasses import MISSING, field
from typing import Any

# key, message and remedy, and the keys that solve it with their values; the key is empty for the whole section
KeyProblem = tuple[str, str, str] | tuple[str, str, str, Mapping[str, Any]]


def key(
    meaning: str, default: Any = MISSING, *, factory: Callable[[], Any] | None = None, name: str = "", **metadata: Any
) -> Any:
    """Return a field that is a key of a section.

    Args:
        meaning: what the key sets, as the documentation describes it (Markdown).
        default: the value if the key is missing; without default and factory the key is required.
        factory: returns a mutable default.
        name: the key in the file, if it differs from the field.
        metadata: `least`, `above` and `most` bound a number, `unit` is its unit; `form` reads and writes a value that
            its annotation does not describe; `missing` is the remedy for a required key that is missing;
            `default_text` describes the default, if a value cannot. `holds` names what texts are: "channel", "node",
            "condition", "formula" and so on; `by` names what the keys of a table are.

    >>> from dataclasses import dataclass, fields
    >>> @dataclass
    ... class Weighting:
    ...     weight: float = key("factor on the squared errors", 1.0, least=0)
    >>> fields(Weighting)[0].metadata["least"], Weighting().weight
    (0, 1.0)
    """
    description = {"meaning": meaning, "name": name, **metadata}
    if factory is not None:
        return field(default_factory=factory, metadata=description)
    return field(default=default, metadata=description)
