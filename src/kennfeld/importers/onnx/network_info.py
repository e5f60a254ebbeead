"""Contents of an ONNX network, which is read but not run."""

from collections import Counter
from pathlib import Path

from kennfeld.base.errors import Finding, InputError
from kennfeld.base.formatting import count_noun, size_text
from kennfeld.files.file_info import DescribedFile, FileInfo, Table
from kennfeld.importers.onnx.importing import network_function
from kennfeld.importers.onnx.network import Network, NetworkPort
from kennfeld.importers.onnx.reading import read_network
from kennfeld.models.importer import FileFacts
from kennfeld.models.model_function import ModelFunction


def facts(path: Path) -> FileFacts:
    """Return what a network says of itself. Raises `InputError` if the file is damaged."""
    network = read_network(path)
    operators = Counter(operator.label for operator in network.operators)
    rows = [
        ("network", network.name),
        ("exported by", network.producer),
        ("operator sets", ", ".join(f"{domain or 'ai.onnx'} {n}" for domain, n in network.opsets.items())),
        ("constants", str(sum(array.size for array in network.constants.values()))),
        *((kind, count_noun(count, "operator")) for kind, count in operators.items()),
    ]
    return FileFacts(rows)


def describe_network(file: DescribedFile) -> FileInfo:
    """Describe an ONNX network: inputs, outputs, layers, operators, and all that is not supported.

    Raises:
        InputError: the package onnx is missing, or the file is damaged.
    """
    path = file.path
    network = read_network(path)
    function, findings = _function(network)
    blocks = [] if function is None else function.values.parameters
    layers = [(b.name, str(b.values.shape[0] - 1), str(b.values.shape[1]), str(b.size)) for b in blocks]
    operators = Counter(op.label for op in network.operators)
    weights = sum(array.size for array in network.constants.values())
    tables: list[Table] = [
        [("input", "size", "type", "elements"), *map(_port_row, network.inputs)],
        [("output", "size", "type", "elements"), *map(_port_row, network.outputs)],
        [("layer", "inputs", "outputs", "weights"), *layers],
        [("operator", "count"), *((kind, str(count)) for kind, count in operators.items())],
    ]
    versions = ", ".join(f"{domain or 'ai.onnx'} {version}" for domain, version in network.opsets.items())
    sizes = f"{count_noun(len(network.operators), 'operator')}, {count_noun(weights, 'constant')}"
    origin = f" of {network.producer}" if network.producer else ""
    as_json = {
        "content": "network",
        "file": path.name,
        "name": network.name,
        "producer": network.producer,
        "opsets": dict(network.opsets),
        "inputs": [_port_entry(port) for port in network.inputs],
        "outputs": [_port_entry(port) for port in network.outputs],
        "layers": [{"name": block.name, "shape": list(block.values.shape)} for block in blocks],
        "operators": dict(operators),
        "constants": weights,
        "remarks": list(map(str, findings)),
    }
    notes = [f"operator sets: {versions}", *(f"{finding.severity}: {finding}" for finding in findings)]
    return FileInfo(f"{path.name}: ONNX network{origin}, {sizes}", tables, notes, as_json)


def _function(network: Network) -> tuple[ModelFunction | None, tuple[Finding, ...]]:
    """Return a network as a function, None if that is not supported, and the findings."""
    try:
        function = network_function(network)
    except InputError as error:
        return None, error.findings
    return function, function.remarks


def _port_row(port: NetworkPort) -> tuple[str, str, str, str]:
    labels = port.labels if port.shape is not None else ()
    ends = labels if len(labels) < 3 else (labels[0], "...", labels[-1])
    return port.name, "unknown" if port.shape is None else size_text(port.shape), port.kind, " ".join(ends)


def _port_entry(port: NetworkPort) -> dict[str, object]:
    return {"name": port.name, "shape": None if port.shape is None else list(port.shape), "type": port.kind}
