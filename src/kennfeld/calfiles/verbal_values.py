"""Enumerations and booleans in formats that store only their texts and do not distinguish the two."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TypeVar

from kennfeld.calfiles.format import FileFindings
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.texts import Text, TextKind

_BOOLEAN = frozenset({"true", "false"})
_Item = TypeVar("_Item", bound=Parameter | Text)


def kind_of_words(words: Iterable[str]) -> TextKind:
    """Return the kind of a label that holds these words in its variants.

    >>> kind_of_words(["true"]), kind_of_words(["true", "undefined"])
    ('boolean', 'enumeration')
    """
    return "boolean" if _BOOLEAN.issuperset(words) else "enumeration"


def unify_text_kinds(items: Mapping[tuple[str, str], _Item]) -> dict[tuple[str, str], _Item]:
    """Return the items by name and variant, with all texts of a label of one kind."""
    kinds = _kinds_by_name(item for item in items.values() if isinstance(item, Text))
    return {
        key: replace(item, kind=kinds[item.name]) if isinstance(item, Text) and item.kind != "text" else item
        for key, item in items.items()
    }


def warn_about_kinds(parameters: ParameterSet, findings: FileFindings) -> None:
    """Warn about each enumeration or boolean that reads back as the other kind."""
    texts = [item for item in parameters.everything.values() if isinstance(item, Text)]
    kinds = _kinds_by_name(texts)
    for name, text in {text.name: text for text in texts if text.kind not in ("text", kinds.get(text.name))}.items():
        message = f"is of kind {text.kind}, but {text.text[:40]!r} reads back as {kinds[name]}"
        findings.warning(0, name, message, "Write it as .cdfx or .json to keep the kind.")


def _kinds_by_name(texts: Iterable[Text]) -> dict[str, TextKind]:
    words: dict[str, list[str]] = {}
    for text in texts:
        if text.kind != "text":
            words.setdefault(text.name, []).append(text.text)
    return {name: kind_of_words(spellings) for name, spellings in words.items()}
