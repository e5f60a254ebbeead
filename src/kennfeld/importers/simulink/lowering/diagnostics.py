"""Unsupported blocks and their reasons; the first reason of each block is kept."""

import math
import re
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from types import TracebackType
from typing import NamedTuple

from kennfeld.base.formatting import join_names
from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.simulink.flattening.flat_model import FlatBlock
from kennfeld.importers.simulink.reader.library_links import is_of_simulink
from kennfeld.importers.simulink.reader.model_tree import split_path
from kennfeld.importers.simulink.reader.toolbox_libraries import toolbox_of
from kennfeld.importers.simulink.signals import Signal, constant
from kennfeld.models.imperative.evaluation_errors import DEFAULT_REMEDY, EvaluationError

PHYSICAL_NETWORK = "it belongs to a physical network of Simscape, which cannot be calibrated"
STEP_REMEDY = "Set a fixed step: step = ... in s under [model]."
BUS_REMEDY = "Give its Simulink.Bus as parameters: in a script, a .mat or a .sldd."
_PHYSICAL_TYPES = ("Simscape", "PMComponent", "PMIOPort")  # begin the types of their blocks

# raised by numpy and by expressions if the settings of a block do not fit its signals
PARAMETER_ERRORS = (ValueError, IndexError, TypeError, ArithmeticError, EvaluationError)


class UnsupportedError(Exception):
    """A block, or a setting of it, is not supported.

    `remedy` says what helps; `undefined` names an undefined variable, if that is the reason.
    """

    def __init__(self, message: str, remedy: str = "", undefined: str = "") -> None:
        super().__init__(message)
        self.message, self.remedy, self.undefined = message, remedy, undefined

    @property
    def parts(self) -> tuple[str, str, str]:
        """Message, remedy and undefined variable."""
        return self.message, self.remedy, self.undefined


@contextmanager
def evaluating(failure: str, remedy: str = "") -> Iterator[None]:
    """Turn an `EvaluationError` into an `UnsupportedError` that starts with `failure`.

    A remedy of the error's own takes precedence.
    """
    try:
        yield
    except EvaluationError as error:
        own = error.remedy if error.remedy != DEFAULT_REMEDY else remedy
        raise UnsupportedError(f"{failure}: {error}", own, error.undefined) from None


class BlockFailure(NamedTuple):
    """Reason why a block is unsupported, remedy, and undefined variables if these are the reason."""

    flat: FlatBlock
    why: str
    remedy: str = ""
    undefined: tuple[str, ...] = ()


class BlockFailures(dict[FlatBlock, BlockFailure]):
    """The unsupported blocks."""

    def note(self, flat: FlatBlock, message: str, remedy: str = "", undefined: str = "") -> None:
        """Record why a block is unsupported unless a reason is known; undefined variables are collected."""
        failure = self.setdefault(flat, BlockFailure(flat, message, remedy, (undefined,) if undefined else ()))
        # a block that fails for another reason keeps that one
        if undefined and failure.undefined:
            self[flat] = failure._replace(undefined=tuple(dict.fromkeys((*failure.undefined, undefined))))

    def note_errors(self, flat: FlatBlock) -> "_Noting":
        """Return a context manager that records an exception as the reason of a block and suppresses it."""
        return _Noting(self, flat)


class _Noting(AbstractContextManager[None, bool]):
    def __init__(self, failures: BlockFailures, flat: FlatBlock) -> None:
        self.failures, self.flat = failures, flat

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, place: TracebackType | None
    ) -> bool:
        if error is None:
            return False
        if isinstance(error, UnsupportedError):
            self.failures.note(self.flat, *error.parts)
        elif isinstance(error, PARAMETER_ERRORS):
            cause = "" if isinstance(error, EvaluationError) else "its settings do not match its signals: "
            self.failures.note(self.flat, cause + str(error)[:200], "", getattr(error, "undefined", ""))
        return isinstance(error, (UnsupportedError, *PARAMETER_ERRORS))


def placeholder_signal(builder: GraphBuilder) -> Signal:
    """Return a placeholder for a signal that could not be lowered."""
    return replace(constant(builder, math.nan), sound=False)


def placeholder_outputs(builder: GraphBuilder, flat: FlatBlock) -> tuple[Signal, ...]:
    """Return placeholders for the outputs of an unsupported block."""
    count = flat.block.ports.outputs if flat.block.ports is not None else 1
    return tuple(placeholder_signal(builder) for _ in range(max(count, 1)))


def unsupported_reason(flat: FlatBlock) -> tuple[str, str]:
    """Return reason and remedy for a block whose type is not registered."""
    if flat.unsupported_reason:
        return f"unsupported: {flat.unsupported_reason}", ""
    elsewhere = flat.block.elsewhere
    if elsewhere and flat.block.system is None:
        stem = re.sub(r"\.(slx|mdl)\Z", "", elsewhere)
        message = f"its content is in the file {elsewhere}, which was not found or does not match"
        return message, f"Put {stem}.slx next to the model, or bind it."
    if flat.block.type == "ModelReference":
        message = f"it references the model {flat.block.model}, which was not found{_searched(flat)}"
        return message, "Put that file next to the model, or bind the block."
    if flat.type.startswith(_PHYSICAL_TYPES):
        return PHYSICAL_NETWORK, ""
    link = flat.block.reference
    if link is not None and not is_of_simulink(link.source):
        if not flat.block.searched:  # the file is at hand
            message = f"its link to {link.source[:120]} leads to no block of that library"
            return message, "Add the folder of the version of the library that has it to `folders`, or bind the block."
        return _missing_library((split_path(link.source) or ("",))[0], flat)
    return f"blocks of type {flat.type} are not supported", ""


def _missing_library(library: str, flat: FlatBlock) -> tuple[str, str]:
    """Return reason and remedy for a block of a library that was not found."""
    toolbox = toolbox_of(library)
    if toolbox is None:
        message = f"it links to the library {library}, which was not found{_searched(flat)}"
        return message, f"Put {library}.slx next to the model, or add its folder to `folders`."
    if toolbox.physical:
        return PHYSICAL_NETWORK, ""
    if toolbox.hardware:
        return f"it drives hardware, by the library {library}", "Bind its outputs to measured channels."
    message = f"it links to the library {library} of {toolbox.product}, which was not found"
    place = f"matlabroot/toolbox/{toolbox.folder}"
    return message, f"Add its folder below {place} to `folders` if MATLAB is installed; otherwise bind the block."


def _searched(flat: FlatBlock) -> str:
    """Return the folders in which the file of a link was searched, as the end of a sentence."""
    folders = ["the folder of the model" if folder == "." else folder for folder in flat.block.searched]
    return f" in {join_names(folders)}" if folders else ""
