"""Small Simulink files, written in every layout from one description.

    model = Model("engine", solver="ode4", step="0.01")
    model.inport("n")
    model.block("Gain", "K", Gain="k1")
    model.outport("y")
    model.chain("n", "K", "y")
    path = model.write(folder, "slx parts")

`LAYOUTS` names the layouts. A block is named in a line by its name; ":2" after it is its second port, "#enable" a
special one. Parameters are texts as Simulink writes them; numbers are written by `str`.
"""

import base64
import io
import json
import re
import zipfile
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

LAYOUTS = ("slx inline", "slx parts", "slx json", "mdl", "mdl package")
ENDINGS = {layout: f".{layout[:3]}" for layout in LAYOUTS}
SPECIAL = {"EnablePort": "enable", "TriggerPort": "trigger", "ActionPort": "ifaction", "ResetPort": "reset"}
COUNTED = ("in", "out", "enable", "trigger", "state", "lconn", "rconn", "ifaction", "reset")


@dataclass
class Block:
    kind: str
    name: str
    sid: int
    parameters: dict[str, str]
    ports: dict[str, int] | None = None
    mask: "Mask | None" = None
    instance: dict[str, str] | None = None
    system: "System | None" = None
    signals: dict[int, str] = field(default_factory=dict)
    script: str = ""
    data: dict[str, str] = field(default_factory=dict)
    settings: dict[str, str] = field(default_factory=dict)
    chart: "Chart | None" = None
    lists: dict[str, list[str]] = field(default_factory=dict)

    def counted(self):
        """The ports by kind: as given, else those of the system within."""
        if self.ports is not None or self.system is None:
            return self.ports
        kinds = [block.kind for block in self.system.blocks]
        counts = {"in": kinds.count("Inport"), "out": kinds.count("Outport")}
        return counts | {port: 1 for kind, port in SPECIAL.items() if kind in kinds}


@dataclass
class Mask:
    """`parameters` are names with expressions; those in `texts` are not evaluated.

    `types` are those that are not "edit", `options` the choices of popups.
    """

    parameters: dict[str, str]
    type: str = ""
    initialization: str = ""
    texts: tuple[str, ...] = ()
    types: dict[str, str] = field(default_factory=dict)
    options: dict[str, list[str]] = field(default_factory=dict)


@dataclass
class Chart:
    """A chart: states by name with their labels, transitions (from, to, label), data (name, scope).

    `parents` are the states around states, junctions and functions; those of `parallel` have children that are active
    at once, and "" among them stands for the chart; `boxes` are boxes, not states. A transition may have a fourth part,
    the state that it is drawn in, data an initial value, a size and a parent, events (name, scope, trigger) a parent.
    `functions` are states that are functions, with their code in MATLAB or "" where they are drawn. `types` are those
    of data by their names. A transition through the edge of one of the `subcharts` is stored whole and in pieces.
    `tables` are functions that are truth tables: the rows of conditions and of actions, and whether they are in MATLAB.
    """

    states: dict[str, str] = field(default_factory=dict)
    transitions: list[tuple[str, ...]] = field(default_factory=list)
    data: list[tuple[str, ...]] = field(default_factory=list)
    events: list[tuple[str, ...]] = field(default_factory=list)
    parents: dict[str, str] = field(default_factory=dict)
    parallel: tuple[str, ...] = ()
    junctions: tuple[str, ...] = ()
    histories: tuple[str, ...] = ()
    functions: dict[str, str] = field(default_factory=dict)
    boxes: tuple[str, ...] = ()
    settings: dict[str, str] = field(default_factory=dict)
    language: str = "C"
    types: dict[str, str] = field(default_factory=dict)
    subcharts: tuple[str, ...] = ()
    tables: dict[str, tuple[list[list[str]], list[list[str]], bool]] = field(default_factory=dict)

    def ids(self):
        """The numbers of states and junctions by their names."""
        return {name: at for at, name in enumerate((*self.states, *self.junctions, *self.histories), 1)}

    def holder(self, transition):
        """The state that a transition is drawn in: as given, else the nearest around both ends."""
        if len(transition) > 3:
            return transition[3]
        source, target = transition[:2]
        around = self.around(source)[1:] if source else self.around(target)[1:]
        return next(name for name in around if name in self.around(target)[1:])

    def around(self, name):
        path = [name]
        while path[-1]:
            path.append(self.parents.get(path[-1], ""))
        return path

    def keys(self, name):
        """Keys of a state in the file, except its label."""
        if name in self.boxes:
            return {"type": "GROUP_STATE"}
        parent = self.parents.get(name, "")
        keys = {"type": "FUNC_STATE" if name in self.functions else "OR_STATE"}
        if parent in self.parallel and name not in self.functions:
            brothers = [one for one in self.states if self.parents.get(one, "") == parent]
            keys = {"type": "AND_STATE", "executionOrder": str(1 + brothers.index(name))}
        return keys | {"decomposition": "SET_STATE" if name in self.parallel else "CLUSTER_STATE"}

    def orders(self):
        """The number of each transition among those that leave the same state or junction."""
        seen = {}
        for one in self.transitions:
            key = one[0] or f"in {self.holder(one)}", one[0] == self.holder(one)
            seen[key] = seen.get(key, 0) + 1
            yield seen[key]

    def drawn(self):
        """The transitions as a file has them: number, transition, order, further keys.

        One through the edges of subcharts is stored as SUPER, followed by its pieces (SUB), each drawn in one subchart
        or around them.
        """
        number = len(self.transitions)
        for at, (whole, order) in enumerate(zip(self.transitions, self.orders(), strict=True), 1):
            holder = self.holder(whole)
            inside = [[name for name in self.around(end)[1:] if end and name in self.subcharts] for end in whole[:2]]
            ups, downs = ([name for name in names if holder in self.around(name)[1:]] for names in inside)
            stops = [whole[0], *ups, *reversed(downs), whole[1]]
            if len(stops) == 2:
                yield at, whole, order, {}
                continue
            yield at, whole, order, {"type": "SUPER", "firstSubWire": number + 1}
            for place, (start, end) in enumerate(pairwise(stops)):
                number += 1
                within = end if place < len(ups) else holder if place == len(ups) else start
                last = place == len(stops) - 2
                link = [at, number - 1 if place else 0, 0 if last else number + 1]
                yield number, (start, end, whole[2], within), order, {"type": "SUB", "subLink": link}

    def truth_table(self, name):
        """Keys of the truth table of a function: its arrays of texts, column by column."""
        rows, actions, _ = self.tables[name]
        return {"isTruthTable": 1, "predicateArray": _text_array(rows), "actionArray": _text_array(actions)}

    def written(self):
        """The settings of the chart."""
        keys = {"decomposition": "SET_CHART" if "" in self.parallel else "CLUSTER_CHART"}
        return keys | ({"actionLanguage": "2"} if self.language == "MATLAB" else {}) | self.settings


