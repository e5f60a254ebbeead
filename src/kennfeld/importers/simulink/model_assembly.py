"""Names of graph nodes: outports first, then signal names, then block paths; each name is unique."""

from functools import cached_property

from kennfeld.base.errors import Location
from kennfeld.graph import CLOCK
from kennfeld.importers.simulink.flattening.flat_model import RECORDING_TYPES, SINK_TYPES, FlatBlock, FlatModel
from kennfeld.importers.simulink.lowering.compiler import BlockCompiler
from kennfeld.importers.simulink.open_signals import open_ports
from kennfeld.importers.simulink.reader.block_ports import port_label
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.signals import Bus, leaf_signals

RESULTS = ("Outport", *RECORDING_TYPES, *SINK_TYPES)
_PASSING = ("DataTypeConversion", "RateTransition", "SignalConversion", "SignalSpecification")


class NodeNames:
    """Names of nodes: `visible` nodes by name, `outputs` of outports, `units` and `locations` by name."""

    def __init__(self, compiler: BlockCompiler, flat: FlatModel) -> None:
        self.compiler, self._flat = compiler, flat
        self._ends = frozenset(flat.ends)
        self.visible: dict[str, int] = {}
        self.units: dict[str, str] = {}
        self.locations: dict[str, Location] = {}
        self._taken = {*compiler.inputs, *compiler.declared.parameters, *CLOCK}
        self._inputs = {node for name in compiler.inputs for node in [compiler.builder.input(name)]}
        outputs: list[str] = []
        for flat_block in flat.results:
            for number, label in self._results(flat_block) if compiler.outputs(flat_block) else ():
                outputs += self._add(flat_block, number, label)
        self.outputs = tuple(dict.fromkeys(outputs))
        self._name_inner_signals(flat)
        for name, inport in compiler.inputs.items():
            if inport is not None:
                self._describe(name, inport)
        self.units |= compiler.inputs.units

    @cached_property
    def _needed(self) -> set[int]:
        """The nodes on which outputs depend, in other steps too."""
        nodes, states = self.compiler.builder.nodes, self.compiler.builder.states
        needed, waiting = set[int](), list(map(self.visible.get, self.outputs))
        while waiting:
            node = waiting.pop()
            if node is None or node < 0 or node in needed:
                continue
            needed.add(node)
            op, args, payload = nodes[node]
            waiting += args if op != "state" else (states[payload].init, states[payload].next)
        return needed

    def _open_ports(self, flat: FlatBlock) -> list[int]:
        """Return the outputs of a block that are results because they lead nowhere."""
        return open_ports(self._flat, flat, len(self.compiler.outputs(flat))) if flat in self._ends else []

    def _results(self, flat: FlatBlock) -> list[tuple[int, str]]:
        """Return number and name of the signals of an outport, of a block that records or displays some, or of an end.

        Outputs of a conditional subsystem have the name of their port.
        """
        if flat.type == "Outport":
            return [(0, port_label(flat.block))]
        if flat in self._ends:
            several = len(self.compiler.outputs(flat)) > 1
            names = [(port, flat.output_names.get(port, "").strip("<>")) for port in self._open_ports(flat)]
            return [(port, name or (f"{flat.path}:{port + 1}" if several else flat.path)) for port, name in names]
        if flat.type in RECORDING_TYPES:
            return [(0, flat.block.value("VariableName") or flat.path)]
        ports = [(port, source) for port, source in enumerate(flat.inputs) if source is not None]
        return [(port, flat.input_names.get(port) or source.flat.path) for port, source in ports]

    def _name_inner_signals(self, flat: FlatModel) -> None:
        """Name the inner signals, those with names of their own first."""
        skipped = {"Outport", "Inport", "Constant", "Ground", "Mux", "Demux", "BusCreator", "BusSelector", *SINK_TYPES}
        skipped |= {"BusElement", "BusElements", "ConditionalSubsystem", "IterationCondition", "ForEachPartition"}
        shown = [flat_block for flat_block in flat.blocks if flat_block.type not in skipped and not flat_block.hidden]
        # a node that a block only passes on has the name of the block that computes it
        shown.sort(key=lambda flat_block: flat_block.type in _PASSING)
        rest = [flat_block for flat_block in shown if self.compiler.outputs(flat_block)]
        for flat_block in rest:
            for port, name in flat_block.output_names.items():
                if port < len(self.compiler.outputs(flat_block)):
                    self._add(flat_block, port, name.strip("<>"), prefer_path=True)
        for flat_block in rest:
            for port in range(len(self.compiler.outputs(flat_block))):
                if port not in flat_block.output_names:
                    is_vector = len(self.compiler.outputs(flat_block)) > 1
                    self._add(flat_block, port, f"{flat_block.path}:{port + 1}" if is_vector else flat_block.path)

    def _add(self, flat: FlatBlock, port: int, name: str, prefer_path: bool = False) -> list[str]:
        names = []
        wired, is_output = self.compiler.outputs(flat)[port], flat.type in RESULTS or port in self._open_ports(flat)
        for key, signal in leaf_signals(wired, name):
            for at, node in enumerate(signal.flat):
                # of a bus within the model, which may hold hundreds of signals, only those that an output needs
                if isinstance(wired, Bus) and not is_output and node not in self._needed:
                    continue
                own = key if signal.size == 1 else f"{key}[{at + 1}]"
                # of two signals of one name, the later one takes the path of its block
                if prefer_path and own in self.visible and self.visible[own] != node:
                    own = flat.path if signal.size == 1 else f"{flat.path}[{at + 1}]"
                names.append(self._assign(own, node, flat, is_output))
        return names

    def _assign(self, name: str, node: int, flat: FlatBlock, is_output: bool) -> str:
        """Give a node a free name, or the same name if it already has it."""
        if not is_output and (self.compiler.builder.nodes[node].op in ("const", "input") or node in self._inputs):
            return name
        free, number = name, 2
        while free in self._taken or self.visible.get(free, node) != node:
            free, number = (f"{name}.out" if number == 2 else f"{name}.{number - 1}"), number + 1
        self.visible[free] = node
        self._describe(free, flat)
        return free

    def _describe(self, name: str, flat: FlatBlock) -> None:
        self.locations[name] = Location(path=flat.path)
        unit = (flat.block.value("Unit") or "").strip()
        if unit and match_word(unit, ["inherit"]) is None and not any(sign in unit for sign in "]\n\r"):
            self.units[name] = unit
