"""C functions compiled by the C compiler of the system, as a reference for those that Kennfeld translates.

The file is included in a program that reads inputs and prints outputs, a line for each call. `float` is compiled as
`double`, as Kennfeld computes it.
"""

import copy
import re
import shutil
import subprocess
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
from pycparser import c_ast
from pycparser.c_generator import CGenerator

from kennfeld.importers.c.declarations import RESULT
from kennfeld.importers.c.interface import CNumbers, result_numbers
from kennfeld.importers.c.number_types import KNOWN_TYPES
from kennfeld.importers.c.preprocessing import data_file
from kennfeld.importers.c.reading import CSourceFile
from kennfeld.importers.c.struct_types import HIDDEN, CStructType, ObjectType, Sizes
from kennfeld.importers.c.translated import TranslatedFunction

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
_OPTIONS = (
    "-O1",
    "-no-pie",
    "-fno-pie",
    "-fwrapv",
    "-fno-strict-aliasing",
    "-ffp-contract=off",
    "-w",
    "-D_GNU_SOURCE",
    "-Dfloat=double",
)
_LINKED = "-Wl,--unresolved-symbols=ignore-all"  # of other functions in the file
# functions of floats, whose declarations take doubles under the options above: each needs its sibling of doubles
_SINGLE = (
    "sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh exp exp2 expm1 log log2 log10 log1p sqrt cbrt floor "
    "ceil round trunc rint nearbyint fabs pow atan2 hypot fmin fmax fmod fdim fma copysign "
    "remainder ldexp scalbn scalbln frexp modf logb ilogb erf exp10 sincos lround lrint llround llrint"
)
_SUFFIX = re.compile(r"(?<![\w.])((?:\d+\.\d*|\.\d+|\d+)(?:[eE][+-]?\d+)?)[fF]\b")
_ERROR = re.compile(r"^[ \t]*#[ \t]*error\b(?:.*\\\n)*.*$", re.MULTILINE)  # tests of the sizes of types
_SECONDS = 60


class NotCompiledError(Exception):
    """The compiler or the program refuses; the text tells why."""


def reference(file: CSourceFile, function: TranslatedFunction, inputs: np.ndarray, folder: Path) -> np.ndarray:
    """Return the outputs of calls one after the other.

    Args:
        file: the C file.
        function: the function as it was translated, which names inputs and outputs.
        inputs: Float[calls, inputs].
        folder: folder for the program.

    Returns:
        Float[calls, outputs].
    """
    for source in (*file.path.parent.glob("*.c"), *file.path.parent.glob("*.h")):
        text = source.read_text(encoding="utf-8", errors="replace")
        (folder / source.name).write_text(_ERROR.sub("", _SUFFIX.sub(r"\1", text)))
    for name in file.source.missing:
        if ".." not in name and not name.startswith("/"):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text("#include <math.h>\n#include <stdint.h>\n")
    if "rtwtypes.h" in file.source.missing:
        (folder / "rtwtypes.h").write_text(_known_types())
    unions = [(n.root.name, *union) for n in function.interface.inputs for union in n.leaf.unions]
    if len({union[:2] for union in unions}) < len(set(unions)):
        raise NotCompiledError("several members of a union are inputs, which overlap")
    (folder / "driver_of_function.c").write_text(_driver(file, function))
    program = folder / "program"
    renamed = [f"-D{name}f={name}" for name in _SINGLE.split()]
    command = [
        str(COMPILER),
        *_OPTIONS,
        *renamed,
        "-o",
        str(program),
        str(folder / "driver_of_function.c"),
        "-lm",
        _LINKED,
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise NotCompiledError(next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[:200]))
    text = "\n".join(" ".join(map(repr, row)) for row in inputs.tolist())
    ran = subprocess.run(
        [str(program), str(len(inputs))], input=text, capture_output=True, text=True, timeout=_SECONDS, check=False
    )
    rows = [list(map(float, line.split()[1:])) for line in ran.stdout.splitlines() if line.startswith("@row ")]
    if ran.returncode or len(rows) < len(inputs):
        raise NotCompiledError(f"the program ends with status {ran.returncode}")
    return np.array(rows)


def _known_types() -> str:
    lines = ["#pragma once", "#include <math.h>", "#include <stdint.h>", "#include <stdbool.h>", "#include <stddef.h>"]
    standard = {"double_t", "float_t", "bool", "size_t", "ptrdiff_t", "intptr_t"}
    for name, kind in KNOWN_TYPES.items():
        if name in standard or re.fullmatch(r"u?int(_fast|_least)?\d+(_least)?_t", name):
            continue
        base = (
            "char"
            if kind.name == "char"
            else "double"
            if kind.word is None
            else f"{'' if kind.word.signed else 'u'}int{kind.word.bits}_t"
        )
        lines.append(f"typedef {base} {name};")
    lines += ["#define rtIsNaN(x) isnan(x)", "#define rtIsInf(x) isinf(x)", "#define rtIsNaNF(x) isnan(x)"]
    lines += [
        "#define rtIsInfF(x) isinf(x)",
        "#define rtInf INFINITY",
        "#define rtNaN NAN",
        "#define rtMinusInf (-INFINITY)",
    ]
    return "\n".join(lines) + "\n"


