"""A Simulink file as a plain tree: systems of blocks and lines, and Stateflow charts, all fields as written.

Nothing is evaluated and no default is filled in.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import field
from functools import cached_property
from pathlib import Path
from typing import Literal, NamedTuple

from kennfeld.base.errors import Finding
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.reader.section_tree import normalize_name


@dataclass(frozen=True, slots=True)
class StoredState:
    """A state, or a function or box drawn as one.

    `type` is as in the file: OR_STATE, AND_STATE, FUNC_STATE, GROUP_STATE; `parent` is the id of the parent state,
    empty at the top. `decomposition` is CLUSTER_STATE (exclusive children) or SET_STATE (parallel children). `note`
    marks a text box; `special` is the kind of a state or function that is more than that. `output` is the name of the
    output that reports activity.
    """

    id: str
    label: str
    type: str = "OR_STATE"
    decomposition: str = "CLUSTER_STATE"
    order: int = 0
    parent: str = ""
    script: str = ""
    note: bool = False
    special: str = ""
    output: str = ""

    @property
    def name(self) -> str:
        r"""First line of the label without a trailing slash.

        >>> StoredState("1", "Idle/\nentry: y = 0;").name
        'Idle'
        """
        lines = self.label.strip().splitlines()
        return lines[0].strip().rstrip("/") if lines else ""


@dataclass(frozen=True, slots=True)
class StoredJunction:
    """A connective or history junction."""

    id: str
    type: str = "CONNECTIVE_JUNCTION"
    parent: str = ""


@dataclass(frozen=True, slots=True)
class StoredTransition:
    """A transition between states or junctions; `source` is empty for a default transition.

    One that crosses the edge of a subchart is stored as a whole and once more in pieces, one for each drawing that
    shows a part of it; `whole` is the identifier of the transition that a piece belongs to, "" for any other.
    """

    id: str
    label: str
    source: str
    target: str
    order: int = 0
    parent: str = ""
    whole: str = ""


@dataclass(frozen=True, slots=True)
class StoredData:
    """A variable of a chart.

    `scope` is as in the file: INPUT_DATA, OUTPUT_DATA, LOCAL_DATA, PARAMETER_DATA, CONSTANT_DATA, ... `first` is the
    index of its first element. With `from_workspace`, its initial value is the variable of its name; `update` is
    specified if it is integrated.
    """

    name: str
    scope: str
    initial: str = ""
    type: str = ""
    size: str = ""
    parent: str = ""
    first: str = ""
    from_workspace: bool = False
    update: str = ""
    message: bool = False


@dataclass(frozen=True, slots=True)
class StoredEvent:
    """An event of a chart: LOCAL_EVENT, INPUT_EVENT or OUTPUT_EVENT, and its trigger."""

    name: str
    scope: str
    trigger: str = ""
    parent: str = ""


@dataclass(frozen=True, slots=True)
class StoredChart:
    """A chart, a MATLAB Function or a truth table.

    `name` is the path of its block without the model name; `decomposition` is CLUSTER_CHART (exclusive states) or
    SET_CHART (parallel states); `language` is "MATLAB" or "C"; `script` is the code of a MATLAB Function. `bits` is
    true if C operators are bitwise; `settings` are further settings that affect execution.
    """

    id: str
    name: str
    kind: str = "Chart"
    language: str = "C"
    decomposition: str = "CLUSTER_CHART"
    update: str = ""
    sample_time: str = ""
    script: str = ""
    states: tuple[StoredState, ...] = ()
    junctions: tuple[StoredJunction, ...] = ()
    transitions: tuple[StoredTransition, ...] = ()
    data: tuple[StoredData, ...] = ()
    events: tuple[StoredEvent, ...] = ()
    execute_at_initialization: bool = False
    bits: bool = False
    settings: Mapping[str, str] = field(default_factory=dict)


def join_path(*names: str) -> str:
    """Join names to the path of a block; a slash within a name is doubled.

    >>> join_path("Engine", "km/h")
    'Engine/km//h'
    """
    return "/".join(normalize_name(name).replace("/", "//") for name in names)


def split_arguments(text: str) -> tuple[str, ...]:
    """Split a text at commas outside of brackets.

    >>> split_arguments("a, [1,2]")
    ('a', ' [1,2]')
    """
    parts, depth = [""], 0
    for character in text:
        depth += (character in "([{") - (character in ")]}")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return tuple(parts)


def split_path(path: str) -> tuple[str, ...]:
    """Split a path into its names, the inverse of `join_path`.

    >>> split_path("Engine/km//h")
    ('Engine', 'km/h')
    """
    return tuple(
        # a doubled slash is one within a name: it waits as a NUL, which no name contains, while the path is split
        normalize_name(name.replace("\0", "/"))
        for name in re.sub(r"//", "\0", path).split("/")
        if name or "/" not in path
    )


def normalize_path(path: str) -> str:
    """Normalize the white space of each name of a path, as in the paths of blocks.

    >>> normalize_path("Engine / km//h ")
    'Engine/km//h'
    """
    return join_path(*split_path(path))


class Endpoint(NamedTuple):
    """One end of a line: the SID of a block, and its port.

    `port` is "out", "in", a control port ("enable", "trigger", "ifaction", "reset", "state"), or a physical connection
    ("lconn", "rconn"). `number` counts ports of that kind from 1.
    """

    block: str
    port: str
    number: int = 1


@dataclass(frozen=True, slots=True)
class SignalLine:
    """A signal line: source, destinations and name.

    `source` is None if the line is unconnected; `destinations` is empty if it leads nowhere.
    """

    source: Endpoint | None
    destinations: tuple[Endpoint, ...]
    name: str = ""


@dataclass(frozen=True, slots=True)
class Ports:
    """Number of input and output ports."""

    inputs: int = 0
    outputs: int = 0


@dataclass(frozen=True, slots=True)
class MaskParameter:
    """A mask parameter: its expression, and whether that is evaluated or a text.

    `options` are the choices of a popup or radio buttons.
    """

    name: str
    expression: str
    type: str = "edit"
    evaluated: bool = True
    options: tuple[str, ...] = ()

    @property
    def meaning(self) -> str:
        """Expression of its value: 1 or 0 for a check box, the number of a choice.

        >>> MaskParameter("mode", "slow", "popup", options=("fast", "slow")).meaning
        '2'
        """
        if not self.evaluated:
            return self.expression
        if self.type == "checkbox":
            return {"on": "1", "off": "0"}.get(match_word(self.expression, ("on", "off")) or "", self.expression)
        # an evaluated choice is the number of its text, from 1
        choice = match_word(self.expression, self.options) if self.type in ("popup", "radiobutton") else None
        return str(self.options.index(choice) + 1) if choice is not None else self.expression


@dataclass(frozen=True, slots=True)
class Mask:
    """The mask of a block: parameters in dialog order, and initialization code."""

    type: str = ""
    parameters: tuple[MaskParameter, ...] = ()
    initialization: str = ""


@dataclass(frozen=True, slots=True)
class LibraryLink:
    """A link to a library block.

    `source` is the path "library/Block", `type` the mask type there (SourceType), `parameters` the fields of this
    instance.
    """

    source: str
    type: str = ""
    parameters: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ModelBlock:
    """One block.

    `sid` is unique within its system, derived from the position if the file gives none. `path` leads from the root,
    without the model name. `parameters` are the fields specified for this block, `defaults` those for all blocks of the
    type. `ports` is None if the file leaves them to the type. `script` is the code of a MATLAB
    Function, `chart` that of any Stateflow block; `model` is the file name of a referenced model. `signals` are names
    of output ports; `lists` are the fields that are lists of texts. `recording` holds the signals of a Signal Builder,
    in the form of a workspace. `searched` are the folders in which the file that a link leads to was not found.
    """

    type: str
    name: str
    sid: str
    path: str
    parameters: Mapping[str, str] = field(default_factory=dict)
    defaults: Mapping[str, str] = field(default_factory=dict)
    ports: Ports | None = None
    mask: Mask | None = None
    reference: LibraryLink | None = None
    system: "System | None" = None
    script: str = ""
    chart: StoredChart | None = None
    model: str = ""
    signals: Mapping[int, str] = field(default_factory=dict)
    lists: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    recording: "StoredWorkspace | None" = None
    searched: tuple[str, ...] = ()

    def listed(self, name: str) -> tuple[str, ...]:
        """Read a field that is a list of texts, () if not specified.

        >>> ModelBlock("VariantSource", "V", "1", "V", {"VariantControls": "{'a==1','a==2'}"}).listed("VariantControls")
        ('a==1', 'a==2')
        """
        if name in self.lists:
            return self.lists[name]
        return tuple(re.findall(r"'((?:[^']|'')*)'", self.value(name) or ""))

    @property
    def elsewhere(self) -> str:
        """Name of the subsystem file that contains the content, "" if there is none."""
        return (self.parameters.get("ReferencedSubsystem") or "").strip() if self.type == "SubSystem" else ""

    def value(self, name: str) -> str | None:
        """Read a field as text: of the block, else of its type in the file; or None."""
        written = self.parameters.get(name)
        return self.defaults.get(name) if written is None else written

    def is_set_to(self, name: str, *words: str, default: str = "") -> bool:
        """Return True if a field is one of some words of a dialog; `default` stands for a field without a value.

        >>> ModelBlock("SubSystem", "V", "1", "V", {"Variant": "On"}).is_set_to("Variant", "on")
        True
        """
        return match_word(self.value(name) or default, words) is not None


@dataclass(frozen=True)
class System:
    """The blocks and lines of one system, in file order.

    `commented` names the commented-out block that fed an input.
    """

    blocks: tuple[ModelBlock, ...] = ()
    lines: tuple[SignalLine, ...] = ()
    commented: Mapping[Endpoint, str] = field(default_factory=dict)

    @cached_property
    def by_sid(self) -> Mapping[str, ModelBlock]:
        """Blocks by SID."""
        return {block.sid: block for block in self.blocks}

    @cached_property
    def by_name(self) -> Mapping[str, ModelBlock]:
        """Blocks by name, with normalized white space."""
        return {block.name: block for block in self.blocks}

    def of(self, *types: str) -> Iterator[ModelBlock]:
        """Yield the blocks of this system of one of the types."""
        return (block for block in self.blocks if block.type in types)

    def every(self) -> Iterator[ModelBlock]:
        """Yield all blocks of this system and below, a subsystem before its content."""
        # a stack of iterators, which keeps the order of the file
        waiting = [iter(self.blocks)]
        while waiting:
            block = next(waiting[-1], None)
            if block is None:
                waiting.pop()
                continue
            yield block
            if block.system is not None:
                waiting.append(iter(block.system.blocks))

    def at(self, path: str) -> ModelBlock | None:
        """Find the block at a path ("Engine/Torque"), None if there is none."""
        system: System | None = self
        block = None
        for name in split_path(path):
            block = system.by_name.get(name) if system is not None else None
            if block is None:
                return None
            system = block.system
        return block


@dataclass(frozen=True, slots=True)
class StoredSolver:
    """Settings of the active configuration as written.

    `reference` names a configuration stored elsewhere (a base workspace variable or data dictionary entry); the other
    fields are then those of the file, if any. `tasks` is the tasking setting in the word of the release: on, off, Auto,
    SingleTasking, MultiTasking. `default_type` is that of signals whose type nothing specifies.
    """

    name: str = ""
    fixed_step: str = ""
    start: str = ""
    stop: str = ""
    max_step: str = ""
    reference: str = ""
    tasks: str = ""
    default_type: str = ""


@dataclass(frozen=True, slots=True)
class StoredWorkspace:
    """Location of the model workspace.

    `kind` is "none", "mxarray" or "mat" (in `raw`), "m-code" (in `text`), or "file" (its name in `text`).
    """

    kind: Literal["none", "mxarray", "mat", "m-code", "file"] = "none"
    raw: bytes = b""
    text: str = ""


@dataclass(frozen=True)
class ModelDocument:
    """A Simulink file.

    `version` is a release ("R2017b") or, in older files, the Simulink version number. `callbacks` is the code of
    InitFcn, PreLoadFcn and so on; `dictionaries` are names of `.sldd` files; `mask` is that of a subsystem file for the
    blocks that reference it; `warnings` are findings on what could not be read.
    """

    name: str
    kind: Literal["model", "library", "subsystem"]
    version: str
    path: Path
    root: System
    solver: StoredSolver = StoredSolver()
    callbacks: Mapping[str, str] = field(default_factory=dict)
    workspace: StoredWorkspace = StoredWorkspace()
    dictionaries: tuple[str, ...] = ()
    mask: Mask | None = None
    warnings: tuple[Finding, ...] = ()
