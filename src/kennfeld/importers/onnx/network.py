"""The content of an ONNX file, independent of the package that reads it."""

from collections.abc import Mapping
from math import prod
from typing import Any

from numpy.typing import NDArray

from kennfeld.base.lazy_dataclass import dataclass

Array = NDArray[Any]
ML = "ai.onnx.ml"


@dataclass(frozen=True)
class NetworkPort:
    """An input or output of a network.

    Attributes:
        name: its name.
        shape: its dimensions; a batch of unknown size is 1. None if the file does not state them.
        kind: type of its elements, such as "float32"; "text", or "sequence" for an output that is not a tensor.
    """

    name: str
    shape: tuple[int, ...] | None
    kind: str

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the elements: `x` if there is one, else `x[0]`, `x[1]`, ... in C order.

        >>> NetworkPort("x", (1, 2), "float32").labels, NetworkPort("x", (2, 2), "float32").labels[-1]
        (('x[0]', 'x[1]'), 'x[1,1]')
        """
        shape = [size for size in self.shape or () if size != 1]
        if not shape:
            return (self.name,)
        labels = []
        for number in range(prod(shape)):
            # place i = number / (elements behind dimension i), modulo its size
            places = [number // prod(shape[i + 1 :]) % size for i, size in enumerate(shape)]
            labels.append(f"{self.name}[{','.join(map(str, places))}]")
        return tuple(labels)


@dataclass(frozen=True)
class Operator:
    """An operator of a network; an empty name in `inputs` is an argument that is not given."""

    name: str
    kind: str
    domain: str
    version: int
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: Mapping[str, Any]

    @property
    def label(self) -> str:
        """The operator for messages: `Gemm`, `ai.onnx.ml.Scaler`."""
        return f"{self.domain}.{self.kind}" if self.domain else self.kind

    def get(self, attribute: str, default: Any = None) -> Any:
        """Return the value of an attribute."""
        return self.attributes.get(attribute, default)


@dataclass(frozen=True)
class Network:
    """A network: operators in the order of their computation, constants by name."""

    name: str
    file: str
    producer: str
    inputs: tuple[NetworkPort, ...]
    outputs: tuple[NetworkPort, ...]
    constants: Mapping[str, Array]
    operators: tuple[Operator, ...]
    opsets: Mapping[str, int]

    @property
    def number_outputs(self) -> tuple[NetworkPort, ...]:
        """The outputs that are numbers."""
        return tuple(port for port in self.outputs if port.kind != "text")

    @property
    def used_operators(self) -> tuple[Operator, ...]:
        """The operators that these outputs depend on."""
        needed = {port.name for port in self.number_outputs}
        used = []
        # backwards, so that the users of a tensor come before the operator that computes it
        for operator in self.operators[::-1]:
            if needed.intersection(operator.outputs):
                needed.update(operator.inputs)
                used.append(operator)
        return tuple(used[::-1])

    @property
    def is_single(self) -> bool:
        """True if the network computes in single precision."""
        kinds = [port.kind for port in (*self.inputs, *self.outputs)]
        return "float32" in kinds or any(str(array.dtype) == "float32" for array in self.constants.values())