def _driver(file: CSourceFile, function: TranslatedFunction) -> str:
    parameters = function.function.tree.decl.type.args
    declared, passed = [], []
    for tree in parameters.params if parameters is not None else []:
        if isinstance(tree, c_ast.Decl):
            sizes = next((a.variable.sizes for a in function.function.arguments if a.variable.name == tree.name), ())
            declared.append(_declaration(tree, sizes[0] if len(sizes) == 1 else 1))
            passed.append(f"argument_{tree.name}")
    linked = [
        line
        for argument in function.function.arguments
        for line in _links(argument.variable.name, argument.variable.type, file, function)
    ]
    call = f"{function.function.name}({', '.join(passed)});"
    returned = function.function.returned
    read = [
        f'if (scanf("%lf", &number_) != 1) return 3; {place} = number_;'
        for n in function.interface.inputs
        for place in _places(n)
    ]
    shown = [place for number in result_numbers(function.function) for place in _places(number)]
    shown += [place for number in function.interface.outputs for place in _places(number)]
    printed = [f'printf(" %.17g", (double)({place}));' for place in shown]
    data = f'#include "{data_file(file.path).name}"' if data_file(file.path).is_file() else ""
    return "\n".join(
        [
            "#include <stdio.h>", "#include <stdlib.h>", "#include <string.h>", "#include <math.h>",
            "#define main main_of_the_file", f'#include "{file.path.name}"', data, "#undef main",
            *declared,
            "int main(int count_, char **words_) {", "double number_; int calls_ = atoi(words_[1]);", *linked,
            "while (calls_-- > 0) {", *read, ("__auto_type result_ = " if returned is not None else "") + call,
            'printf("@row");', *printed, 'printf("\\n");', "}", "return 0;", "}",
        ]
    )  # fmt: skip


def _declaration(tree: c_ast.Decl, size: int) -> str:
    """Return the declaration of a variable that a call passes; behind a pointer it has `size` elements."""
    kind = copy.deepcopy(tree.type)
    waiting = [kind]
    while waiting:
        node = waiting.pop()
        if hasattr(node, "quals"):
            node.quals = []
        if hasattr(node, "declname"):
            node.declname = f"argument_{tree.name}"
        waiting += [
            child for _, child in node.children() if not isinstance(node, c_ast.ArrayDecl) or child is node.type
        ]
    if isinstance(kind, c_ast.PtrDecl):
        kind = c_ast.ArrayDecl(kind.type, c_ast.Constant("int", str(size)), [])
    declaration = c_ast.Decl(f"argument_{tree.name}", [], [], ["static"], [], kind, None, None)
    return f"{CGenerator().visit(declaration)};"


def _links(name: str, kind: ObjectType, file: CSourceFile, function: TranslatedFunction) -> Iterator[str]:
    """Yield statements that set the pointers of a struct to objects: parameters to those that have first values."""
    parameters = {number.leaf.owner[1] for number in function.interface.parameters if number.mode}
    for member in kind.members if isinstance(kind, CStructType) else ():
        if member.declared.is_pointer:
            place = f"argument_{name}[0].{member.name}"
            pointed = getattr(member.declared.type, "name", "")
            values = _variable_of(pointed, file) if pointed in parameters else ""
            yield f"{place} = &{values};" if values else f"{place} = calloc(1, sizeof(*{place}));"


def _variable_of(kind: str, file: CSourceFile) -> str:
    """Return the first variable of a struct that has first values."""
    declarations = file.declarations
    for name, tree in declarations.variables.items():
        if tree.init is not None and getattr(declarations.types.declared(tree).type, "name", "") == kind:
            return name
    return ""


def _places(number: CNumbers) -> list[str]:
    """Return the place of each number as C writes it."""
    root = number.root.name.removeprefix(".")
    text = f"argument_{root}" if number.mode else "result_" if root == RESULT else root
    is_address = number.root.is_pointer and not number.root.sizes
    parts: dict[str, list[str]] = {}
    _walk(number.root.type, number.root.sizes, f"{text}[0]" if is_address else text, "", parts)
    return parts[number.leaf.path]


def _walk(kind: ObjectType, sizes: Sizes, text: str, path: str, parts: dict[str, list[str]]) -> None:
    for place in product(*(range(size) for size in sizes)):
        element = text + "".join(f"[{at}]" for at in place)
        if isinstance(kind, CStructType):
            for name, declared in kind.members if kind.storage is None else (kind.storage,):
                member = "" if name.startswith(HIDDEN) else f".{name}"
                inner = f"(*{element}{member})" if declared.is_pointer else f"{element}{member}"
                if name != kind.tag:
                    _walk(declared.type, declared.sizes, inner, f"{path}{member}", parts)
        else:
            parts.setdefault(path, []).append(element)
