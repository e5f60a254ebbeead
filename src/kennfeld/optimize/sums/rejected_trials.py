"""`RejectedTrials`: trial values at which a model failed."""

from kennfeld.base.arrays import Float


class RejectedTrials:
    """Counts trial values whose cost is not finite, and stores the first few."""

    MAX_STORED = 8

    def __init__(self) -> None:
        self.count = 0
        self.first: list[Float] = []

    def add(self, values: Float) -> None:
        self.count += 1
        if len(self.first) < self.MAX_STORED:
            self.first.append(values.copy())

    def clear(self) -> None:
        self.count, self.first = 0, []