def _text_array(rows):
    texts = (f'T"{row[at]}"' for at in range(len(rows[0])) for row in rows)
    return f"100 C{len(rows)}x{len(rows[0])}{{{','.join(texts)}}}"


@dataclass
class Wire:
    source: tuple[str, str, int] | None
    ends: list[tuple[str, str, int]]
    name: str = ""


class System:
    """The content of a model or a subsystem; the methods return what they add."""

    def __init__(self, model, path=()):
        self.model = model
        self.path = path
        self.blocks = []
        self.wires = []

    def block(self, kind, name, *, ports=None, mask=None, instance=None, signals=None, lists=None, **parameters):
        """A block; `ports` is (inputs, outputs) or a dictionary by kind, left to the type where it is None.

        `lists` are parameters that are lists of texts.
        """
        if isinstance(ports, tuple):
            ports = dict(zip(("in", "out"), ports, strict=True))
        written = {key: str(value) for key, value in parameters.items()}
        block = Block(
            kind, name, self.model.number(), written, ports, mask, instance, signals=signals or {}, lists=lists or {}
        )
        self.blocks.append(block)
        return block

    def inport(self, name, **parameters):
        return self._port("Inport", name, parameters)

    def outport(self, name, **parameters):
        return self._port("Outport", name, parameters)

    def _port(self, kind, name, parameters):
        number = 1 + sum(block.kind == kind for block in self.blocks)
        return self.block(kind, name, **({"Port": number} if number > 1 else {}), **parameters)

    def subsystem(self, name, **options):
        """An empty subsystem; add blocks to what is returned."""
        holder = self.block("SubSystem", name, **options)
        holder.system = System(self.model, (*self.path, name))
        return holder.system

    def link(self, name, source, kind="", *, ports=(1, 1), **instance):
        """A link to a block of a library, with the parameters of this instance."""
        instance = {key: str(value) for key, value in instance.items()}
        block = self.block("Reference", name, ports=ports, SourceBlock=source, SourceType=kind)
        block.instance = instance
        return block

    def function(self, name, script, inputs=("u",), outputs=("y",), data=None, **settings):
        """A MATLAB Function; `data` are names with their scopes, `settings` those of its chart."""
        inner = self.subsystem(name, SFBlockType="MATLAB Function")
        for port in inputs:
            inner.inport(port)
        for port in outputs:
            inner.outport(port)
        self.blocks[-1].script = script
        self.blocks[-1].data, self.blocks[-1].settings = data or {}, settings
        return self.blocks[-1]

    def chart(self, name, chart, inputs=("u",), outputs=("y",)):
        """A Stateflow chart, with a trigger port where it has events from outside."""
        block = self.function(name, "", inputs, outputs)
        if any(scope == "INPUT_EVENT" for _, scope, *_ in chart.events):
            block.system.block("TriggerPort", "Trigger")
        block.parameters["SFBlockType"] = "Chart"
        block.chart = chart
        return block

    def line(self, source, *ends, name=""):
        """A line from a block to one or several."""
        self.wires.append(Wire(_end(source, "out") if source else None, [_end(end, "in") for end in ends], name))

    def chain(self, *names):
        """Lines from each block to the next, first port to first port."""
        for source, end in pairwise(names):
            self.line(source, end)

    def between(self, inputs, name, outputs=()):
        """Inports of these names into a block, and outports behind it, in the order of its ports."""
        for at, one in enumerate(inputs, 1):
            self.inport(one)
            self.line(one, f"{name}:{at}")
        for at, one in enumerate(outputs, 1):
            self.outport(one)
            self.line(f"{name}:{at}", one)

    def every(self):
        for block in self.blocks:
            yield self, block
            if block.system is not None:
                yield from block.system.every()


