r"""Truth tables of Stateflow charts, as flow charts in C or as code in MATLAB.

The file stores two arrays of texts, column by column: `100 C2x4{T"",T"",T"x > 1",T"Actions",T"T",T"1",T"F",T"2"}`, or
`<Array PropName="predicateArray" Type="Cell" Dimension="2*4">` with a `<Cell>` for each text. A row of the first one is
a condition: its description, its code, and T, F or - for each decision; the last row names the actions of the
decisions. A row of the second one is an action: its description and its code.

All conditions are evaluated first. Then the first decision whose entries agree with them runs its actions.
"""

import re
from collections.abc import Iterator, Sequence
from typing import Final

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.reader.model_tree import StoredData, StoredJunction, StoredState, StoredTransition
from kennfeld.importers.simulink.reader.section_tree import SectionNode

_ARRAY: Final = re.compile(r"\s*\d+\s+C(\d{1,4})x(\d{1,4})\s*\{(.*)\}\s*\Z", re.DOTALL)
_SIZE: Final = re.compile(r"(\d{1,4})\*(\d{1,4})\Z")
_TEXT: Final = re.compile(r'T"((?:[^"\\]|\\.|"")*)"', re.DOTALL)
# WARM: the label of a condition or an action; := is an assignment
_LABEL: Final = re.compile(r"\s*([A-Za-z]\w*)\s*:(?!=)\s*(.*)\Z", re.DOTALL)
_COMMENT_LINE: Final = re.compile(r"^[ \t]*(?:%|//)[^\n]*\n|/\*.*?\*/", re.MULTILINE | re.DOTALL)
_SEPARATOR: Final = re.compile(r"[,;\s]+")
_ANY: Final = ("-", "")
_CONDITION: Final = "aVarTruthTableCondition_"  # as Stateflow names the variables of the flow chart that it stores
_FIRST, _LAST = "INIT", "FINAL"  # labels of actions that run before the conditions, and after the decisions


@dataclass(frozen=True, slots=True)
class TruthTable:
    """A truth table: conditions, decisions (an entry "T", "F" or "-" for each condition, and actions), actions."""

    conditions: tuple[str, ...]
    decisions: tuple[tuple[tuple[str, ...], tuple[int, ...]], ...]
    actions: tuple[tuple[str, str], ...]  # label and code
    is_matlab: bool


@dataclass(frozen=True, slots=True)
class TableFlow:
    """The flow chart of a truth table."""

    junctions: tuple[StoredJunction, ...]
    transitions: tuple[StoredTransition, ...]
    data: tuple[StoredData, ...]


def read_truth_table(section: SectionNode) -> TruthTable | None:
    """Read the truth table of a state; None if it has none, or an array that does not match its size or its entries."""
    table, code = section.first("truthTable"), section.first("eml")
    if table is None or table.get("isTruthTable") != "1":
        return None
    rows, listed = (_rows(table, name) for name in ("predicateArray", "actionArray"))
    if not rows or any(len(row) < 2 for row in listed):
        return None
    # columns: description, condition, then one for each decision, whose actions are in the last row
    *conditions, last = rows
    actions = tuple(_labelled(row[1]) for row in listed)
    decisions = []
    for column in range(2, len(last)):
        entries = tuple(row[column].strip().upper() for row in conditions)
        numbers = _action_numbers(last[column], [label for label, _ in actions])
        if numbers is None or any(entry not in ("T", "F", *_ANY) for entry in entries):
            return None
        decisions.append((entries, numbers))
    is_matlab = table.get("useEML") == "1" or (code is not None and code.get("isEML") == "1")
    return TruthTable(tuple(_labelled(row[1])[1] for row in conditions), tuple(decisions), actions, is_matlab)


def _rows(table: SectionNode, name: str) -> list[tuple[str, ...]]:
    """Return the rows of an array of texts, none if it cannot be read."""
    array = next((part for part in table.all("Array") if part.keys.get("PropName") == name), None)
    match = _ARRAY.match(table.get(name)) if array is None else _SIZE.match(array.keys.get("Dimension", ""))
    if match is None:
        return []
    height, width = int(match[1]), int(match[2])
    if array is not None:
        texts = [cell.text for cell in array.all("Cell")]
    else:
        texts = [text.replace('""', '"') for text in _TEXT.findall(match[3])]
    if len(texts) != height * width:
        return []
    return [tuple(texts[row::height]) for row in range(height)]


