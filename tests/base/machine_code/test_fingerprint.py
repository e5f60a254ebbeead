"""The fingerprint of compiled code covers all that determines it."""

import ast
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kennfeld.base.machine_code import fingerprint as module
from kennfeld.base.machine_code.fingerprint import OTHERS, WRITERS, fingerprint, fingerprint_of_text
from kennfeld.graph.derivative import Linearization
from kennfeld.graph.lookup_lowering import AxisRef, TableRef, lower_lookups
from kennfeld.graph.node import Node
from kennfeld.native import kernel as kernels
from kennfeld.native.emitter import MemoryLayout
from kennfeld.native.kernel import Kernel
from kennfeld.native.sample_loop import Output
from kennfeld.native.tape_layout import TapeLayout
from tests.native.models import MODELS, case

ROOT = Path(module.__file__).parents[2]
WRITE = kernels._kernel_code
# modules whose classes and functions the packages use; the content of their objects is in the arguments
DATA = {
    *(
        "base/arrays",
        "base/atomic_files",
        "domain/criteria",
        "base/errors",
        "base/exit_status",
        "base/frozen_dict",
        "domain/free_axes",
        "base/lazy_dataclass",
        "base/lazy_names",
        "base/optional_packages",
        "domain/parameter_set",
    ),
    "domain/axis",
    "domain/parameters",
    "domain/texts",
    "base/threads",
    "base/watch_folder",
}


def arguments(model: str = "lag") -> tuple[Any, ...]:
    """The arguments for the code of a kernel."""
    model_case = case(MODELS[model](), 20)
    lowered = lower_lookups(model_case.graph, model_case.parameters)
    outputs = [Output(lowered.graph.names[c.node], c.scale, c.loss, c.delta) for c in model_case.criteria]
    kernel = Kernel(lowered, outputs, model_case.parameters, model_case.fitted)
    return kernel.line, kernel.layout, kernel.outputs


def test_equal_arguments_have_one_in_every_process() -> None:
    path = [str(Path(__file__).parent), *sys.path]
    code = f"import sys; sys.path[:] = {path!r}; from test_fingerprint import *\n"
    models = ["external", "layers", "static"]
    code += f"print(*(fingerprint(WRITE, arguments(name)) for name in {models}), sep='\\n')"
    expected = [fingerprint(WRITE, arguments(name)) for name in models]
    assert len(set(expected)) == len(models)
    other = "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"
    environment = os.environ | {"PYTHONHASHSEED": other}
    output = subprocess.check_output([sys.executable, "-c", code], env=environment, text=True)
    assert output.splitlines() == expected


def change_constant(node: Node) -> Node:
    return node._replace(payload=np.nextafter(node.payload, np.inf).item()) if node.op == "const" else node


def change_arguments(node: Node) -> Node:
    return node._replace(args=(*node.args[:-1], 0)) if node.args and node.args[-1] else node


def change_extrapolation(node: Node) -> Node:
    return node._replace(payload=node.payload._replace(extrapolation="none")) if node.op == "position" else node


def change_smoothing(node: Node) -> Node:
    return node._replace(payload=node.payload._replace(smoothed=(True,))) if node.op == "interpolate" else node


NODES: dict[str, Callable[[Node], Node]] = {
    "an operation": lambda node: node._replace(op="max") if node.op == "mul" else node,
    "an argument": change_arguments,
    "the last bit of a constant": change_constant,
    "an extrapolation": change_extrapolation,
    "smoothing": change_smoothing,
}
LINE: dict[str, Callable[[Linearization], dict[str, Any]]] = {
    "a latency": lambda line: {"states": tuple(s._replace(latency=s.latency + 1) for s in line.states)},
    "the carried states": lambda line: {"carried": (), "seeds": ()},
    "a derivative": lambda line: {"slopes": line.slopes.only([0])},
    "a first derivative": lambda line: {"start_slopes": line.slopes},
    "an output": lambda line: {"outputs": (*line.outputs, 0)},
    "a first value": lambda line: {"starts": tuple(start + 1 for start in line.starts)},
}
LAYOUT: dict[str, Callable[[MemoryLayout], dict[str, Any]]] = {
    "the row of an input": lambda layout: {"inputs": {name: row + 1 for name, row in layout.inputs.items()}},
    "an offset": lambda layout: {"offsets": {name: at + 1 for name, at in layout.offsets.items()}},
    "a shape": lambda layout: {"shapes": {name: (*shape, 1) for name, shape in layout.shapes.items()}},
    "the last bit of a breakpoint": lambda layout: {"axes": tuple(np.nextafter(x, np.inf) for x in layout.axes)},
    "the number of free values": lambda layout: {"free": layout.free + 1},
    "a search": lambda layout: {"searches": {search: at + 1 for search, at in layout.searches.items()}},
}
OUTPUT: dict[str, Callable[[Output], dict[str, Any]]] = {
    "a scale": lambda output: {"scale": 2 * output.scale},
    "a loss": lambda output: {"loss": "excess"},
    "the width of a loss": lambda output: {"delta": 2 * output.delta},
    "a weight": lambda output: {"weight": 0},
}


