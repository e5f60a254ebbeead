"""Prints how many test networks of the package onnx give their stated outputs, and why the others are refused.

    python scripts/onnx_table.py [--names] [GROUP ...]

Groups are `node`, one operator each, and the stored networks `simple`, `pytorch-converted`, `pytorch-operator` and
`light`. Networks are evaluated by the interpreter. The slopes of networks whose outputs are equal are compared with
differences, see `onnx_slopes.py`. With `--names`, each network that is refused or wrong is named.
"""

import argparse
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import onnx
from onnx import numpy_helper

from kennfeld.base.errors import InputError
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.interpreter import evaluate
from kennfeld.importers.onnx.importing import network_function
from kennfeld.importers.onnx.reading import read_network
from kennfeld.models.model_function import ModelFunction

sys.path.insert(0, str(Path(__file__).parent))

from onnx_slopes import CONSTANT, DIFFERENT, KINK, SAME, slope_verdict

STORED = Path(onnx.__file__).parent / "backend" / "test" / "data"
GROUPS = ("node", "simple", "pytorch-converted", "pytorch-operator", "light")
TOLERANCES = {"float16": 2e-2, "bfloat16": 2e-2, "float32": 2e-5}
EQUAL = "equal"
BOUND = "equal with constants"
WRONG = "wrong"
MOST_SLOPES = 600_000  # of a network, inputs times outputs, up to which they are compared

Arrays = list[np.ndarray[Any, Any]]


@dataclass(frozen=True)
class Case:
    """A network with pairs of inputs and outputs."""

    name: str
    model: bytes
    data: list[tuple[list[Any], list[Any]]]

    @property
    def size(self) -> int:
        """Number of elements of the inputs."""
        return sum(_numbers(inputs).size for inputs, _ in self.data)


def cases(group: str) -> Iterator[Case]:
    """Yield the networks of a group; none if the package does not hold them."""
    if group == "node":
        yield from _node_cases()
    elif group == "light":
        for path in sorted((STORED / group).glob("*.onnx")):
            yield Case(path.stem, path.read_bytes(), [])
    else:
        for folder in sorted((STORED / group).glob("*/")):
            pairs = [
                (_stored(data, "input"), _stored(data, "output")) for data in sorted(folder.glob("test_data_set_*"))
            ]
            yield Case(folder.name, (folder / "model.onnx").read_bytes(), pairs)


def _node_cases() -> Iterator[Case]:
    from onnx.backend.test.case.node import collect_testcases

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the package onnx
        collected = collect_testcases(None)
    for case in collected:
        yield Case(case.name, case.model.SerializeToString(), [(list(x), list(y)) for x, y in case.data_sets])


def _stored(folder: Path, kind: str) -> list[onnx.TensorProto]:
    paths = sorted(folder.glob(f"{kind}_*.pb"), key=lambda path: int(path.stem.rpartition("_")[2]))
    return [onnx.TensorProto.FromString(path.read_bytes()) for path in paths]


class Verdict(NamedTuple):
    """Outputs: `EQUAL`, `BOUND`, `WRONG`, or why the network is refused; slopes as `slope_verdict`, empty for none."""

    outputs: str
    slopes: str = ""


def verdict(case: Case, folder: Path) -> Verdict:
    """Compare the outputs of a network with the stated ones, and its slopes with differences.

    A network that needs constants, such as shapes and indices, where the test has inputs, is tried again with the whole
    numbers of the test as constants: `BOUND`.
    """
    result = _compare(case, folder)
    if "depends on the inputs" not in result.outputs:
        return result
    verdicts = [_compare(bound, folder) for bound in _bound(case)]
    outputs = {each.outputs for each in verdicts}
    slopes = next(kind for kind in (DIFFERENT, KINK, SAME, CONSTANT, "") if kind in {each.slopes for each in verdicts})
    return Verdict(BOUND if outputs == {EQUAL} else WRONG if WRONG in outputs else outputs.pop(), slopes)


