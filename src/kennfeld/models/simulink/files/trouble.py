"""What is noticed while a Simulink file is read: errors refuse it, remarks go with the document."""

from dataclasses import dataclass, field

from kennfeld.errors import Finding, InputError

__all__ = ["RefusedError", "Trouble"]

_MOST = 50  # findings that are kept of each sort; a garbled file has thousands of them


class RefusedError(Exception):
    """Ends the reading of one part of a file; what is wrong is noted already."""


@dataclass
class Trouble:
    """The findings of one file."""

    file: str
    errors: list[Finding] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def error(self, place: str, what: str, mend: str = "") -> None:
        """Note what makes the file unusable; `place` is within the file and may be empty."""
        if len(self.errors) < _MOST:
            self.errors.append(Finding(f"{self.file} {place}".rstrip(), what, mend))

    def refuse(self, place: str, what: str, mend: str = "") -> RefusedError:
        """Note what makes the file unusable, and the exception that ends its reading."""
        self.error(place, what, mend)
        return RefusedError()

    def remark(self, sentence: str) -> None:
        """Note what was left aside."""
        if len(self.remarks) < _MOST:
            self.remarks.append(sentence)

    def settle(self) -> tuple[str, ...]:
        """The remarks; raises `InputError` with every finding if there was an error."""
        if self.errors:
            raise InputError(self.errors)
        return tuple(self.remarks)
