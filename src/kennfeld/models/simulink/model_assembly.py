"""Names of nodes: outports, then the names of signals, then the paths of blocks; each name means one thing."""

from kennfeld.graph import CLOCK
from kennfeld.models.simulink.flattening.flat_model import SINK_TYPES, FlatBlock, FlatModel
from kennfeld.models.simulink.lowering.compiler import BlockCompiler
from kennfeld.models.simulink.reader.block_ports import port_label
from kennfeld.models.simulink.signals import leaf_signals

__all__ = ["NodeNames"]

RESULTS = ("Outport", "ToWorkspace", *SINK_TYPES)


class NodeNames:
    """`visible` are the nodes by name, `outputs` those of outports, `units` and `places` what is known of names."""

    def __init__(self, compiler: BlockCompiler, flat: FlatModel) -> None:
        self.compiler = compiler
        self.visible: dict[str, int] = {}
        self.units: dict[str, str] = {}
        self.places: dict[str, str] = {}
        self._taken = {*compiler.inputs, *compiler.declared.parameters, *CLOCK}
        self._inputs = {node for name in compiler.inputs for node in [compiler.builder.input(name)]}
        outputs: list[str] = []
        for atom in flat.results:
            for number, label in _results(atom) if compiler.outputs(atom) else ():
                outputs += self._add(atom, number, label)
        self.outputs = tuple(dict.fromkeys(outputs))
        self._inside(flat)
        for name, inport in compiler.inputs.items():
            if inport is not None:
                self._said(name, inport)

    def _inside(self, flat: FlatModel) -> None:
        """The signals within: those with a name of their own first."""
        skipped = {"Outport", "Inport", "Constant", "Ground", "Control", "Mux", "Demux", "BusCreator", "BusSelector"}
        skipped |= {"Pass", "Part", "BusElement", "BusElements", *SINK_TYPES}
        shown = [atom for atom in flat.atoms if atom.kind not in skipped and not atom.hidden]
        rest = [atom for atom in shown if self.compiler.outputs(atom)]
        for atom in rest:
            for port, name in atom.names.items():
                if port < len(self.compiler.outputs(atom)):
                    self._add(atom, port, name.strip("<>"), prefer_path=True)
        for atom in rest:
            for port in range(len(self.compiler.outputs(atom))):
                if port not in atom.names:
                    several = len(self.compiler.outputs(atom)) > 1
                    self._add(atom, port, f"{atom.path}:{port + 1}" if several else atom.path)

    def _add(self, atom: FlatBlock, port: int, name: str, prefer_path: bool = False) -> list[str]:
        made = []
        for key, signal in leaf_signals(self.compiler.outputs(atom)[port], name):
            for at, node in enumerate(signal.flat):
                own = key if signal.size == 1 else f"{key}[{at + 1}]"
                if prefer_path and own in self.visible and self.visible[own] != node:
                    own = atom.path if signal.size == 1 else f"{atom.path}[{at + 1}]"
                made.append(self._named(own, node, atom, is_output=atom.kind in RESULTS))
        return made

    def _named(self, name: str, node: int, atom: FlatBlock, is_output: bool) -> str:
        """Give a node a name that is free; the same name for the same node once."""
        if not is_output and (self.compiler.builder.nodes[node].op in ("const", "input") or node in self._inputs):
            return name
        free, number = name, 2
        while free in self._taken or self.visible.get(free, node) != node:
            free, number = (f"{name}.out" if number == 2 else f"{name}.{number - 1}"), number + 1
        self.visible[free] = node
        self._said(free, atom)
        return free

    def _said(self, name: str, atom: FlatBlock) -> None:
        self.places[name] = atom.path
        unit = (atom.block.value("Unit") or "").strip()
        if unit and unit != "inherit" and not any(sign in unit for sign in "]\n\r"):
            self.units[name] = unit


def _results(atom: FlatBlock) -> list[tuple[int, str]]:
    """The signals of an outport, or of a block that records or shows some, with their names."""
    if atom.kind == "Outport":
        return [(0, port_label(atom.block))]
    if atom.kind == "ToWorkspace":
        return [(0, atom.block.value("VariableName") or atom.path)]
    ports = [(port, source) for port, source in enumerate(atom.inputs) if source is not None]
    return [(port, atom.taken.get(port) or source.atom.path) for port, source in ports]
