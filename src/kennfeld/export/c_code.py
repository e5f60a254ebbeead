"""C99 of a function: a header with its types, and a source with its values and one step."""

from collections.abc import Iterable, Sequence
from textwrap import wrap

from kennfeld.export.c_arithmetic import CArithmetic
from kennfeld.export.c_functions import CFunctions
from kennfeld.export.c_step import StepWriter
from kennfeld.export.c_tangent import tangent_declaration, write_tangent
from kennfeld.export.prepared import ExportedSignal, ParameterValues, Precision, PreparedFunction, comment_text

WIDTH = 100
INT32_MIN = -(2**31)


def write_c(function: PreparedFunction, precision: Precision = "double", *, tangent: bool = False) -> dict[str, str]:
    """Return the texts of header and source by their file names; equal functions give equal texts.

    With `tangent`, there is a function of directional derivatives.
    """
    name, arithmetic = function.name, CArithmetic(precision)
    header, source = _header(function, arithmetic, tangent), _source(function, arithmetic, tangent)
    return {f"{name}.h": header, f"{name}.c": source}


def _header(function: PreparedFunction, arithmetic: CArithmetic, tangent: bool) -> str:
    name, kind = function.name, arithmetic.precision
    guard = f"{name.upper()}_H"
    lines = [
        *_head(function),
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        "#include <stdint.h>",
        "",
        "#ifdef __cplusplus",
        'extern "C" {',
        "#endif",
        "",
        *_struct(f"{name}_parameters", "Calibration values", (_parameter_member(p, kind) for p in function.parameters)),
        *_struct(f"{name}_states", "Memory; see the source", _state_members(function, kind)),
        *_struct(f"{name}_inputs", "Inputs of a step", (_signal_member(u, kind) for u in function.inputs)),
        *_struct(f"{name}_outputs", "Outputs of a step", (_signal_member(y, kind) for y in function.outputs)),
        "/* The calibration that was exported */",
        f"extern const {name}_parameters {name}_defaults;",
        "",
        "/* Forgets the past: the next step is the first one */",
        f"void {name}_init({name}_states *s);",
        "",
        "/* Computes the outputs of one sample, and remembers what the next one needs */",
        f"void {name}_step(const {name}_parameters *p, {name}_states *s, const {name}_inputs *u, {name}_outputs *y);",
        "",
        *(tangent_declaration(name) if tangent else ()),
        "#ifdef __cplusplus",
        "}",
        "#endif",
        "",
        "#endif",
    ]
    return "\n".join(lines) + "\n"


def _head(function: PreparedFunction) -> list[str]:
    return [f"/* {comment_text(function.title)}, exported by Kennfeld */", ""]


def _struct(name: str, comment: str, members: Iterable[str]) -> list[str]:
    # a struct without members is not C99
    own = list(members) or ["    uint8_t none;"]
    return [f"/* {comment} */", "typedef struct {", *own, f"}} {name};", ""]


def _parameter_member(parameter: ParameterValues, kind: str) -> str:
    size = f"[{parameter.values.size}]" if parameter.shape else ""
    named = "" if parameter.name == parameter.member else parameter.name
    layout = " x ".join(map(str, parameter.shape)) + " values, row by x" if len(parameter.shape) > 1 else ""
    unit, scale = f"[{parameter.unit}]" * bool(parameter.unit), ""
    if parameter.stored is not None:
        kind, scale = parameter.stored.kind, _conversion_text(parameter.stored.scale)
    note = comment_text(", ".join(filter(None, [named, unit, scale, layout, parameter.remark])))
    return f"    {kind} {parameter.member}{size};" + (f" /* {note} */" if note else "")


def _conversion_text(scale: tuple[float, float, float]) -> str:
    """Return the conversion of stored numbers.

    >>> _conversion_text((3.0, -40.0, 4.0))
    'value = (3 * number - 40) / 4'
    """
    factor, shift, divisor = (repr(part).removesuffix(".0") for part in scale)
    product = "number" if factor == "1" else f"{factor} * number"
    sign = "-" if shift.startswith("-") else "+"
    total = product if scale[1] == 0 else f"{product} {sign} {shift.removeprefix('-')}"
    if divisor == "1":
        return "" if total == "number" else f"value = {total}"
    return f"value = ({total}) / {divisor}" if " " in total else f"value = {total} / {divisor}"


