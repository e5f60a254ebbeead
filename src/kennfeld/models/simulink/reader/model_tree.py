"""A Simulink file as a plain tree: systems of blocks and lines, every parameter as it is written.

Nothing is evaluated here and no default is filled in: what a block does is for others to say.

A Stateflow chart as a plain tree: states, junctions, transitions and data, their labels as written.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

from kennfeld.models.simulink.reader.section_tree import normalize_name

__all__ = [
    "Endpoint",
    "LibraryLink",
    "Mask",
    "MaskParameter",
    "ModelBlock",
    "ModelDocument",
    "Ports",
    "SignalLine",
    "StoredChart",
    "StoredData",
    "StoredEvent",
    "StoredJunction",
    "StoredSolver",
    "StoredState",
    "StoredTransition",
    "StoredWorkspace",
    "System",
    "join_path",
    "split_arguments",
    "split_path",
]


@dataclass(frozen=True, slots=True)
class StoredState:
    """A state, or a function or box drawn as one.

    `type` is as in the file: OR_STATE, AND_STATE, FUNC_STATE, GROUP_STATE; `parent` is the id of the state around it,
    empty at the top. `decomposition` is CLUSTER_STATE (one child at a time) or SET_STATE (all children at once).
    `note` marks a box that is but text; `special` says what makes it more than a state or a function of the chart.
    `output` is the name of the output that tells whether it is active.
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
        r"""The first line of the label, without a slash that ends it.

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
    """An arrow between states or junctions; `source` is empty for a default transition."""

    id: str
    label: str
    source: str
    target: str
    order: int = 0
    parent: str = ""


@dataclass(frozen=True, slots=True)
class StoredData:
    """A variable of a chart.

    `scope` is as in the file: INPUT_DATA, OUTPUT_DATA, LOCAL_DATA, PARAMETER_DATA, CONSTANT_DATA, ... `first` is the
    index of its first element; with `from_workspace` it begins as the variable of its name; `update` is stated where
    it is integrated.
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

    `name` is the path of its block without the model's name; `decomposition` is CLUSTER_CHART (one state at a time)
    or SET_CHART (all at once); `language` is "MATLAB" or "C"; `script` is the code of a MATLAB Function.
    `bits` says whether the operators of C work on bits; `settings` are further settings that change how it runs.
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
    """The path of a block from the names along it; a slash within a name is doubled.

    >>> join_path("Engine", "km/h")
    'Engine/km//h'
    """
    return "/".join(normalize_name(name).replace("/", "//") for name in names)


def split_arguments(text: str) -> tuple[str, ...]:
    """The parts of a text between commas outside of brackets.

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
    """The names along a path, the reverse of `joined`.

    >>> split_path("Engine/km//h")
    ('Engine', 'km/h')
    """
    return tuple(
        normalize_name(name.replace("\0", "/"))
        for name in re.sub(r"//", "\0", path).split("/")
        if name or "/" not in path
    )


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One end of a line: the SID of a block and its port.

    `port` is "out", "in", or a special port: "enable", "trigger", "ifaction", "reset", "state", and "lconn", "rconn"
    of physical connections. `number` counts from 1 among the ports of that kind.
    """

    block: str
    port: str
    number: int = 1


@dataclass(frozen=True, slots=True)
class SignalLine:
    """A signal: where it comes from, where it goes to, and the name it carries.

    `source` is None for a line that hangs loose, `destinations` is empty for one that leads nowhere.
    """

    source: Endpoint | None
    destinations: tuple[Endpoint, ...]
    name: str = ""


@dataclass(frozen=True, slots=True)
class Ports:
    """How many ports of each kind a block has."""

    inputs: int = 0
    outputs: int = 0
    enable: int = 0
    trigger: int = 0
    state: int = 0
    lconn: int = 0
    rconn: int = 0
    ifaction: int = 0
    reset: int = 0


@dataclass(frozen=True, slots=True)
class MaskParameter:
    """One parameter of a mask: the expression it is set to, and whether that is evaluated or taken as text.

    `options` are the choices of a popup or of radio buttons.
    """

    name: str
    expression: str
    type: str = "edit"
    evaluated: bool = True
    prompt: str = ""
    options: tuple[str, ...] = ()

    @property
    def meaning(self) -> str:
        """The expression of its value: a check box is 1 or 0, a choice is its number.

        >>> MaskParameter("mode", "slow", "popup", options=("fast", "slow")).meaning
        '2'
        """
        if not self.evaluated:
            return self.expression
        if self.type == "checkbox":
            return {"on": "1", "off": "0"}.get(self.expression.strip(), self.expression)
        chosen = self.type in ("popup", "radiobutton") and self.expression in self.options
        return str(self.options.index(self.expression) + 1) if chosen else self.expression


@dataclass(frozen=True, slots=True)
class Mask:
    """The mask of a block: parameters in the order of the dialog, and code that runs when they change."""

    type: str = ""
    parameters: tuple[MaskParameter, ...] = ()
    initialization: str = ""


