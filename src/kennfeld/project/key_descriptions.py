"""Describes sections, keys and their forms as plain data, from which tables of the documentation and fields are built.

The kind of a form says which field edits it. A form without a field of its own is edited as TOML text.
"""

from dataclasses import Field
from functools import singledispatch
from typing import Any

from kennfeld.files.calibrations import IMAGE_ENDINGS
from kennfeld.project.document import format_toml
from kennfeld.project.forms import (
    ChoiceForm,
    EitherForm,
    EntriesForm,
    EntryForm,
    FilesForm,
    FlagForm,
    Form,
    IntegerForm,
    NamedEntriesForm,
    NumberForm,
    TableOfForm,
    TextForm,
    TextsForm,
    default_of,
    form_of,
    is_required,
    keys_of,
    without_links,
)
from kennfeld.project.schema import ProjectFile
from kennfeld.project.value_forms import (
    AXIS_RANGE,
    DIRECTIONS,
    FREE,
    Around,
    ArrayForm,
    BoundsForm,
    BreakpointsForm,
    CoordinatesForm,
    FormatsForm,
    LockForm,
    PairForm,
    StepCriteriaForm,
    TargetForm,
)

Description = dict[str, Any]


def describe_sections(file: type = ProjectFile) -> list[Description]:
    """Return name, heading, help and form of each section of a project file, in the documented order."""
    return [
        {**describe_key(name, part), "heading": heading_of(name, form_of(part))} for name, part in keys_of(file).items()
    ]


def heading_of(name: str, form: Form) -> str:
    """Return the heading of a section as the file has it."""
    if isinstance(form, EntriesForm):
        return f"[[{name}]]"
    return f"[{name}.NAME]" if isinstance(form, NamedEntriesForm) else f"[{name}]"


def describe_key(name: str, part: Field[Any]) -> Description:
    """Return name, help, type, default, unit and form of a key, and what its texts and names are."""
    return {
        "name": name,
        "help": plain_text(part.metadata["meaning"]),
        "type": plain_text(form_of(part).label),
        "default": "" if is_required(part) else plain_text(default_text(part)),
        "required": "missing" in part.metadata,
        "unit": part.metadata.get("unit", ""),
        "holds": part.metadata.get("holds", ""),
        "by": part.metadata.get("by", ""),
        "form": describe_form(form_of(part)),
    }


def default_text(part: Field[Any]) -> str:
    """Return the default of a key as the documentation shows it (Markdown)."""
    if "default_text" in part.metadata or is_required(part):
        return str(part.metadata.get("default_text", "required"))
    default = default_of(part)
    if isinstance(default, int | float) and not isinstance(default, bool):
        return f"{default:g}"
    return f"`{format_toml(default)}`" if default or default is False else ""


def plain_text(markdown: str) -> str:
    """Return Markdown without links and code marks.

    >>> plain_text('`"huber"`, see [losses](method.md#losses)')
    '"huber", see losses'
    """
    return without_links(markdown).replace("`", "")


@singledispatch
def describe_form(form: Form) -> Description:
    """Return the kind of a form, and what its field needs."""
    return {"kind": "toml"}


@describe_form.register
def _(form: TextForm) -> Description:
    return {"kind": "text"}


@describe_form.register
def _(form: NumberForm) -> Description:
    return {"kind": "number", "least": form.least, "above": form.above, "words": list(form.words)}


@describe_form.register
def _(form: IntegerForm) -> Description:
    return {"kind": "integer", "least": form.least, "most": form.most}


@describe_form.register
def _(form: FlagForm) -> Description:
    return {"kind": "flag"}


@describe_form.register
def _(form: ChoiceForm) -> Description:
    return {"kind": "choice", "options": list(form.words)}


@describe_form.register
def _(form: TextsForm) -> Description:
    return {"kind": "texts"}


@describe_form.register
def _(form: FormatsForm) -> Description:
    # of the many extensions of images, one of Intel HEX and one of S-records
    shown = [ending for ending in form.endings() if ending not in IMAGE_ENDINGS or ending in (".hex", ".s19")]
    return {"kind": "texts", "options": [ending.removeprefix(".") for ending in shown]}


@describe_form.register
def _(form: TableOfForm) -> Description:
    return {"kind": "table", "names": list(form.names), "values": describe_form(form.values)}


@describe_form.register
def _(form: EitherForm) -> Description:
    plain, table = describe_form(form.plain), describe_form(form.table)
    by = "by axis" if table.get("names") else "by name"
    title = "by part" if plain["kind"] == "entries" else "for all"
    alternatives = plain["forms"] if plain["kind"] == "either" else [{"title": title, **plain}]
    return _either(*alternatives, {"title": by, **table})


@describe_form.register
def _(form: EntryForm) -> Description:
    return {"kind": "entry", "keys": _describe_keys(form.entry)}


@describe_form.register
def _(form: EntriesForm) -> Description:
    return {"kind": "entries", "keys": _describe_keys(form.entry), "word": form.word, "single": form.takes_one}


@describe_form.register
def _(form: NamedEntriesForm) -> Description:
    return {"kind": "named", "keys": _describe_keys(form.entry)}


@describe_form.register
def _(form: ArrayForm) -> Description:
    return _either({"title": "one value", "kind": "number"}, {"title": "all values", "kind": "toml"})


@describe_form.register
def _(form: BoundsForm) -> Description:
    around = {"title": "around the start", "kind": "entry", "keys": _describe_keys(Around)}
    return _either({"title": "for all", "kind": "pair"}, around, {"title": "by value", "kind": "toml"})


@describe_form.register
def _(form: BreakpointsForm) -> Description:
    return {"kind": "numbers", "words": [FREE]}


@describe_form.register
def _(form: CoordinatesForm) -> Description:
    return {"kind": "numbers", "words": []}


@describe_form.register
def _(form: PairForm) -> Description:
    return {"kind": "pair"}


@describe_form.register
def _(form: LockForm) -> Description:
    ranges = [_part(direction, describe_form(AXIS_RANGE)) for direction in DIRECTIONS]
    return _either(
        {"title": "all", "kind": "flag"},
        {"title": "no data", "kind": "choice", "options": ["no-data"]},
        {"title": "ranges", "kind": "entries", "keys": ranges, "word": "", "single": False},
    )


@describe_form.register
def _(form: TargetForm) -> Description:
    return _either(
        *(
            {"title": kind, "kind": "entry", "keys": [_part(kind, {"kind": "text"}, kind)]}
            for kind in ("channel", "node")
        ),
        {"title": "number", "kind": "number"},
        {"title": "name", "kind": "text"},
    )


@describe_form.register
def _(form: FilesForm) -> Description:
    table = {"title": form.word, "kind": "entry", "keys": _describe_keys(form.entry)}
    return {"kind": "list", "item": _either({"title": "file", "kind": "text"}, table)}


@describe_form.register
def _(form: StepCriteriaForm) -> Description:
    weights = {"title": "weights", "kind": "table", "names": [], "values": describe_form(NumberForm(least=0))}
    return _either({"title": "these", "kind": "texts", "numbers": True}, weights)


def _either(*alternatives: Description) -> Description:
    return {"kind": "either", "forms": list(alternatives)}


def _part(name: str, form: Description, holds: str = "") -> Description:
    """Return the description of a part of a value that has no key of its own in the schema."""
    return {"name": name, "help": "", "type": "", "default": "", "required": False} | {
        "unit": "",
        "holds": holds,
        "by": "",
        "form": form,
    }


def _describe_keys(entry: type) -> list[Description]:
    return [describe_key(name, part) for name, part in keys_of(entry).items()]