def _signal_member(signal: ExportedSignal, kind: str) -> str:
    named = "" if signal.name == signal.member else f"{signal.name} "
    note = comment_text(", ".join(filter(None, [f"{named}[{signal.unit}]" if signal.unit else named, signal.remark])))
    return f"    {kind} {signal.member};" + (f" /* {note} */" if note else "")


def _state_members(function: PreparedFunction, kind: str) -> list[str]:
    lines = []
    for which, state in enumerate(function.states):
        comment = function.comments.get(state.next, "")
        note = f" /* {comment}, {state.latency} steps ago */".replace(", 1 steps", ", 1 step") if comment else ""
        size = f"[{state.latency}]" if state.latency > 1 else ""
        lines.append(f"    {kind} x{which}{size};{note}")
        if state.latency > 1:
            lines.append(f"    int32_t at{which}; /* the oldest of them */")
    return [*lines, "    int32_t fresh; /* 1 before the first step */"] if lines else []


def _source(function: PreparedFunction, arithmetic: CArithmetic, tangent: bool) -> str:
    name = function.name
    functions = CFunctions(name, arithmetic)
    # written first, as they say which functions they call
    start = _start(function, arithmetic, functions) if function.states else []
    step = _step(function, arithmetic, functions)
    step += ["", *write_tangent(function, arithmetic, functions)] if tangent else []
    pragma = ["#if defined(__clang__)", "#pragma STDC FP_CONTRACT OFF", "#endif", ""]
    note = [
        "/* A compiler that fuses sums with products, such as GCC without -std=c99, needs -ffp-contract=off to compute",
        "   the same bits as Kennfeld. Never use -ffast-math: NaN has to stay NaN. */",
        "",
    ]
    lines = [
        *_head(function),
        *note,
        f'#include "{name}.h"',
        "",
        "#include <math.h>",
        "#include <stdbool.h>",
        "#include <stddef.h>",
        "#include <string.h>",
        "",
        *pragma,
        *_axes(function, arithmetic),
        *_scales(function, arithmetic),
        *_defaults(function, arithmetic),
    ]
    return "\n".join(lines) + "\n" + functions.text + "\n".join([*start, *_init(function), *step]) + "\n"


def _axes(function: PreparedFunction, arithmetic: CArithmetic) -> list[str]:
    """Define the breakpoints of axes that are not among the parameters."""
    searched = {
        function.nodes[at].payload.number
        for at in {*function.step_order, *function.start_order}
        if function.nodes[at].op == "position" and function.nodes[at].payload.key is None
    }
    lines = []
    for number in sorted(searched):
        points = function.axes[number]
        if points.size > 1:
            values = _numbers([arithmetic.literal(x) for x in points])
            lines += [f"/* breakpoints of {comment_text(_axis_users(function, number))} */"]
            lines += [f"static const {arithmetic.precision} {function.name}_axis{number}[{points.size}] = {{"]
            lines += [*values, "};", ""]
    return lines


def _axis_users(function: PreparedFunction, number: int) -> str:
    users: dict[str, None] = {}
    for node in function.nodes:
        if node.op == "interpolate":
            letters = [letter for letter, ref in zip("xyzw", node.payload.axes, strict=False) if ref.number == number]
            users.update({f"{node.payload.name} ({letter})": None for letter in letters})
    return ", ".join(users)


def _scales(function: PreparedFunction, arithmetic: CArithmetic) -> list[str]:
    """Define the conversions of stored numbers."""
    lines = []
    for parameter in function.parameters:
        if parameter.stored is not None:
            values = ", ".join(arithmetic.literal(x) for x in parameter.stored.scale)
            name = f"{function.name}_scale_{parameter.member}"
            lines += [f"/* factor, shift and divisor of {comment_text(parameter.name)} */"]
            lines += [f"static const {arithmetic.precision} {name}[3] = {{{values}}};", ""]
    return lines


def _literals(parameter: ParameterValues, arithmetic: CArithmetic) -> list[str]:
    """Return the numbers of a parameter as C writes them."""
    stored = parameter.stored
    if stored is None:
        return [arithmetic.literal(x) for x in parameter.values.ravel()]
    if stored.kind == "float":
        return [CArithmetic("float").literal(x) for x in stored.numbers.ravel()]
    suffix = "U" if stored.kind.startswith("u") else ""
    whole = [int(x) for x in stored.numbers.ravel()]
    # -2147483648 would be the negative of a number that is too large
    return [f"{x}{suffix}" if x != INT32_MIN else "(-2147483647 - 1)" for x in whole]


