"""How a block says that it cannot be built."""

__all__ = ["UnsupportedError"]


class UnsupportedError(Exception):
    """A block, or a setting of it, that cannot be built; `mend` says what would help."""

    def __init__(self, what: str, mend: str = "") -> None:
        super().__init__(what)
        self.what, self.mend = what, mend
