"""A Stateflow chart as a plain tree: states, junctions, transitions and data, their labels as written."""

from collections.abc import Mapping
from dataclasses import dataclass, field

__all__ = ["Chart", "ChartData", "ChartEvent", "ChartState", "Junction", "Transition"]


@dataclass(frozen=True, slots=True)
class ChartState:
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

        >>> ChartState("1", "Idle/\nentry: y = 0;").name
        'Idle'
        """
        lines = self.label.strip().splitlines()
        return lines[0].strip().rstrip("/") if lines else ""


@dataclass(frozen=True, slots=True)
class Junction:
    """A connective or history junction."""

    id: str
    type: str = "CONNECTIVE_JUNCTION"
    parent: str = ""


@dataclass(frozen=True, slots=True)
class Transition:
    """An arrow between states or junctions; `source` is empty for a default transition."""

    id: str
    label: str
    source: str
    target: str
    order: int = 0
    parent: str = ""


@dataclass(frozen=True, slots=True)
class ChartData:
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
class ChartEvent:
    """An event of a chart: LOCAL_EVENT, INPUT_EVENT or OUTPUT_EVENT, and its trigger."""

    name: str
    scope: str
    trigger: str = ""
    parent: str = ""


@dataclass(frozen=True, slots=True)
class Chart:
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
    states: tuple[ChartState, ...] = ()
    junctions: tuple[Junction, ...] = ()
    transitions: tuple[Transition, ...] = ()
    data: tuple[ChartData, ...] = ()
    events: tuple[ChartEvent, ...] = ()
    execute_at_initialization: bool = False
    bits: bool = False
    settings: Mapping[str, str] = field(default_factory=dict)
