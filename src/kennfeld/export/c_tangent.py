"""C99 of the directional derivatives of a function."""

from collections.abc import Sequence

from kennfeld.export.c_arithmetic import CArithmetic
from kennfeld.export.c_functions import CFunctions
from kennfeld.export.c_step import StepWriter
from kennfeld.export.prepared import PreparedFunction
from kennfeld.export.tangents import with_tangents
from kennfeld.graph.dense_layer import DenseLayer
from kennfeld.graph.lookup_lowering import AxisRef, ExpansionRef, TableRef


def tangent_declaration(name: str) -> list[str]:
    """Return the declaration of the function, with a comment."""
    return [
        "/* Computes the change dy of the outputs for a change dp and du of parameters and inputs, to first order and",
        "   with the memory before the step as it is */",
        f"void {name}_tangent(const {name}_parameters *p, const {name}_states *before, const {name}_inputs *u,",
        f"    const {name}_parameters *dp, const {name}_inputs *du, {name}_outputs *dy);",
        "",
    ]


def write_tangent(function: PreparedFunction, arithmetic: CArithmetic, functions: CFunctions) -> list[str]:
    """Return the definition of the function."""
    tangents, name = with_tangents(function), function.name
    writer = TangentWriter(tangents.function, arithmetic, functions)
    writer.compute(tangents.order)
    outputs = [
        f"    dy->{signal.member} = {writer.value(root)};"
        for signal, root in zip(function.outputs, tangents.roots, strict=True)
    ]
    text = "\n".join([*writer.lines, *outputs])
    states: list[str] = []
    if "s->" in text:
        start = ["    if (own.fresh != 0) {", f"        {name}_start(p, &own, u);", "    }"]
        states = [f"    {name}_states own = *before;", f"    const {name}_states *s = &own;", "", *start]
    used = "\n".join([*states, text])
    unused = [f"    (void){each};" for each in ("p", "u", "dp", "du") if f"{each}->" not in used]
    if not states:
        unused.append("    (void)before;")
    elif "    (void)p;" in unused:
        unused.remove("    (void)p;")
    if states and "    (void)u;" in unused:
        unused.remove("    (void)u;")
    head = [line.removesuffix(";") for line in tangent_declaration(name)[2:4]]
    return [*head, "{", *states, *unused, *writer.lines, "", *outputs, "}"]


class TangentWriter(StepWriter):
    """Writes nodes and their tangents; `dp` and `du` point to the direction."""

    def _number(self, at: int) -> str:
        op, args, payload = self._function.nodes[at]
        match op, payload:
            case "seed", str():
                return f"du->{self._function.input_member(payload)}"
            case "direction", TableRef():
                return self._table(payload, args, pointer="dp")
            case "slope", (TableRef() as table, int() as axis):
                return self._table(table, args, slope=axis)
            case "cell_slope", AxisRef():
                return self._cell_slope(payload, args)
            case "axis_direction", AxisRef():
                member = self._function.parameter(str(payload.key)).member
                return f"{self._functions.lookup('c')}(dp->{member}, i{args[0]}, f{args[0]})"
            case "expansion_direction", ExpansionRef():
                return self._expansion_direction(payload, args, at)
            case "dense_direction", _:
                return f"{self._layer_direction(payload.layer, args, at)}[{payload.number}]"
        return super()._number(at)

    def _cell_slope(self, axis: AxisRef, args: Sequence[int]) -> str:
        count = self._function.axes[axis.number].size
        if count == 1:
            return self._arithmetic.zero
        kind = "inner_slope" if axis.extrapolation == "clip" else "outer_slope"
        place = f"{self._points(axis)}, i{args[0]}"
        if axis.extrapolation != "clip":
            return f"{self._functions(kind)}({place})"
        return f"{self._functions(kind)}({self.value(args[1])}, {place}, {count})"

    def _expansion_direction(self, ref: ExpansionRef, args: tuple[int, ...], at: int) -> str:
        x, move = self._array(f"x{at}", args[: ref.inputs]), self._array(f"d{at}", args[ref.inputs :])
        member = self._function.parameter(ref.name).member
        arguments = f"p->{member}, {x}, dp->{member}, {move}, {ref.inputs}, {ref.centres}"
        return f"{self._functions.expansion_tangent(ref.kernel)}({arguments})"

    def _layer_direction(self, layer: DenseLayer, args: tuple[int, ...], at: int) -> str:
        if (layer, args) not in self._layers:
            x, move = self._array(f"x{at}", args[: layer.inputs]), self._array(f"d{at}", args[layer.inputs :])
            member = self._function.parameter(layer.name).member
            name = self._functions.layer_tangent(layer.activation)
            leading = f"p->{member}, {layer.inputs}, {layer.outputs}, {self._alpha(layer)}"
            self.lines.append(f"    {self._type} y{at}[{layer.outputs}];")
            self.lines.append(f"    {name}({leading}{x}, dp->{member}, {move}, y{at});")
            self._layers[layer, args] = f"y{at}"
        return self._layers[layer, args]
