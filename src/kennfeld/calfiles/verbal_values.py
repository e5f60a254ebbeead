"""Enumerations and booleans in formats that keep only their words, without saying which of the two they are."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TypeVar

from kennfeld.calfiles.format import Findings
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Parameter, Text, TextKind

__all__ = ["kind_of_words", "of_one_kind", "remark_on_kinds"]

_BOOLEAN = frozenset({"true", "false"})
_Thing = TypeVar("_Thing", bound=Parameter | Text)


def kind_of_words(words: Iterable[str]) -> TextKind:
    """Return the kind of a label that holds these words in its variants.

    >>> kind_of_words(["true"]), kind_of_words(["true", "undefined"])
    ('boolean', 'enumeration')
    """
    return "boolean" if _BOOLEAN.issuperset(words) else "enumeration"


def of_one_kind(things: Mapping[tuple[str, str], _Thing]) -> dict[tuple[str, str], _Thing]:
    """Return the things by name and variant, with the words of a label all of one kind."""
    kinds = _kinds(thing for thing in things.values() if isinstance(thing, Text))
    return {
        key: replace(thing, kind=kinds[thing.name]) if isinstance(thing, Text) and thing.kind != "text" else thing
        for key, thing in things.items()
    }


def remark_on_kinds(parameters: ParameterSet, notes: Findings) -> None:
    """Remark on each enumeration and boolean whose words read back as the other kind."""
    texts = [thing for thing in parameters.everything.values() if isinstance(thing, Text)]
    kinds = _kinds(texts)
    for name, text in {text.name: text for text in texts if text.kind not in ("text", kinds.get(text.name))}.items():
        message = f"is of the kind {text.kind}; {text.text[:40]!r} reads back as {kinds[name]}"
        notes.remark(0, name, message, "Write it as .cdfx or .json to keep the kind.")


def _kinds(texts: Iterable[Text]) -> dict[str, TextKind]:
    words: dict[str, list[str]] = {}
    for text in texts:
        if text.kind != "text":
            words.setdefault(text.name, []).append(text.text)
    return {name: kind_of_words(given) for name, given in words.items()}
