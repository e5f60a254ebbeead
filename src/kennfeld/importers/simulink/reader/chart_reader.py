"""Stateflow charts from sections of XML layouts and of classic `.mdl` files."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

from kennfeld.importers.simulink.reader.model_tree import (
    StoredChart,
    StoredData,
    StoredEvent,
    StoredJunction,
    StoredState,
    StoredTransition,
    normalize_path,
)
from kennfeld.importers.simulink.reader.section_tree import SectionNode
from kennfeld.importers.simulink.reader.truth_tables import (
    TruthTable,
    is_generated,
    read_truth_table,
    table_flow,
    table_script,
)

_TABLE = "Truth Table"
_KINDS = {
    "EML_CHART": "MATLAB Function",
    "2": "MATLAB Function",
    "TRUTH_TABLE_CHART": _TABLE,
    "TRUTHTABLE_CHART": _TABLE,
    "1": _TABLE,
    "STATE_TRANSITION_TABLE_CHART": "State Transition Table",
}
_SETTINGS = ("stateMachineType", "enableNonTerminalStates", "initializeOutput")
_TABLES = ("state", "junction", "transition", "data", "event")

Content = list[tuple[SectionNode, str, str]]  # section, its id, the id of its parent state


def read_charts(stateflow: SectionNode, load: Callable[[str], SectionNode | None]) -> dict[str, StoredChart]:
    """Read the charts of a machine by block path; `load` returns a chart stored in a part of its own."""
    machine = stateflow.first("machine")
    children = machine.first("Children") if machine is not None else None
    written = [*stateflow.all("chart"), *(children.all("chart") if children is not None else ())]
    sections = [load(chart.keys["Ref"]) if "Ref" in chart.keys else chart for chart in written]
    # an instance links the number of a chart to the path of its block
    names = {instance.keys.get("chart", ""): instance.keys.get("name", "") for instance in stateflow.all("instance")}
    flat = _Flat(stateflow) if any(stateflow.all(*_TABLES)) else None
    charts = {}
    for section in filter(None, sections):
        number = section.keys.get("id", "")
        name = normalize_path(names.get(number) or section.keys.get("name", ""))
        charts[name] = _chart(section, name, flat.content.get(number, []) if flat is not None else _content_of(section))
    return charts


def _content_of(chart: SectionNode) -> Content:
    """Return the content of an XML chart, each object with its parent state."""
    content: Content = []
    waiting: deque[tuple[SectionNode, str]] = deque([(chart, "")])
    while waiting:
        holder, parent = waiting.popleft()
        children = holder.first("Children")
        for part in children.parts if children is not None else ():
            if part.kind in _TABLES:
                number = part.keys.get("SSID", "")
                content.append((part, number, parent))
                if part.kind == "state":
                    waiting.append((part, number))
    return content


class _Flat:
    """A classic machine: one flat list of objects linked by numbers."""

    def __init__(self, stateflow: SectionNode) -> None:
        parts = list(stateflow.all(*_TABLES))
        self.states = {part.keys.get("id", ""): part for part in parts if part.kind == "state"}
        self.numbers = {part.keys.get("id", ""): part.keys.get("ssIdNumber", "") for part in parts}
        self.charts = {chart.keys.get("id", "") for chart in stateflow.all("chart")}
        self.content: dict[str, Content] = {}
        for part in parts:
            entry = (part, self.numbers[part.keys.get("id", "")], self._parent(part))
            self.content.setdefault(self._chart(part), []).append(entry)

    def _up(self, part: SectionNode) -> str:
        """Return the number of an object's parent, the first of its treeNode or linkNode."""
        node = part.keys.get("treeNode") or part.keys.get("linkNode", "")
        numbers = node.strip("[] ").split()
        return numbers[0] if numbers else ""

    def _parent(self, part: SectionNode) -> str:
        up = self._up(part)
        return "" if up in self.charts else self.numbers.get(up, "")

    def _chart(self, part: SectionNode) -> str:
        if "chart" in part.keys:
            return part.keys["chart"]
        up = self._up(part)
        if up in self.charts:
            return up
        state = self.states.get(up)
        return state.keys.get("chart", "") if state is not None else ""


def _chart(section: SectionNode, name: str, content: Content) -> StoredChart:
    keys = section.keys
    # classic files link transitions by the numbers of the machine, XML by those within the chart (SSID)
    numbers = {part.keys["id"]: number for part, number, _ in content if "id" in part.keys}
    tables = {number: table for part, number, _ in _of(content, "state") if (table := read_truth_table(part))}
    # what is stored beside a truth table was made of it, perhaps before its last change
    content = [entry for entry in content if entry[2] not in tables or not is_generated(entry[0])]
    states = tuple(_state(*entry) for entry in _of(content, "state"))
    chart = StoredChart(
        id=keys.get("id", ""),
        name=name,
        kind=_KINDS.get(keys.get("type", ""), "Chart"),
        # 2 is MATLAB, 1 is C with operators on bits, everything else C with logical ones
        language="MATLAB" if keys.get("actionLanguage") == "2" else "C",
        decomposition=keys.get("decomposition", "CLUSTER_CHART"),
        update=keys.get("updateMethod", ""),
        sample_time=keys.get("sampleTime", ""),
        script=next((state.script for state in states if state.script), "") if keys.get("type") in _KINDS else "",
        states=states,
        junctions=tuple(
            StoredJunction(number, part.keys.get("type", "CONNECTIVE_JUNCTION"), parent)
            for part, number, parent in _of(content, "junction")
        ),
        transitions=tuple(_transition(*entry, numbers) for entry in _of(content, "transition")),
        data=tuple(_data(part, parent) for part, _, parent in _of(content, "data")),
        events=tuple(_event(part, parent) for part, _, parent in _of(content, "event")),
        execute_at_initialization=keys.get("executeAtInitialization") == "1",
        bits=keys.get("actionLanguage") == "1",
        settings={key: keys[key] for key in _SETTINGS if key in keys},
    )
    return _with_truth_tables(chart, tables) if tables else chart