def _bound(case: Case) -> Iterator[Case]:
    """Yield the network of a test, for each pair of inputs and outputs, with whole numbers and truths as constants."""
    for inputs, outputs in case.data:
        model = onnx.ModelProto.FromString(case.model)
        ports = list(model.graph.input)
        arrays = [numpy_helper.to_array(each) if isinstance(each, onnx.TensorProto) else each for each in inputs]
        model.graph.ClearField("input")
        kept = []
        for port, array in zip(ports, arrays, strict=False):
            if np.asarray(array).dtype.kind in "iub":
                model.graph.initializer.append(numpy_helper.from_array(np.asarray(array), port.name))
            else:
                model.graph.input.append(port)
                kept.append(array)
        yield Case(case.name, model.SerializeToString(), [(kept, outputs)])


def _compare(case: Case, folder: Path) -> Verdict:
    path = folder / "network.onnx"
    path.write_bytes(case.model)
    try:
        network = read_network(path)
        function = network_function(network)
    except InputError as error:
        return Verdict("; ".join(dict.fromkeys(finding.message for finding in error.findings)))
    kinds = {port.kind for port in (*network.inputs, *network.outputs)}
    tolerance = max(TOLERANCES.get(kind, 1e-10) for kind in kinds)
    for inputs, outputs in case.data:
        arguments, stated = _numbers(inputs), _numbers(outputs)
        if len(arguments) != len(function.inputs):
            return Verdict("the size of a batch is not stated")
        computed = _computed(function, arguments)
        if computed.shape != stated.shape or not np.allclose(computed, stated, tolerance, tolerance, equal_nan=True):
            return Verdict(WRONG)
    if not case.data or len(function.inputs) * len(function.outputs) > MOST_SLOPES:
        return Verdict(EQUAL)
    moving = ["float" in port.kind for port in network.inputs for _ in port.labels]
    return Verdict(EQUAL, slope_verdict(function, _numbers(case.data[0][0]), moving))


def _numbers(arrays: Sequence[Any]) -> np.ndarray[Any, Any]:
    parts = [part for each in arrays for part in (each if isinstance(each, list) else [each])]  # lists are sequences
    dense = [numpy_helper.to_array(each) if isinstance(each, onnx.TensorProto) else np.asarray(each) for each in parts]
    numbers = [array.astype(np.float64).ravel() for array in dense if array.dtype.kind in "fiubV"]
    return np.concatenate([np.zeros(0), *numbers])


def _computed(function: ModelFunction, inputs: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    builder = GraphBuilder()
    nodes = function.write(builder, [builder.input(f"i{number}") for number in range(len(inputs))])
    graph = builder.finish({f"o{number}": node for number, node in enumerate(nodes)})
    columns = {f"i{number}": [value] for number, value in enumerate(inputs)} or {"none": [0.0]}
    with np.errstate(all="ignore"):
        values = evaluate(graph, columns, function.values)
    return np.array([values[f"o{number}"][0] for number in range(len(nodes))])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("groups", nargs="*", default=GROUPS, metavar="GROUP")
    parser.add_argument("--names", action="store_true", help="name each network that is refused or wrong")
    options = parser.parse_args()
    reasons: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        for group in options.groups:
            verdicts = {case.name: verdict(case, Path(folder)) for case in cases(group)}
            counts = Counter(each.outputs for each in verdicts.values())
            slopes = Counter(each.slopes for each in verdicts.values())
            same, bound, wrong = (counts[name] for name in (EQUAL, BOUND, WRONG))
            refused = len(verdicts) - same - bound - wrong
            print(f"{group}: {len(verdicts)} networks, {same} equal, {bound} equal with constants, ", end="")
            print(f"{wrong} wrong, {refused} refused; ", end="")
            print(f"slopes: {slopes[SAME]} equal, {slopes[CONSTANT]} zero, {slopes[DIFFERENT]} wrong, ", end="")
            print(f"{slopes[KINK]} at kinks")
            reasons += counts
            for name, (reason, kind) in verdicts.items() if options.names else ():
                if reason not in (EQUAL, BOUND) or kind in (DIFFERENT, KINK):
                    print(f"    {name}: {kind or reason}")
    print("\nrefused because")
    for reason, count in reasons.most_common():
        if reason not in (EQUAL, BOUND, WRONG):
            print(f"{count:6} {reason}")


if __name__ == "__main__":
    main()
