"""Names of nodes: outports, then the names of signals, then the paths of blocks; each name means one thing."""

from kennfeld.graph import CLOCK
from kennfeld.models.simulink.flattening.flat_model import SHOWING, Atom, Flat
from kennfeld.models.simulink.lowering.compiler import Weaver
from kennfeld.models.simulink.reader.block_ports import port_label
from kennfeld.models.simulink.signals import leaves

__all__ = ["Names"]

RESULTS = ("Outport", "ToWorkspace", *SHOWING)


class Names:
    """`visible` are the nodes by name, `outputs` those of outports, `units` and `places` what is known of names."""

    def __init__(self, weaver: Weaver, flat: Flat) -> None:
        self.weaver = weaver
        self.visible: dict[str, int] = {}
        self.units: dict[str, str] = {}
        self.places: dict[str, str] = {}
        self._taken = {*weaver.inputs, *weaver.declared.parameters, *CLOCK}
        self._inputs = {node for name in weaver.inputs for node in [weaver.builder.input(name)]}
        outputs: list[str] = []
        for atom in flat.results:
            for number, label in _results(atom) if weaver.outputs(atom) else ():
                outputs += self._add(atom, number, label)
        self.outputs = tuple(dict.fromkeys(outputs))
        self._inside(flat)
        for name, inport in weaver.inputs.items():
            if inport is not None:
                self._said(name, inport)

    def _inside(self, flat: Flat) -> None:
        """The signals within: those with a name of their own first."""
        skipped = {"Outport", "Inport", "Constant", "Ground", "Control", "Mux", "Demux", "BusCreator", "BusSelector"}
        skipped |= {"Pass", "Part", "BusElement", "BusElements", *SHOWING}
        shown = [atom for atom in flat.atoms if atom.kind not in skipped and not atom.hidden]
        rest = [atom for atom in shown if self.weaver.outputs(atom)]
        for atom in rest:
            for port, name in atom.names.items():
                if port < len(self.weaver.outputs(atom)):
                    self._add(atom, port, name.strip("<>"), prefer_path=True)
        for atom in rest:
            for port in range(len(self.weaver.outputs(atom))):
                if port not in atom.names:
                    several = len(self.weaver.outputs(atom)) > 1
                    self._add(atom, port, f"{atom.path}:{port + 1}" if several else atom.path)

    def _add(self, atom: Atom, port: int, name: str, prefer_path: bool = False) -> list[str]:
        made = []
        for key, signal in leaves(self.weaver.outputs(atom)[port], name):
            for at, node in enumerate(signal.flat):
                own = key if signal.size == 1 else f"{key}[{at + 1}]"
                if prefer_path and own in self.visible and self.visible[own] != node:
                    own = atom.path if signal.size == 1 else f"{atom.path}[{at + 1}]"
                made.append(self._named(own, node, atom, is_output=atom.kind in RESULTS))
        return made

    def _named(self, name: str, node: int, atom: Atom, is_output: bool) -> str:
        """Give a node a name that is free; the same name for the same node once."""
        if not is_output and (self.weaver.builder.nodes[node].op in ("const", "input") or node in self._inputs):
            return name
        free, number = name, 2
        while free in self._taken or self.visible.get(free, node) != node:
            free, number = (f"{name}.out" if number == 2 else f"{name}.{number - 1}"), number + 1
        self.visible[free] = node
        self._said(free, atom)
        return free

    def _said(self, name: str, atom: Atom) -> None:
        self.places[name] = atom.path
        unit = (atom.block.value("Unit") or "").strip()
        if unit and unit != "inherit" and not any(sign in unit for sign in "]\n\r"):
            self.units[name] = unit


def _results(atom: Atom) -> list[tuple[int, str]]:
    """The signals of an outport, or of a block that records or shows some, with their names."""
    if atom.kind == "Outport":
        return [(0, port_label(atom.block))]
    if atom.kind == "ToWorkspace":
        return [(0, atom.block.value("VariableName") or atom.path)]
    ports = [(port, source) for port, source in enumerate(atom.inputs) if source is not None]
    return [(port, atom.taken.get(port) or source.atom.path) for port, source in ports]