def _with_truth_tables(chart: StoredChart, tables: Mapping[str, TruthTable]) -> StoredChart:
    """Return a chart whose truth tables are functions: code in MATLAB, or flow charts in C."""
    drawn = {state.id: state for state in chart.states}
    scripts = {number: table_script(table, drawn[number]) for number, table in tables.items() if table.is_matlab}
    flows = [table_flow(table, drawn[number]) for number, table in tables.items() if not table.is_matlab]
    chart = replace(
        chart,
        states=tuple(replace(state, script=scripts.get(state.id, state.script)) for state in chart.states),
        junctions=(*chart.junctions, *(junction for flow in flows for junction in flow.junctions)),
        transitions=(*chart.transitions, *(transition for flow in flows for transition in flow.transitions)),
        data=(*chart.data, *(data for flow in flows for data in flow.data)),
    )
    # the block Truth Table is a chart of one table, which it runs in each step
    return _of_table_block(chart) if chart.kind == _TABLE and len(tables) == 1 else chart


def _of_table_block(chart: StoredChart) -> StoredChart:
    """Return the chart of a Truth Table block: it calls its only function, whose variables are those of the chart."""
    if any(not transition.parent for transition in chart.transitions):  # the call is stored
        return replace(chart, kind="Chart", script="")
    call = f"{{{chart.states[0].name.partition('(')[0].rpartition('=')[2].strip()}();}}"
    end = StoredJunction("end of the call")
    transitions = (*chart.transitions, StoredTransition("call", call, "", end.id, 1))
    return replace(chart, kind="Chart", script="", junctions=(*chart.junctions, end), transitions=transitions)


def _of(content: Content, kind: str) -> Iterator[tuple[SectionNode, str, str]]:
    return (entry for entry in content if entry[0].kind == kind)


def _state(section: SectionNode, number: str, parent: str) -> StoredState:
    keys, code = section.keys, section.first("eml")
    return StoredState(
        number,
        keys.get("labelString", ""),
        keys.get("type", "OR_STATE"),
        keys.get("decomposition", "CLUSTER_STATE"),
        _whole(keys.get("executionOrder", "")),
        parent,
        code.get("script") if code is not None else "",
        keys.get("isNoteBox") == "1",
        _special(section),
        _output(section),
    )


def _special(section: SectionNode) -> str:
    block, table = section.first("simulink"), section.first("truthTable")
    if block is not None:
        return "a Simulink function" if block.get("isSimulinkFcn") == "1" else "a state made of Simulink blocks"
    if table is not None and table.get("isTruthTable") == "1" and read_truth_table(section) is None:
        return "a truth table whose entries or actions cannot be read"
    parts = section.first("subchart", "component")
    return "an atomic subchart" if parts is not None or section.keys.get("superState") == "ATOMIC" else ""


def _output(section: SectionNode) -> str:
    output = section.first("activeStateOutput")
    if output is None:
        return ""
    # without a name of its own, the output is called like the state
    return output.get("customName") or section.keys.get("labelString", "").split("\n")[0].strip().rstrip("/")


def _transition(section: SectionNode, number: str, parent: str, numbers: Mapping[str, str]) -> StoredTransition:
    def end(kind: str) -> str:
        node = section.first(kind)
        if node is None:
            return ""
        return node.keys.get("SSID") or numbers.get(node.keys.get("id", ""), "")

    # the last piece of a transition through a subchart has no order of its own: 4294967295, which counts as none
    order = _whole(section.keys.get("executionOrder", ""))
    label, whole = section.keys.get("labelString", ""), _whole_transition(section, numbers)
    return StoredTransition(number, label, end("src"), end("dst"), order, parent, whole)


def _whole_transition(section: SectionNode, numbers: Mapping[str, str]) -> str:
    """Return the identifier of the transition that a section is a piece of, "" if it is a whole one.

    A piece has the type SUB and `subLink [whole before next]`; the whole one has the type SUPER, and both of its ends.
    """
    links = section.keys.get("subLink", "").strip("[] ").split()
    if section.keys.get("type") != "SUB" or not links:
        return ""
    return numbers.get(links[0], links[0])


def _data(section: SectionNode, parent: str) -> StoredData:
    properties = section.first("props")
    shape = properties.first("array") if properties is not None else None
    return StoredData(
        section.keys.get("name", ""),
        section.keys.get("scope", "LOCAL_DATA"),
        properties.get("initialValue") if properties is not None else "",
        section.keys.get("dataType", ""),
        shape.get("size") if shape is not None else "",
        parent,
        shape.get("firstIndex") if shape is not None else "",
        section.keys.get("initFromWorkspace") == "1",
        properties.get("updateMethod") if properties is not None else "",
        section.first("message") is not None,
    )


def _event(section: SectionNode, parent: str) -> StoredEvent:
    get = section.keys.get
    return StoredEvent(get("name", ""), get("scope", "LOCAL_EVENT"), get("trigger", ""), parent)


def _whole(written: str) -> int:
    return int(written) if written.isdigit() and len(written) < 10 else 0
