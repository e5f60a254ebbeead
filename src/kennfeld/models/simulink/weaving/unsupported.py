"""What a block, or a setting of it, raises where it cannot be built."""

__all__ = ["UnsupportedError"]


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
