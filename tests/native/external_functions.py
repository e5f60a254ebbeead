"""Functions outside of a graph: callbacks in Python, at an address."""

import ctypes
import math
from dataclasses import dataclass
from typing import Any

from kennfeld.graph.external_function import ExternalFunction


@dataclass
class Callback:
    """A function of Python that machine code can call."""

    function: Any

    @property
    def address(self) -> int:
        return ctypes.cast(self.function, ctypes.c_void_p).value or 0


POINTERS = [ctypes.POINTER(ctypes.c_double)] * 3


def product_and_square(*_: object) -> Callback:
    """A tanh(b), and a^2 + b."""

    @ctypes.CFUNCTYPE(None, *POINTERS)
    def call(x, y, slopes):
        a, b = x[0], math.tanh(x[1])
        y[0], y[1] = a * b, a * a + x[1]
        if slopes:
            slopes[0], slopes[1], slopes[2], slopes[3] = b, a * (1 - b * b), 2 * a, 1.0

    return Callback(call)


PRODUCT_AND_SQUARE = ExternalFunction("product_and_square", 2, 2, "tests.native.external_functions:product_and_square")
