"""Shapes and sample times in feedback: what an earlier pass found, and what is asked for in this one."""

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from kennfeld.models.simulink.expressions.signals import CONTINUOUS, Signal
from kennfeld.models.simulink.flattening.atoms import Atom

__all__ = ["Guesses", "Key", "Shape", "Shapes"]

Key: TypeAlias = tuple[Atom, int]  # a block and the number of its memory
Shape: TypeAlias = tuple[int, ...]

_WIDEST_WISH = 1000


@dataclass
class Guesses:
    """What an earlier pass found: the shapes of memories, the sample times of their blocks, names of two things.

    `wished` are shapes that no input gave but a matrix behind the memory asks for.
    """

    shapes: dict[Key, Shape] = field(default_factory=dict)
    periods: dict[Atom, float] = field(default_factory=dict)
    taken: frozenset[str] = frozenset()
    wished: dict[Key, Shape] = field(default_factory=dict)
    changed: bool = False

    def shape(self, key: Key, found: Shape) -> None:
        """Note the shape of a memory for the next pass."""
        if self.shapes.get(key) != found:
            self.shapes[key] = found
            self.changed = True

    def period(self, atom: Atom, found: float) -> None:
        """Note the sample time of a block for the next pass."""
        if self.periods.get(atom, CONTINUOUS) != found:
            self.periods[atom] = found
            self.changed = True


class Shapes:
    """The shapes of memories and inputs in one pass; `wishes` are those that blocks ask of scalars before them."""

    def __init__(self, guesses: Guesses) -> None:
        self.guesses = guesses
        self.wishes: dict[Key, Shape] = {}
        self._scalars: dict[Atom, Key] = {}

    def of(self, key: Key, init: Signal) -> Shape:
        """The shape of a memory: as an earlier pass found it, else that of its initial value."""
        if init.size == 1 and key not in self.guesses.shapes:
            self._scalars.setdefault(key[0], key)
        return self.guesses.shapes.get(key, init.shape)

    def open(self, atom: Atom) -> Shape:
        """The shape of an input that states none: a scalar, or what is asked of it."""
        self._scalars.setdefault(atom, (atom, 0))
        return self.guesses.shapes.get((atom, 0), (1,))

    def wish(self, atom: Atom, shape: Shape) -> None:
        """Note the shape that a block asks of the memory or input before it, in case that no input gives it one."""
        if atom in self._scalars and int(np.prod(shape)) <= _WIDEST_WISH:
            self.wishes.setdefault(self._scalars[atom], shape)

    def widened(self, key: Key) -> str:
        """What is wrong with a memory whose input is a scalar; empty where nothing behind it asks for a vector."""
        wished = self.guesses.wished.get(key)
        return "" if wished is None else f"its input is a scalar where a vector of {wished} is asked of it"
