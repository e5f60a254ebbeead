"""How much a script may do before it is stopped: nothing that is read may take the machine with it."""

from dataclasses import dataclass

__all__ = ["Budget", "LimitError"]


class LimitError(Exception):
    """A script does more than any parameter script has to."""


@dataclass
class Budget:
    """What is left: `steps` of the evaluator, `elements` of the arrays it makes, `calls` of functions within others."""

    steps: int = 1_000_000
    elements: int = 50_000_000
    calls: int = 15

    def step(self, cost: int = 1) -> None:
        """One more expression or statement; `cost` is more than 1 for what takes longer than most."""
        self.steps -= cost
        if self.steps < 0:
            raise LimitError("the script takes too many steps")

    def make(self, count: float) -> None:
        """Room for so many elements."""
        if not count <= self.elements:
            raise LimitError("the script asks for too much memory")
        self.elements -= int(count)