def _end(written, usual):
    if "#" in written:
        name, _, kind = written.rpartition("#")
        return name, kind, 1
    name, colon, number = written.rpartition(":")
    return (name, usual, int(number)) if colon and number.isdigit() else (written, usual, 1)


class Model(System):
    """A model, or with kind="Library" a library. `defaults` are by block type; `code` fills the model workspace.

    `configuration` names one that is kept elsewhere. `records` are binary data by tag, to which a field refers by a
    `Reference`.
    """

    def __init__(
        self,
        name="model",
        *,
        kind="Model",
        solver="ode4",
        step="0.01",
        start="0.0",
        stop="10.0",
        release="R2018b",
        callbacks=None,
        code="",
        workspace=b"",
        dictionary="",
        defaults=None,
        sids=True,
        configuration="",
    ):
        self.configuration = configuration
        self.count = 0
        super().__init__(self)
        self.name, self.kind, self.release, self.sids = name, kind, release, sids
        self.solver = {"StartTime": start, "StopTime": stop, "FixedStep": step, "SolverName": solver}
        self.callbacks, self.code, self.workspace = callbacks or {}, code, workspace
        self.dictionary, self.defaults = dictionary, defaults or {}
        self.records = {}

    def number(self):
        self.count += 1
        return self.count

    def written(self, layout):
        """The bytes of the file in a layout."""
        if layout == "mdl":
            return _classic(self).encode("utf-8")
        parts = _parts(self, separate=layout != "slx inline")
        if layout == "slx json":
            parts = _json_parts(self, parts)
        return _text_package(parts, self.release) if layout == "mdl package" else zipped(parts)

    def write(self, folder, layout="slx parts"):
        """The path of a file written into a folder, called by the model's name."""
        path = Path(folder) / (self.name + ENDINGS[layout])
        path.write_bytes(self.written(layout))
        return path