@pytest.mark.parametrize("change", NODES)
def test_each_attribute_of_a_node_has_a_part_in_it(change: str) -> None:
    line, *others = arguments()
    nodes = tuple(map(NODES[change], line.nodes))
    assert nodes != line.nodes
    assert fingerprint(WRITE, (replace(line, nodes=nodes), *others)) != fingerprint(WRITE, (line, *others))


@pytest.mark.parametrize("change", [*LINE, *LAYOUT, *OUTPUT])
def test_each_other_argument_has_a_part_in_it(change: str) -> None:
    line, layout, (output, *others) = arguments()
    changed = (
        replace(line, **LINE[change](line)) if change in LINE else line,
        replace(layout, **LAYOUT[change](layout)) if change in LAYOUT else layout,
        (replace(output, **OUTPUT[change](output)) if change in OUTPUT else output, *others),
    )
    assert fingerprint(WRITE, changed) != fingerprint(WRITE, (line, layout, (output, *others)))


@pytest.mark.parametrize(
    ("one", "other"),
    [(0.0, -0.0), (1, 1.0), (1, True), (np.float64(1), np.float32(1)), ("1", 1), ((1, 2), (2, 1)), (frozenset(), ())],
)
def test_values_that_python_may_take_for_equal_differ(one: object, other: object) -> None:
    assert fingerprint(WRITE, (one,)) != fingerprint(WRITE, (other,))


def test_a_reference_is_not_taken_for_its_parts() -> None:
    axis = AxisRef(0, "clip")
    references = [(axis,), (tuple(axis),), (TableRef("M", (axis,), (False,)),), (("M", (axis,), (False,)),)]
    assert len({fingerprint(WRITE, each) for each in references}) == len(references)


def test_the_function_has_a_part_in_it() -> None:
    assert fingerprint(kernels.cost_code, arguments()) != fingerprint(WRITE, arguments())


def test_a_function_of_another_package_has_none() -> None:
    assert fingerprint(arguments, ()) is None
    assert fingerprint(TapeLayout.of, ()) is not None


@pytest.fixture
def source_hash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], str]:
    """The hash of a copy of the sources in the folder of the test."""
    for name in WRITERS:
        shutil.copytree(ROOT / name, tmp_path / name)
    for name in OTHERS:
        (tmp_path / name).parent.mkdir()
        shutil.copy(ROOT / name, tmp_path / name)
    monkeypatch.setattr(module, "__file__", str(tmp_path / "base" / "machine_code" / "fingerprint.py"))
    return module._source_hash.__wrapped__


@pytest.mark.parametrize(
    "file", ["base/machine_code/engine.py", "domain/rbf.py", "graph/derivative.py", "native/emitter.py"]
)
def test_each_source_has_a_part_in_it(file: str, source_hash: Callable[[], str], tmp_path: Path) -> None:
    before = source_hash()
    assert before == module._source_hash()
    with (tmp_path / file).open("a", encoding="utf-8") as stream:
        stream.write("\n")
    assert source_hash() != before


def test_a_source_in_a_folder_has_a_part_in_it(source_hash: Callable[[], str], tmp_path: Path) -> None:
    before = source_hash()
    (tmp_path / "native" / "linear").mkdir()
    (tmp_path / "native" / "linear" / "factor.py").touch()
    assert source_hash() != before


def test_without_sources_a_call_has_no_fingerprint(
    source_hash: Callable[[], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for file in (tmp_path / "native").glob("*.py"):
        file.unlink()
    assert source_hash() == ""
    monkeypatch.setattr(module, "_source_hash", source_hash)
    assert fingerprint(WRITE, arguments()) is None
    assert fingerprint_of_text("ret void") is None


def test_the_writers_have_constants_of_known_modules_alone() -> None:
    for path in (path for name in WRITERS for path in (ROOT / name).glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ImportFrom) or not (node.module or "").startswith("kennfeld."):
                continue
            home = "/".join(str(node.module).split(".")[1:])
            constants = [alias.name for alias in node.names if alias.name.isupper() and len(alias.name) > 3]
            known = home.startswith(WRITERS) or f"{home}.py" in OTHERS
            assert known or (home in DATA and not constants), f"{path.name} imports {node.module}: add it to OTHERS"
