"""Names of nodes: outports, then the names of signals, then the paths of blocks; each name means one thing."""

from kennfeld.graph import CLOCK
from kennfeld.models.simulink.build import Weaver
from kennfeld.models.simulink.flatten import Atom, Flat
from kennfeld.models.simulink.signals import leaves

__all__ = ["Names"]

_OUTPUTS = ("Outport", "ToWorkspace", "Shown")
_WIRES = ("Outport", "Shown", "Inport", "Constant", "Ground", "Control", "Mux", "Demux", "BusCreator", "BusSelector")


class Names:
    """`visible` are the nodes by name, `outputs` those of outports, `units` and `places` what is known of names."""

    def __init__(self, weaver: Weaver, flat: Flat) -> None:
        self.weaver = weaver
        self.visible: dict[str, int] = {}
        self.units: dict[str, str] = {}
        self.places: dict[str, str] = {}
        self._taken = {*weaver.inputs, *weaver.declared.parameters, *CLOCK}
        self._inputs = {node for name in weaver.inputs for node in [weaver.loom.input(name)]}
        outputs: list[str] = []
        for atom in flat.outports or [atom for atom in flat.atoms if atom.kind in ("ToWorkspace", "Shown")]:
            for port in range(len(weaver.outputs(atom))):
                outputs += self._add(atom, port, _output_name(atom, port))
        self.outputs = tuple(dict.fromkeys(outputs))
        self._inside(flat)
        for name, inport in weaver.inputs.items():
            if inport is not None:
                self._said(name, inport)

    def _inside(self, flat: Flat) -> None:
        """The signals within: those with a name of their own first."""
        rest = [atom for atom in flat.atoms if atom.kind not in _WIRES and self.weaver.outputs(atom)]
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
                made.append(self._named(own, node, atom, is_output=atom.kind in _OUTPUTS))
        return made

    def _named(self, name: str, node: int, atom: Atom, is_output: bool) -> str:
        """Give a node a name that is free; the same name for the same node once."""
        if not is_output and (self.weaver.loom.nodes[node].op in ("const", "input") or node in self._inputs):
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


def _output_name(atom: Atom, port: int) -> str:
    if atom.kind == "Shown":
        source = atom.inputs[port]
        return atom.taken.get(port) or (source.atom.path if source is not None else atom.path)
    return atom.block.name if atom.kind == "Outport" else (atom.block.value("VariableName") or atom.path)
