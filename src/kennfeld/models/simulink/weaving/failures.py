"""What could not be built, and why: of each block the first reason that is found."""

import re
from contextlib import AbstractContextManager
from types import TracebackType
from typing import NamedTuple

import numpy as np

from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.expressions.no_value import NoValueError
from kennfeld.models.simulink.expressions.signals import CONSTANT, Signal
from kennfeld.models.simulink.files.libraries import is_of_simulink
from kennfeld.models.simulink.files.tree import split
from kennfeld.models.simulink.flattening.atoms import Atom
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

__all__ = ["UNFIT", "Failure", "Failures", "stand_in", "stand_ins", "unknown"]

UNFIT = (ValueError, IndexError, TypeError, ArithmeticError, NoValueError)


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


def stand_in(loom: Loom) -> Signal:
    """The signal that stands in for one that could not be built."""
    return Signal(np.array([loom.const(float("nan"))], dtype=np.int64), CONSTANT, sound=False)


def stand_ins(loom: Loom, atom: Atom) -> tuple[Signal, ...]:
    """The signals that stand in for the outputs of a block that could not be built."""
    count = atom.block.ports.outputs if atom.block.ports is not None else 1
    return tuple(stand_in(loom) for _ in range(max(count, 1)))


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
