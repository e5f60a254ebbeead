"""What could not be built, and why: of each block the first reason that is found.

What a block, or a setting of it, raises where it cannot be built.
"""

import re
from contextlib import AbstractContextManager
from types import TracebackType
from typing import NamedTuple

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.simulink.flattening.flat_model import FlatBlock
from kennfeld.models.simulink.reader.library_links import is_of_simulink
from kennfeld.models.simulink.reader.model_tree import split_path
from kennfeld.models.simulink.signals import CONSTANT, Signal

__all__ = [
    "PARAMETER_ERRORS",
    "BlockFailure",
    "BlockFailures",
    "UnsupportedError",
    "placeholder_signal",
    "stand_ins",
    "unsupported_reason",
]

PARAMETER_ERRORS = (ValueError, IndexError, TypeError, ArithmeticError, EvaluationError)


class UnsupportedError(Exception):
    """A block, or a setting of it, that cannot be built; `mend` says what would help.

    `undefined` is the variable that nothing gives a value.
    """

    def __init__(self, message: str, remedy: str = "", undefined: str = "") -> None:
        super().__init__(message)
        self.message, self.remedy, self.undefined = message, remedy, undefined

    @property
    def parts(self) -> tuple[str, str, str]:
        """What, how to mend it, and the variable without a value."""
        return self.message, self.remedy, self.undefined


class BlockFailure(NamedTuple):
    """Why a block could not be built, what would unblock it, and the variable that has no value, if that is why."""

    atom: FlatBlock
    why: str
    remedy: str = ""
    undefined: str = ""


class BlockFailures(dict[FlatBlock, BlockFailure]):
    """The blocks that could not be built."""

    def note(self, atom: FlatBlock, message: str, remedy: str = "", undefined: str = "") -> None:
        """Note why a block cannot be built, unless a reason is known."""
        self.setdefault(atom, BlockFailure(atom, message, remedy, undefined))

    def noting(self, atom: FlatBlock) -> "_Noting":
        """Note what stops a piece of work on a block, and go on behind it."""
        return _Noting(self, atom)


class _Noting(AbstractContextManager[None, bool]):
    def __init__(self, failures: BlockFailures, atom: FlatBlock) -> None:
        self.failures, self.atom = failures, atom

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, place: TracebackType | None
    ) -> bool:
        if isinstance(error, UnsupportedError):
            self.failures.note(self.atom, *error.parts)
        elif isinstance(error, PARAMETER_ERRORS):
            self.failures.note(self.atom, _unfit(error), "", getattr(error, "undefined", ""))
        return isinstance(error, (UnsupportedError, *PARAMETER_ERRORS))


def _unfit(error: BaseException) -> str:
    """What a block's settings or signals ran into."""
    said = str(error)[:200]
    return said if isinstance(error, EvaluationError) else f"its settings do not fit its signals: {said}"


def placeholder_signal(builder: GraphBuilder) -> Signal:
    """The signal that stands in for one that could not be built."""
    return Signal(np.array([builder.const(float("nan"))], dtype=np.int64), CONSTANT, sound=False)


def stand_ins(builder: GraphBuilder, atom: FlatBlock) -> tuple[Signal, ...]:
    """The signals that stand in for the outputs of a block that could not be built."""
    count = atom.block.ports.outputs if atom.block.ports is not None else 1
    return tuple(placeholder_signal(builder) for _ in range(max(count, 1)))


def unsupported_reason(atom: FlatBlock) -> tuple[str, str]:
    """Why a block of a type that is not in the registry cannot be built, and what would help."""
    if atom.why:
        return f"it is {atom.why}", ""
    elsewhere = atom.block.elsewhere
    if elsewhere and atom.block.system is None:
        stem = re.sub(r"\.(slx|mdl)\Z", "", elsewhere)
        message = f"its content is in the file {elsewhere}, which was not found or does not fit"
        return message, f"Put {stem}.slx beside the model, or bind it."
    if atom.block.type == "ModelReference":
        return (
            f"it runs the model {atom.block.model}, which was not found",
            "Put it beside the model, or bind the block.",
        )
    link = atom.block.reference
    if link is not None and not is_of_simulink(link.source):
        library = (split_path(link.source) or ("",))[0]
        message = f"it is a link into the library {library}, which was not found"
        return message, f"Put {library}.slx beside the model, or name its folder in `folders`."
    return f"blocks of type {atom.kind} are not supported", ""