def _labelled(text: str) -> tuple[str, str]:
    """Return the label of a condition or an action, and its code without the comments before it."""
    code = _COMMENT_LINE.sub("", text).strip()
    match = _LABEL.match(code)
    return (match[1], _COMMENT_LINE.sub("", match[2]).strip()) if match else ("", code)


def _action_numbers(written: str, labels: Sequence[str]) -> tuple[int, ...] | None:
    """Return the actions, counted from 0, that a decision names by numbers or labels; None if one is unknown."""
    numbers = []
    for word in _SEPARATOR.split(written.strip()):
        number = int(word) - 1 if word.isdecimal() and len(word) < 6 else None
        number = labels.index(word) if number is None and word in labels else number
        if word and (number is None or not 0 <= number < len(labels)):
            return None
        if number is not None:
            numbers.append(number)
    return tuple(numbers)


def _variable(at: int) -> str:
    return f"{_CONDITION}{at + 1}"


def _rule(entries: Sequence[str], negation: str) -> str:
    """Return the condition of a decision, "" if it always holds."""
    stated = [(at, entry) for at, entry in enumerate(entries) if entry not in _ANY]
    return " && ".join(f"{'' if entry == 'T' else negation}{_variable(at)}" for at, entry in stated)


def is_generated(section: SectionNode) -> bool:
    """Return True for a part of the flow chart that Stateflow has made of a truth table."""
    return section.kind in ("junction", "transition") or section.keys.get("name", "").startswith(_CONDITION)


def _special(table: TruthTable, label: str) -> str:
    return "\n".join(code for name, code in table.actions if name == label)


def table_script(table: TruthTable, state: StoredState) -> str:
    """Return the function in MATLAB that does what a truth table says."""
    return "\n".join([f"function {state.label.strip()}", *_script_lines(table), "end"])


def _script_lines(table: TruthTable) -> Iterator[str]:
    yield _special(table, _FIRST)
    for at, condition in enumerate(table.conditions):
        yield f"{_variable(at)} = {condition}"
    word = "if"
    for entries, numbers in table.decisions:
        yield f"{word} {_rule(entries, '~') or 'true'}"
        yield from (table.actions[number][1] for number in numbers)
        word = "elseif"
    if table.decisions:
        yield "end"
    yield _special(table, _LAST)


def table_flow(table: TruthTable, state: StoredState) -> TableFlow:
    """Return the flow chart in C that does what a truth table says."""
    names = [f"{state.id} row {at}" for at in range(len(table.decisions) + 3)]
    start, *rows, last, end = names
    # all conditions are evaluated before the first decision; the line break ends a comment behind one
    conditions = "\n".join(f"{_variable(at)} = {code}\n;" for at, code in enumerate(table.conditions))
    edges = [
        ("", start, f"{{{_special(table, _FIRST)}}}", 1),
        (start, rows[0] if rows else last, f"{{{conditions}}}", 1),
    ]
    for at, (entries, numbers) in enumerate(table.decisions):
        actions = "\n".join(table.actions[number][1] for number in numbers)
        rule = _rule(entries, "!")
        edges.append((rows[at], last, f"[{rule}]{{{actions}}}" if rule else f"{{{actions}}}", 1))
        if rule:
            edges.append((rows[at], rows[at + 1] if at + 1 < len(rows) else last, "", 2))
    edges.append((last, end, f"{{{_special(table, _LAST)}}}", 1))
    return TableFlow(
        tuple(StoredJunction(name, parent=state.id) for name in names),
        tuple(
            StoredTransition(f"{state.id} edge {at}", label, source, target, order, state.id)
            for at, (source, target, label, order) in enumerate(edges)
        ),
        tuple(
            StoredData(_variable(at), "TEMPORARY_DATA", type="boolean", parent=state.id)
            for at in range(len(table.conditions))
        ),
    )