@dataclass(frozen=True, slots=True)
class LibraryLink:
    """A link to a block of a library.

    `source` is the path "library/Block", `type` the type of the mask there (SourceType), `parameters` what this
    instance sets; `file` names the library's file once its content has been copied in.
    """

    source: str
    type: str = ""
    parameters: Mapping[str, str] = field(default_factory=dict)
    file: str = ""


@dataclass(frozen=True)
class ModelBlock:
    """One block.

    `sid` is unique within its system; where the file gives none, it is made of the block's place. `path` leads from
    the root of the model, without the model's name. `parameters` are those the file states for this block, `defaults`
    those it states for all blocks of the type. `ports` is None where the file leaves them to the type (`ports_of`
    knows those of the types). `script` is the
    code of a MATLAB Function, `chart` that of any Stateflow block; `model` the file name of a referenced model.
    `signals` are the names of output ports; `attached` names parts of the file that hold a parameter's value; `lists`
    are the parameters that are lists of texts.
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
    attached: Mapping[str, str] = field(default_factory=dict)
    lists: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def listed(self, name: str) -> tuple[str, ...]:
        """A parameter that is a list of texts; empty where no one states it.

        >>> ModelBlock("VariantSource", "V", "1", "V", {"VariantControls": "{'a==1','a==2'}"}).listed("VariantControls")
        ('a==1', 'a==2')
        """
        if name in self.lists:
            return self.lists[name]
        return tuple(re.findall(r"'((?:[^']|'')*)'", self.value(name) or ""))

    @property
    def elsewhere(self) -> str:
        """The name of the file that holds the content of a subsystem; empty where the subsystem holds it."""
        return (self.parameters.get("ReferencedSubsystem") or "").strip() if self.type == "SubSystem" else ""

    def value(self, name: str, table: Mapping[str, Mapping[str, str]] | None = None) -> str | None:
        """A parameter as text: as stated for the block, else for its type by the file, else by a table of defaults.

        None where no one states it.

        >>> ModelBlock("Gain", "K", "1", "K").value("Gain", {"Gain": {"Gain": "1"}})
        '1'
        """
        if name in self.parameters:
            return self.parameters[name]
        if name in self.defaults:
            return self.defaults[name]
        return (table or {}).get(self.type, {}).get(name)


@dataclass(frozen=True)
class System:
    """The blocks and lines of one level, in the order of the file."""

    blocks: tuple[ModelBlock, ...] = ()
    lines: tuple[SignalLine, ...] = ()

    @cached_property
    def by_sid(self) -> Mapping[str, ModelBlock]:
        """The blocks of this level by their SIDs."""
        return {block.sid: block for block in self.blocks}

    @cached_property
    def by_name(self) -> Mapping[str, ModelBlock]:
        """The blocks of this level by their names, white space normalised."""
        return {block.name: block for block in self.blocks}

    def of(self, *types: str) -> Iterator[ModelBlock]:
        """The blocks of this level that are of one of the types."""
        return (block for block in self.blocks if block.type in types)

    def every(self) -> Iterator[ModelBlock]:
        """All blocks of this level and below, a subsystem before its content."""
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
        """The block of a path ("Engine/Torque"); None where there is none."""
        system: System | None = self
        found = None
        for name in split_path(path):
            found = system.by_name.get(name) if system is not None else None
            if found is None:
                return None
            system = found.system
        return found


@dataclass(frozen=True, slots=True)
class StoredSolver:
    """The settings of the active configuration, as written.

    `reference` names a configuration that is kept elsewhere (a variable of the base workspace, an entry of a data
    dictionary); the other fields are then what the file says by itself, if anything. `tasks` says whether each sample
    time is a task of its own, in the word of the release: on, off, Auto, SingleTasking, MultiTasking.
    """

    name: str = ""
    fixed_step: str = ""
    start: str = ""
    stop: str = ""
    max_step: str = ""
    reference: str = ""
    tasks: str = ""


@dataclass(frozen=True, slots=True)
class StoredWorkspace:
    """Where the variables of the model workspace are.

    `kind` is "none", "mxarray" or "mat" (in `raw`), "m-code" (in `text`), or "file" (its name in `text`).
    """

    kind: Literal["none", "mxarray", "mat", "m-code", "file"] = "none"
    raw: bytes = b""
    text: str = ""


@dataclass(frozen=True)
class ModelDocument:
    """A Simulink file.

    `version` is a release ("R2017b") or, from files that name none, the number of the Simulink version. `callbacks`
    is the code of InitFcn, PreLoadFcn and the like; `dictionaries` are the names of `.sldd` files; `defaults` are by
    block type; `enumerations` are the enumerated types that blocks name; `charts` are all of the file; `mask` is that
    of a subsystem file for the blocks that show it; `remarks` are sentences on what could not be read.
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
    defaults: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    enumerations: tuple[str, ...] = ()
    charts: tuple[StoredChart, ...] = ()
    parameters: Mapping[str, str] = field(default_factory=dict)
    mask: Mask | None = None
    remarks: tuple[str, ...] = ()
