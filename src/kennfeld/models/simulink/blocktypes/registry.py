"""The block types that can be built, each with what its parameters are where no one states them.

A new block is a function with `@block("Type", Parameter="its default")` in a file of its family, imported in
`blocktypes/__init__.py`. The function gets a `Site` and returns its output, or a tuple of them.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from kennfeld.models.simulink.signals import Wired

if TYPE_CHECKING:
    from kennfeld.models.simulink.site import Site

__all__ = ["KINDS", "Kind", "Needs", "Rule", "UnsupportedError", "block", "nothing"]

Rule: TypeAlias = "Callable[[Site], Wired | tuple[Wired, ...]]"
Needs: TypeAlias = "Callable[[Site], Iterable[int]] | None"


class UnsupportedError(Exception):
    """A block, or a setting of it, that cannot be built; `mend` says what would help."""

    def __init__(self, what: str, mend: str = "") -> None:
        super().__init__(what)
        self.what, self.mend = what, mend


@dataclass(frozen=True)
class Kind:
    """A block type. `needs` gives the inputs that its output depends on within the step; None stands for all.

    `held` is false where the rule itself says what the outputs are between the hits of the sample time.
    """

    name: str
    rule: Rule
    defaults: Mapping[str, str]
    needs: Needs = None
    sink: bool = False
    held: bool = True


KINDS: dict[str, Kind] = {}


def nothing(_: "Site") -> Iterable[int]:
    """No input: the output of this step is known before."""
    return ()


def block(
    *names: str, needs: Needs = None, sink: bool = False, held: bool = True, **defaults: str
) -> Callable[[Rule], Rule]:
    """Enter a function as the rule of block types."""

    def enter(rule: Rule) -> Rule:
        for name in names:
            KINDS[name] = Kind(name, rule, defaults, needs, sink, held)
        return rule

    return enter