def _numbers(values: Sequence[str]) -> list[str]:
    return wrap(", ".join(values), WIDTH, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False)


def _defaults(function: PreparedFunction, arithmetic: CArithmetic) -> list[str]:
    lines = [f"const {function.name}_parameters {function.name}_defaults = {{"]
    for parameter in function.parameters:
        values = _literals(parameter, arithmetic)
        end = "" if parameter is function.parameters[-1] else ","
        if not parameter.shape:
            lines.append(f"    {values[0]}{end} /* {comment_text(parameter.name)} */")
            continue
        rows = len(values) if len(parameter.shape) == 1 else parameter.shape[-1]
        lines.append(f"    {{ /* {comment_text(parameter.name)} */")
        for first in range(0, len(values), rows):
            row = ", ".join(values[first : first + rows])
            row = row if first + rows >= len(values) else f"{row},"
            lines += wrap(row, WIDTH, initial_indent=" " * 8, subsequent_indent=" " * 8, break_on_hyphens=False)
        lines.append(f"    }}{end}")
    return [*lines, *([] if function.parameters else ["    0"]), "};", ""]


def _start(function: PreparedFunction, arithmetic: CArithmetic, functions: CFunctions) -> list[str]:
    """Write the function that sets all states to their first values."""
    writer = StepWriter(function, arithmetic, functions)
    writer.compute(function.start_order)
    name = function.name
    stores = []
    for which, (state, at) in enumerate(zip(function.states, function.starts, strict=True)):
        value = writer.value(at)
        if state.latency == 1:
            stores.append(f"    s->x{which} = {value};")
        else:
            stores.append(f"    for (i = 0; i < {state.latency}; i++) {{")
            stores += [f"        s->x{which}[i] = {value};", "    }", f"    s->at{which} = 0;"]
    head = f"static void {name}_start(const {name}_parameters *p, {name}_states *s, const {name}_inputs *u)"
    counter = ["    int32_t i;"] if any(state.latency > 1 for state in function.states) else []
    unused = _unused(writer.lines + stores, ("p", "u"))
    body = [*counter, *writer.lines, "", *unused, *stores, "    s->fresh = 0;"]
    return ["/* first values of the memory */", head, "{", *body, "}", ""]


def _unused(lines: Sequence[str], pointers: Sequence[str]) -> list[str]:
    text = "\n".join(lines)
    return [f"    (void){each};" for each in pointers if f"{each}->" not in text]


def _init(function: PreparedFunction) -> list[str]:
    name = function.name
    fresh = ["    s->fresh = 1;"] if function.states else []
    head = f"void {name}_init({name}_states *s)"
    return [head, "{", "    (void)memset(s, 0, sizeof(*s));", *fresh, "}", ""]


def _step(function: PreparedFunction, arithmetic: CArithmetic, functions: CFunctions) -> list[str]:
    writer, name = StepWriter(function, arithmetic, functions), function.name
    writer.compute(function.step_order)
    outputs = [
        f"    y->{signal.member} = {writer.value(root)};"
        for signal, root in zip(function.outputs, function.roots, strict=True)
    ]
    stores = []
    for which, state in enumerate(function.states):
        value = writer.value(state.next)
        if state.latency == 1:
            stores.append(f"    s->x{which} = {value};")
        else:
            at = f"s->at{which}"
            stores += [
                f"    s->x{which}[{at}] = {value};",
                f"    {at} = ({at} < {state.latency - 1}) ? ({at} + 1) : 0;",
            ]
    parameters = f"const {name}_parameters *p, {name}_states *s, const {name}_inputs *u, {name}_outputs *y"
    first = ["    if (s->fresh != 0) {", f"        {name}_start(p, s, u);", "    }"] if function.states else []
    # a declaration after a statement is C99; what is not read would be a warning
    unused = _unused([*first, *writer.lines, *outputs, *stores], ("p", "s", "u")) if not function.states else []
    body = [*unused, *first, *writer.lines, "", *outputs, *stores]
    return [f"void {name}_step({parameters})", "{", *body, "}"]