def zipped(parts):
    """The zip archive of parts by their names."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return stream.getvalue()


def _text_package(parts, release):
    lines = ["# MathWorks OPC Text Package", "Model {", f'  Version  "{release}"', "}"]
    lines.append(f"__MWOPC_PACKAGE_BEGIN__ {release}")
    for name, content in parts.items():
        if isinstance(content, bytes):
            lines += [f"__MWOPC_PART_BEGIN__ /{name} BASE64", base64.b64encode(content).decode()]
        else:
            lines += [f"__MWOPC_PART_BEGIN__ /{name}", content]
    return "\n".join([*lines, "__MWOPC_PACKAGE_END__", ""]).encode("utf-8")


class Reference(str):
    """The value of a field that is a record elsewhere in the file: its tag."""


def _p(name, value):
    if isinstance(value, Reference):
        return f"<P Name={quoteattr(name)} Ref={quoteattr(f'bdmxdata:{value}')}/>"
    return f"<P Name={quoteattr(name)}>{escape(str(value), {chr(13): '&#xD;'})}</P>"


def _attribute(value):
    return quoteattr(value, {"\n": "&#xA;"})


HEAD = '<?xml version="1.0" encoding="utf-8"?>\n'


def _parts(model, separate):
    parts = {"[Content_Types].xml": f"{HEAD}<Types/>"}
    inner = _system_xml(model, "system_root", parts, separate)
    settings = [_p(name, code) for name, code in model.callbacks.items()]
    if model.dictionary:
        settings.append(_p("DataDictionary", model.dictionary))
    if model.code:
        code = _p("WSDataSource", "MATLAB Code") + _p("WSMATLABCode", model.code)
        settings.append(f"<ModelWorkspace>{code}</ModelWorkspace>")
    if model.workspace:
        parts["simulink/modelWorkspace.mxarray"] = model.workspace
    parts |= {f"simulink/bdmxdata/{tag}.mxarray": raw for tag, raw in model.records.items()}
    diagram = f"<{model.kind}>{''.join(settings)}{inner}</{model.kind}>"
    parts["simulink/blockdiagram.xml"] = f'{HEAD}<ModelInformation Version="1.0">{diagram}</ModelInformation>'
    if model.defaults:
        blocks = "".join(
            f"<Block BlockType={quoteattr(kind)}>{''.join(_p(*pair) for pair in settings.items())}</Block>"
            for kind, settings in model.defaults.items()
        )
        table = f"<BlockParameterDefaults>{blocks}</BlockParameterDefaults>"
        parts["simulink/bddefaults.xml"] = f"{HEAD}<BlockDiagramDefaults>{table}</BlockDiagramDefaults>"
    parts["simulink/configSetInfo.xml"] = (
        f'{HEAD}<ConfigSetInfo><ConfigSet PartName="/simulink/configSet0.xml" Active="true">C</ConfigSet>'
        "</ConfigSetInfo>"
    )
    solver = "".join(_p(*pair) for pair in model.solver.items())
    parts["simulink/configSet0.xml"] = (
        f'{HEAD}<ConfigSet><Object ClassName="Simulink.ConfigSet"><Array PropName="Components" Type="Handle">'
        f'<Object ObjectID="2" ClassName="Simulink.SolverCC">{solver}</Object></Array></Object></ConfigSet>'
    )
    if model.configuration:
        name = _p("WSVarName", model.configuration)
        elsewhere = f'<ConfigSet><Object ClassName="Simulink.ConfigSetRef">{name}</Object></ConfigSet>'
        parts["simulink/configSet0.xml"] = HEAD + elsewhere
    release = f"<mwcoreProperties><matlabRelease>{model.release}</matlabRelease></mwcoreProperties>"
    parts["metadata/mwcoreProperties.xml"] = HEAD + release
    _charts_xml(model, parts, separate)
    return parts


def _json_parts(model, parts):
    """The parts with the diagram and its configuration as JSON, as the newest releases write them."""
    diagram = {**model.callbacks, "SimulationSettings": {"SimulationMode": "normal"}, "System": {"Ref": "system_root"}}
    if model.dictionary:
        diagram["DataDictionary"] = model.dictionary
    if model.code:
        diagram["ModelWorkspace"] = {"WSDataSource": "MATLAB Code", "WSMATLABCode": model.code}
    solver = {"_id": "2", "_object_class": "Simulink.SolverCC", "_properties": model.solver}
    components = {"_array_class": "Simulink.ConfigComponent", "_dimensions": [1, 1], "_elements": [solver]}
    configuration = {"_id": "1", "_object_class": "Simulink.ConfigSet", "_properties": {"Components": components}}
    info = [{"Active": True, "ConfigSetName": "C", "PartName": "/simulink/configSet0.json"}]
    kept = {name: part for name, part in parts.items() if not re.match(r"simulink/(blockdiagram|configSet\w+)\.", name)}
    kind = f"application/vnd.mathworks.simulink.{model.kind.lower()}"
    head = f"<mwcoreProperties><contentType>{kind}</contentType><matlabRelease>{model.release}</matlabRelease>"
    return kept | {
        "simulink/blockDiagram.json": json.dumps({"BlockDiagram": diagram}),
        "simulink/configSetInfo.json": json.dumps({"ConfigSetInfo": info}),
        "simulink/configSet0.json": json.dumps(configuration),
        "metadata/mwcoreProperties.xml": f"{HEAD}{head}</mwcoreProperties>",
    }


def _system_xml(system, name, parts, separate):
    inner = "".join(_block_xml(block, parts, separate) for block in system.blocks)
    inner += "".join(_line_xml(wire, {block.name: block.sid for block in system.blocks}) for wire in system.wires)
    if not separate:
        return f"<System>{inner}</System>"
    parts[f"simulink/systems/{name}.xml"] = f"{HEAD}<System>{inner}</System>"
    return f'<System Ref="{name}"/>'


def _block_xml(block, parts, separate):
    inside, counts = [], block.counted()
    if counts is not None and separate:
        inside.append(f"<PortCounts {' '.join(f'{key}={quoteattr(str(n))}' for key, n in counts.items() if n)}/>")
    elif counts is not None:
        inside.append(_p("Ports", _vector(counts)))
    inside += [_p(*pair) for pair in block.parameters.items()]
    for key, texts in block.lists.items():
        cells = "".join(f'<Cell Class="char">{escape(text)}</Cell>' for text in texts)
        inside.append(f'<Array PropName={quoteattr(key)} Type="Cell" Dimension="1*{len(texts)}">{cells}</Array>')
    if block.mask is not None:
        inside.append(_mask_xml(block.mask))
    if block.instance is not None:
        inside.append(f"<InstanceData>{''.join(_p(*pair) for pair in block.instance.items())}</InstanceData>")
    if block.signals and separate:
        ports = "".join(
            f'<Port Type="out" Index="{at}">{_p("Name", name)}</Port>' for at, name in block.signals.items()
        )
        inside.append(f"<PortProperties>{ports}</PortProperties>")
    elif block.signals:
        inside += [f"<Port>{_p('PortNumber', at)}{_p('Name', name)}</Port>" for at, name in block.signals.items()]
    if block.system is not None:
        inside.append(_system_xml(block.system, f"system_{block.sid}", parts, separate))
    names = f'BlockType={quoteattr(block.kind)} Name={_attribute(block.name)} SID="{block.sid}"'
    return f"<Block {names}>{''.join(inside)}</Block>\n"


def _mask_xml(mask):
    text = ' Evaluate="off"'
    parameters = "".join(
        f'<MaskParameter Name={quoteattr(name)} Type="{mask.types.get(name, "edit")}"'
        f"{text if name in mask.texts else ''}>"
        f"<Prompt>{escape(name)}</Prompt><Value>{escape(value)}</Value>{_options_xml(mask, name)}</MaskParameter>"
        for name, value in mask.parameters.items()
    )
    code = f"<Initialization>{escape(mask.initialization)}</Initialization>" if mask.initialization else ""
    return f"<Mask><Type>{escape(mask.type)}</Type>{code}{parameters}</Mask>"


def _options_xml(mask, name):
    options = "".join(f"<Option>{escape(option)}</Option>" for option in mask.options.get(name, ()))
    return f"<TypeOptions>{options}</TypeOptions>" if options else ""


def _line_xml(wire, sids):
    def address(end):
        name, kind, number = end
        return f"{sids[name]}#{kind}" + (f":{number}" if kind in ("in", "out", "lconn", "rconn") else "")

    inside = [_p("Name", wire.name)] if wire.name else []
    if wire.source is not None:
        inside.append(_p("Src", address(wire.source)))
    if len(wire.ends) == 1:
        inside.append(_p("Dst", address(wire.ends[0])))
    else:
        inside.append(_branches(wire.ends, lambda end: _p("Dst", address(end)), "<Branch>{}</Branch>"))
    return f"<Line>{''.join(inside)}</Line>\n"


def _branches(ends, written, form):
    """Branches, the last two of them within a branch of their own, as a wire that forks twice."""
    if len(ends) < 3:
        return "".join(form.format(written(end)) for end in ends)
    return form.format(written(ends[0])) + form.format(_branches(ends[1:], written, form))


def _vector(counts):
    numbers = [counts.get(key, 0) for key in COUNTED]
    while numbers and not numbers[-1]:
        numbers.pop()
    return f"[{', '.join(map(str, numbers))}]"


def _functions(model):
    """The blocks with a chart, each with the path of names to it."""
    return [
        ("/".join(name.replace("/", "//") for name in (*system.path, block.name)), block)
        for system, block in model.every()
        if block.parameters.get("SFBlockType", "NONE") != "NONE"
    ]


def _charts_xml(model, parts, separate):
    functions = _functions(model)
    if not functions:
        return
    charts, instances = [], []
    for path, block in functions:
        number = 1000 + block.sid
        chart = _chart_xml(path, block, number)
        if separate:
            parts[f"simulink/stateflow/chart_{number}.xml"] = HEAD + chart
            chart = f'<chart Ref="chart_{number}"/>'
        charts.append(chart)
        instances.append(f'<instance id="{5000 + block.sid}">{_p("name", path)}{_p("chart", number)}</instance>')
    machine = f'<machine id="1"><Children>{"".join(charts)}</Children></machine>'
    name = "simulink/stateflow/machine.xml" if separate else "simulink/stateflow.xml"
    parts[name] = f"{HEAD}<Stateflow>{machine}{''.join(instances)}</Stateflow>"


def _chart_xml(path, block, number):
    if block.chart is None:
        code = f"<eml>{_p('isEML', 1)}{_p('script', block.script)}</eml>"
        content = f'<state SSID="1">{_p("labelString", "eML_blk_kernel()")}{_p("type", "FUNC_STATE")}{code}</state>'
        kind = _p("type", "EML_CHART") + _p("actionLanguage", 2)
        kind += "".join(_p(*pair) for pair in block.settings.items())
        content += "".join(
            f'<data SSID="{at}" name={quoteattr(name)}>{_p("scope", scope)}</data>'
            for at, (name, scope) in enumerate(block.data.items(), 2)
        )
    else:
        content, kind = _content_xml(block.chart), "".join(_p(*pair) for pair in block.chart.written().items())
    return f'<chart id="{number}">{_p("name", path)}{kind}<Children>{content}</Children></chart>'


def _content_xml(chart, holder=""):
    """Contents of a state, and of all states below it."""
    ids, content = chart.ids(), []
    for name in (one for one in chart.states if chart.parents.get(one, "") == holder):
        code = chart.functions.get(name)
        inside = _p("labelString", chart.states[name]) + "".join(_p(*pair) for pair in chart.keys(name).items())
        inside += f"<eml>{_p('isEML', 1)}{_p('script', code)}</eml>" if code else ""
        if name in chart.tables:
            inside += _table_xml(chart, name)
        below = _content_xml(chart, name)
        inside += f"<Children>{below}</Children>" if below else ""
        content.append(f'<state SSID="{ids[name]}">{inside}</state>')
    for name in (*chart.junctions, *chart.histories):
        if chart.parents.get(name, "") == holder:
            kind = "HISTORY_JUNCTION" if name in chart.histories else "CONNECTIVE_JUNCTION"
            content.append(f'<junction SSID="{ids[name]}">{_p("type", kind)}</junction>')
    for at, one, order, keys in chart.drawn():
        if chart.holder(one) == holder:
            start = f"<src>{_p('SSID', ids[one[0]]) if one[0] else ''}</src>"
            text = _p("labelString", one[2]) + _p("executionOrder", order)
            text += "".join(_p(key, _links(value, 100)) for key, value in keys.items())
            content.append(
                f'<transition SSID="{100 + at}">{text}{start}<dst>{_p("SSID", ids[one[1]])}</dst></transition>'
            )
    for at, one in enumerate(chart.data, 1):
        name, scope, initial, size, parent = (*one, "", "", "")[:5] if len(one) < 5 else one
        if parent == holder:
            array = f"<array>{_p('size', size)}</array>" if size else ""
            props = f"<props>{array}{_p('initialValue', initial) if initial else ''}</props>"
            kind = _p("dataType", chart.types[name]) if name in chart.types else ""
            content.append(f'<data SSID="{200 + at}" name={quoteattr(name)}>{_p("scope", scope)}{props}{kind}</data>')
    for at, one in enumerate(chart.events, 1):
        name, scope, trigger, parent = (*one, "")[:4]
        if parent == holder:
            keys = _p("name", name) + _p("scope", scope) + _p("trigger", trigger)
            content.append(f'<event SSID="{300 + at}">{keys}</event>')
    return "".join(content)


def _table_xml(chart, name):
    """A truth table; that of a Truth Table block as R2020b writes it, else in the older layout."""
    rows, actions, is_matlab = chart.tables[name]
    if chart.settings.get("type") != "TRUTHTABLE_CHART":
        keys = "".join(_p(*pair) for pair in chart.truth_table(name).items())
        return (f"<eml>{_p('isEML', 1)}</eml>" if is_matlab else "") + f"<truthTable>{keys}</truthTable>"
    arrays = ""
    for key, array in (("predicateArray", rows), ("actionArray", actions)):
        texts = [text for column in zip(*array, strict=True) for text in column]
        cells = "".join(f'<Cell Class="char">{escape(text)}</Cell>' for text in texts)
        arrays += f'<Array PropName="{key}" Type="Cell" Dimension="{len(array)}*{len(array[0])}">{cells}</Array>'
    return f"<truthTable>{_p('isTruthTable', 1)}{_p('useEML', int(is_matlab))}{arrays}</truthTable>"


def _quoted(text):
    text = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n").replace("\t", "\\t")
    pieces = [text[at : at + 60] for at in range(0, len(text), 60)] or [""]
    for at in range(len(pieces) - 1):  # an escape is never torn apart
        while (len(pieces[at]) - len(pieces[at].rstrip("\\"))) % 2:
            pieces[at], pieces[at + 1] = pieces[at][:-1], "\\" + pieces[at + 1]
    return "\n".join(f'"{piece}"' for piece in pieces)


def _braces(kind, *content):
    inside = "\n".join(line for part in content for line in part.split("\n"))
    return f"{kind} {{\n{inside}\n}}"


def _key(name, value):
    return f"{name}\t{_quoted(str(value))}"


def _classic(model):
    number = {"Version": "8.5", "SavedCharacterEncoding": "UTF-8"}
    content = [_key("Name", model.name), *(f"{key} {value}" for key, value in number.items())]
    content += [_key(*pair) for pair in model.callbacks.items()]
    if model.dictionary:
        content.append(_key("DataDictionary", model.dictionary))
    if model.code:
        content += [_key("WSDataSource", "MATLAB Code"), _key("WSMATLABCode", model.code)]
    if model.workspace:
        content.append(_key("WSMdlFileData", "DataTag0"))
    solver = _braces("Simulink.SolverCC", "$ObjectID 8", *(_key(*pair) for pair in model.solver.items()))
    configuration = _braces("Simulink.ConfigSet", "$ObjectID 7", _braces("Array", 'Type "Handle"', solver))
    if model.configuration:
        configuration = _braces("Simulink.ConfigSetRef", "$ObjectID 7", _key("WSVarName", model.configuration))
    content.append(_braces("Array", 'Type "Handle"', configuration, 'PropName "ConfigurationSets"'))
    content.append(_braces("Simulink.ConfigSet", '$PropName "ActiveConfigurationSet"', "$ObjectID 7"))
    if model.defaults:
        blocks = (
            _braces("Block", f"BlockType {kind}", *(_key(*pair) for pair in settings.items()))
            for kind, settings in model.defaults.items()
        )
        content.append(_braces("BlockParameterDefaults", *blocks))
    content.append(_system_braces(model))
    sections = [_braces(model.kind, *content)]
    records = ({"DataTag0": model.workspace} if model.workspace else {}) | model.records
    if records:
        written = [_braces("DataRecord", f"Tag {tag}", _key("Data", uuencoded(raw))) for tag, raw in records.items()]
        sections.append(_braces("MatData", f"NumRecords {len(records)}", *written))
    if _functions(model):
        sections.append(_stateflow_braces(model))
    return "\n".join(sections) + "\n"


def uuencoded(raw):
    """Six bits a character above the blank."""
    raw += b"\0" * (-len(raw) % 3)
    words = (int.from_bytes(raw[at : at + 3], "big") for at in range(0, len(raw), 3))
    return "".join(chr(32 + (word >> shift & 63)) for word in words for shift in (18, 12, 6, 0))


def _system_braces(system):
    lines = [_line_braces(wire) for wire in system.wires]
    return _braces("System", *(_block_braces(block, system.model.sids) for block in system.blocks), *lines)


def _block_braces(block, sids):
    content, counts = [f"BlockType {block.kind}", _key("Name", block.name)], block.counted()
    if sids:
        content.append(_key("SID", block.sid))
    if counts is not None:
        content.append(f"Ports {_vector(counts)}")
    content += [_key(*pair) for pair in (block.parameters | (block.instance or {})).items()]
    for key, texts in block.lists.items():
        cells = [_key("Cell", text) for text in texts]
        content.append(_braces("Array", 'Type "Cell"', f"Dimension {len(texts)}", *cells, _key("PropName", key)))
    if block.mask is not None:
        content.append(_mask_braces(block.mask))
    content += [_braces("Port", f"PortNumber {at}", _key("Name", name)) for at, name in block.signals.items()]
    if block.system is not None:
        content.append(_system_braces(block.system))
    return _braces("Block", *content)


def _mask_braces(mask):
    parameters = [
        _braces(
            "Object",
            "$ObjectID 9",
            _key("Name", name),
            _key("Value", value),
            _key("Type", mask.types.get(name, "edit")),
            *_options_braces(mask, name),
            f'Evaluate "{"off" if name in mask.texts else "on"}"',
            _key("Prompt", name),
        )
        for name, value in mask.parameters.items()
    ]
    head = ['$PropName "MaskObject"', '$ClassName "Simulink.Mask"', _key("Type", mask.type)]
    if mask.initialization:
        head.append(_key("Initialization", mask.initialization))
    array = _braces("Array", 'Type "Simulink.MaskParameter"', *parameters, 'PropName "Parameters"')
    return _braces("Object", *head, *([array] if parameters else []))


def _options_braces(mask, name):
    cells = [_key("Cell", option) for option in mask.options.get(name, ())]
    return (
        [_braces("Array", 'Type "Cell"', f"Dimension {len(cells)}", *cells, 'PropName "TypeOptions"')] if cells else []
    )


def _line_braces(wire):
    def side(name, end):
        block, kind, number = end
        port = number if kind in ("in", "out") else kind
        return f"{name}Block {_quoted(block)}\n{name}Port {port}"

    content = [_key("Name", wire.name)] if wire.name else []
    if wire.source is not None:
        content.append(side("Src", wire.source))
    if len(wire.ends) == 1:
        content.append(side("Dst", wire.ends[0]))
    else:
        content.append(_branches(wire.ends, lambda end: side("Dst", end), "Branch {{\n{}\n}}\n").strip())
    return _braces("Line", *filter(None, content))


def _stateflow_braces(model):
    content = [_braces("machine", "id 1")]
    for path, block in _functions(model):
        chart, base = 1000 + block.sid, 10_000 * block.sid
        kind = ["type EML_CHART", "actionLanguage 2"]
        if block.chart is not None:
            kind = [f"{key} {_bare(value)}" for key, value in block.chart.written().items()]
        kind += [_key(*pair) for pair in block.settings.items()]
        content.append(_braces("chart", f"id {chart}", _key("name", path), *kind))
        content += _function_braces(block, chart, base) if block.chart is None else _flat(block.chart, chart, base)
        content.append(_braces("instance", f"id {base + 9000}", _key("name", path), f"chart {chart}"))
    return _braces("Stateflow", *content)


def _function_braces(block, chart, base):
    code = _braces("eml", "isEML 1", _key("script", block.script))
    label = _key("labelString", "eML_blk_kernel()")
    tree = f"treeNode [{chart} 0 0 0]"
    state = _braces("state", f"id {base + 1}", "ssIdNumber 1", label, tree, f"chart {chart}", "type FUNC_STATE", code)
    link = f"linkNode [{chart} 0 0]"
    return [state] + [
        _braces("data", f"id {base + at}", f"ssIdNumber {at}", _key("name", name), f"scope {scope}", link)
        for at, (name, scope) in enumerate(block.data.items(), 2)
    ]


def _bare(value):
    return value if re.fullmatch(r"\w+", value) else _quoted(value)


def _links(value, base):
    """A key of a piece of a transition: its links to others by number, or its type."""
    if isinstance(value, list):
        return f"[{' '.join(str(base + number if number else 0) for number in value)}]"
    return base + value if isinstance(value, int) else value


def _flat(drawn, chart, base):
    ids = {"": chart, **{name: base + number for name, number in drawn.ids().items()}}
    content = []
    for name, text in drawn.states.items():
        number, code = ids[name], drawn.functions.get(name)
        tree = f"treeNode [{ids[drawn.parents.get(name, '')]} 0 0 0]"
        keys = [f"{key} {value}" for key, value in drawn.keys(name).items()]
        head = [f"id {number}", f"ssIdNumber {number - base}", _key("labelString", text), tree, f"chart {chart}"]
        parts = [_braces("eml", "isEML 1", _key("script", code))] if code else []
        if name in drawn.tables:
            table = (_key(*pair) for pair in drawn.truth_table(name).items())
            parts += [_braces("eml", "isEML 1")] * drawn.tables[name][2] + [_braces("truthTable", *table)]
        content.append(_braces("state", *head, *keys, *parts))
    for name in (*drawn.junctions, *drawn.histories):
        kind = "HISTORY_JUNCTION" if name in drawn.histories else "CONNECTIVE_JUNCTION"
        head = [f"id {ids[name]}", f"ssIdNumber {ids[name] - base}", f"type {kind}", f"chart {chart}"]
        content.append(_braces("junction", *head, f"linkNode [{ids[drawn.parents.get(name, '')]} 0 0]"))
    for at, one, order, keys in drawn.drawn():
        start = _braces("src", f"id {ids[one[0]]}") if one[0] else _braces("src", "intersection [0 0 0 0]")
        end = _braces("dst", f"id {ids[one[1]]}")
        head = [
            f"id {base + 100 + at}",
            f"ssIdNumber {100 + at}",
            _key("labelString", one[2]),
            f"executionOrder {order}",
            *(f"{key} {_links(value, base + 100)}" for key, value in keys.items()),
        ]
        link = f"linkNode [{ids[drawn.holder(one)]} 0 0]"
        content.append(_braces("transition", *head, start, end, f"chart {chart}", link))
    for at, one in enumerate(drawn.data, 1):
        name, scope, initial, size, parent = (*one, "", "", "")[:5] if len(one) < 5 else one
        array = [_braces("array", _key("size", size))] if size else []
        props = _braces("props", *array, *([_key("initialValue", initial)] if initial else []))
        head = [f"id {base + 200 + at}", f"ssIdNumber {200 + at}", _key("name", name), f"scope {scope}"]
        head += [_key("dataType", drawn.types[name])] if name in drawn.types else []
        content.append(_braces("data", *head, *([props] if array or initial else []), f"linkNode [{ids[parent]} 0 0]"))
    for at, one in enumerate(drawn.events, 1):
        name, scope, trigger, parent = (*one, "")[:4]
        head = [f"id {base + 300 + at}", f"ssIdNumber {300 + at}", _key("name", name), f"scope {scope}"]
        content.append(_braces("event", *head, f"trigger {trigger}", f"linkNode [{ids[parent]} 0 0]"))
    return content
