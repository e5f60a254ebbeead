"""What could not be built, and why: of each block the first reason that is found.

What a block, or a setting of it, raises where it cannot be built.
"""

import re
from contextlib import AbstractContextManager
from types import TracebackType
from typing import NamedTuple

import numpy as np

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.evaluation_errors import NoValueError
from kennfeld.models.simulink.flattening.flat_model import Atom
from kennfeld.models.simulink.reader.library_links import is_of_simulink
from kennfeld.models.simulink.reader.model_tree import split
from kennfeld.models.simulink.signals import CONSTANT, Signal

__all__ = ["UNFIT", "Failure", "Failures", "UnsupportedError", "stand_in", "stand_ins", "unknown"]

UNFIT = (ValueError, IndexError, TypeError, ArithmeticError, NoValueError)


class UnsupportedError(Exception):
    """A block, or a setting of it, that cannot be built; `mend` says what would help.

    `undefined` is the variable that nothing gives a value.
    """

    def __init__(self, what: str, mend: str = "", undefined: str = "") -> None:
        super().__init__(what)
        self.what, self.mend, self.undefined = what, mend, undefined

    @property
    def parts(self) -> tuple[str, str, str]:
        """What, how to mend it, and the variable without a value."""
        return self.what, self.mend, self.undefined


class Failure(NamedTuple):
    """Why a block could not be built, what would unblock it, and the variable that has no value, if that is why."""

    atom: Atom
    why: str
    mend: str = ""
    undefined: str = ""


class Failures(dict[Atom, Failure]):
    """The blocks that could not be built."""

    def note(self, atom: Atom, what: str, mend: str = "", undefined: str = "") -> None:
        """Note why a block cannot be built, unless a reason is known."""
        self.setdefault(atom, Failure(atom, what, mend, undefined))

    def noting(self, atom: Atom) -> "_Noting":
        """Note what stops a piece of work on a block, and go on behind it."""
        return _Noting(self, atom)


class _Noting(AbstractContextManager[None, bool]):
    def __init__(self, failures: Failures, atom: Atom) -> None:
        self.failures, self.atom = failures, atom

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, place: TracebackType | None
    ) -> bool:
        if isinstance(error, UnsupportedError):
            self.failures.note(self.atom, *error.parts)
        elif isinstance(error, UNFIT):
            self.failures.note(self.atom, _unfit(error), "", getattr(error, "undefined", ""))
        return isinstance(error, (UnsupportedError, *UNFIT))


def _unfit(error: BaseException) -> str:
    """What a block's settings or signals ran into."""
    said = str(error)[:200]
    return said if isinstance(error, NoValueError) else f"its settings do not fit its signals: {said}"


def stand_in(builder: GraphBuilder) -> Signal:
    """The signal that stands in for one that could not be built."""
    return Signal(np.array([builder.const(float("nan"))], dtype=np.int64), CONSTANT, sound=False)


def stand_ins(builder: GraphBuilder, atom: Atom) -> tuple[Signal, ...]:
    """The signals that stand in for the outputs of a block that could not be built."""
    count = atom.block.ports.outputs if atom.block.ports is not None else 1
    return tuple(stand_in(builder) for _ in range(max(count, 1)))


def unknown(atom: Atom) -> tuple[str, str]:
    """Why a block of a type that is not in the registry cannot be built, and what would help."""
    if atom.why:
        return f"it is {atom.why}", ""
    elsewhere = atom.block.elsewhere
    if elsewhere and atom.block.system is None:
        stem = re.sub(r"\.(slx|mdl)\Z", "", elsewhere)
        what = f"its content is in the file {elsewhere}, which was not found or does not fit"
        return what, f"Put {stem}.slx beside the model, or bind it."
    if atom.block.type == "ModelReference":
        return (
            f"it runs the model {atom.block.model}, which was not found",
            "Put it beside the model, or bind the block.",
        )
    link = atom.block.reference
    if link is not None and not is_of_simulink(link.source):
        library = (split(link.source) or ("",))[0]
        what = f"it is a link into the library {library}, which was not found"
        return what, f"Put {library}.slx beside the model, or name its folder in `folders`."
    return f"blocks of type {atom.kind} are not supported", ""
