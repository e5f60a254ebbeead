"""What is raised where an expression has no value, or none that a graph can say."""

__all__ = ["BeyondGraphError", "NoValueError"]


class NoValueError(Exception):
    """An expression has no value here; the text says why. `undefined` is the variable that nothing gives a value."""

    def __init__(self, why: str, undefined: str = "") -> None:
        super().__init__(why)
        self.undefined = undefined


class BeyondGraphError(Exception):
    """An expression that only numbers can tell; `function` is the one in it, if that is why."""

    def __init__(self, why: str, function: str = "") -> None:
        super().__init__(why)
        self.function = function
