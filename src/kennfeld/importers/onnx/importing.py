"""ONNX files as functions of formula text, and as models of their own."""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.onnx.lowering import output_labels, output_nodes, write_network
from kennfeld.importers.onnx.network import Network
from kennfeld.importers.onnx.reading import read_network
from kennfeld.importers.onnx.registry import Context
from kennfeld.models.model import Model
from kennfeld.models.model_function import FunctionInput, FunctionOutput, ModelFunction, as_model

_SINGLE = "the network is in single precision, but is computed in double: results differ by about 1e-7 of their size"


def onnx(path: str | Path, *, fit: bool = False) -> Model:
    """Read an ONNX network as a model: its inputs are channels, its outputs nodes, its layers parameters.

    The elements of an input `x` are the channels `x[0]`, `x[1]`, ..., or `x` if there is one. The weights of a dense
    layer are a value block `layer1`, `layer2`, ... with a row per input and, last, the biases; a column per output.

    Args:
        path: the file.
        fit: True if a calibration may change the weights; otherwise they are locked.

    Returns:
        The model.

    Raises:
        InputError: the package onnx is missing, the file is damaged, or operators are not supported; names all of them.

    >>> model = onnx("knock.onnx")
    >>> model.graph.inputs, model.graph.outputs, list(model.values)
    (('x[0]', 'x[1]'), ('y',), ['layer1', 'layer2'])
    """
    model = as_model(read_function(Path(path)))
    if not fit:
        return model
    free = [block.changed(locked=np.False_) for block in model.values.parameters]
    return replace(model, values=ParameterSet(free))


def read_function(path: Path, function: str = "", name: str = "", step: float | None = None) -> ModelFunction:
    """Read an ONNX network as a function, without running it.

    Args:
        path: the file.
        function: unused; a file holds one network.
        name: name for calls in formula text; empty for a model of its own, which keeps names such as `x[0]`.
        step: unused; a network has no states.

    Raises:
        InputError: see `onnx`.
    """
    return network_function(read_network(path), name)


def network_function(network: Network, name: str = "") -> ModelFunction:
    """Write a network once on trial, and describe it as a function.

    Raises:
        InputError: shapes of inputs are missing, names occur twice, or operators are not supported.
    """
    location = Location.of_file(network.file)
    unknown = [port.name for port in network.inputs if port.shape is None]
    if unknown:
        message = f"the shapes of inputs are not stated: {', '.join(unknown)}"
        raise InputError.of(location, message, "Export the network with fixed shapes; only the first may be a batch.")
    texts = [port.name for port in network.outputs if port.kind == "text"]
    if not network.number_outputs:
        raise InputError.of(location, "none of its outputs holds numbers", "Export it with numbers as outputs.")
    labels = [label for port in network.inputs for label in port.labels]
    prefix = f"{name}." if name else ""
    # shapes of outputs, layers and what is not supported show only when the network is written
    trial = GraphBuilder()
    context = write_network(network, trial, [trial.input(label) for label in labels], prefix)
    output_nodes(context)
    skipped = [f"outputs that hold texts are skipped: {', '.join(texts)}"] if texts else []
    single = [_kernel_sums(network, context) or _SINGLE] if network.is_single else []
    remarks = [*context.remarks, *skipped, *single]
    spell = plain if name else str
    inputs, outputs = ([spell(label) for label in each] for each in (labels, output_labels(context)))
    # names that differ in characters which formula text does not know become equal
    if repeated := sorted({label for each in (inputs, outputs) for label in each if each.count(label) > 1}):
        raise InputError.of(location, f"several elements are named {', '.join(repeated)}", "Rename the inputs.")
    return ModelFunction(
        name=name or network.name or Path(network.file).stem,
        inputs=tuple(map(FunctionInput, inputs)),
        outputs=tuple(map(FunctionOutput, outputs)),
        write=partial(_write, network, prefix),
        values=ParameterSet(context.layers.values()),
        source=network.file,
        remarks=tuple(Finding(location, text, severity="remark") for text in remarks),
    )


def _kernel_sums(network: Network, context: Context) -> str:
    """Return the remark on a Gaussian process, whose large terms cancel in a small result; empty for other networks."""
    bodies = [op.get("body") for op in network.used_operators if op.kind == "Scan"]
    kinds = {op.kind for body in bodies if isinstance(body, Network) for op in body.operators}
    # weights of the kernels, a row each, of which the last row is the offsets
    sizes = [float(np.abs(layer.values[:-1]).sum(axis=0).max()) for layer in context.layers.values()]
    if not sizes or "ReduceSumSquare" not in kinds:
        return ""
    return (
        "it sums kernels of distances, as a Gaussian process does, with weights in single precision that amount to "
        f"{max(sizes):.2g} and cancel: results differ from those of ONNX Runtime, which sums in single precision, by "
        "about 2e-8 of that amount. Those of Kennfeld, which sums in double precision, are nearer to the exact ones; "
        "export the process in double precision to have these"
    )


def _write(network: Network, prefix: str, builder: GraphBuilder, arguments: Sequence[int]) -> Sequence[int]:
    return output_nodes(write_network(network, builder, arguments, prefix))


def plain(label: str) -> str:
    """Spell the name of an element as formula text can call it.

    >>> plain("y[0,1]"), plain("onnx::Gemm_0"), plain("7")
    ('y.0.1', 'onnx_Gemm_0', '_7')
    """
    name, _, places = label.partition("[")
    word = re.sub(r"\W+", "_", name)
    word = word if word[:1].isalpha() or word[:1] == "_" else f"_{word}"
    return ".".join([word, *filter(None, places.rstrip("]").split(","))])
