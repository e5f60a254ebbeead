"""The block types that can be built, each with what its parameters are where no one states them.

A new block is a function with `@block("Type", Parameter="its default")` in a file of its family, imported in
`blocktypes/__init__.py`. The function gets a `Site` and returns its output, or a tuple of them.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from kennfeld.models.simulink.signals import Wired
from kennfeld.models.simulink.site import Site
from kennfeld.models.simulink.unsupported import UnsupportedError

__all__ = ["KINDS", "Kind", "Needs", "Rule", "UnsupportedError", "block", "nothing"]

Rule: TypeAlias = Callable[[Site], Wired | tuple[Wired, ...]]
Needs: TypeAlias = Callable[[Site], Iterable[int]] | None


@dataclass(frozen=True)
class Kind:
    """A block type. `needs` gives the inputs that its output depends on within the step; None stands for all."""

    name: str
    rule: Rule
    defaults: Mapping[str, str]
    needs: Needs = None
    sink: bool = False


KINDS: dict[str, Kind] = {}


def nothing(_: Site) -> Iterable[int]:
    """No input: the output of this step is known before."""
    return ()


def block(*names: str, needs: Needs = None, sink: bool = False, **defaults: str) -> Callable[[Rule], Rule]:
    """Enter a function as the rule of block types."""

    def enter(rule: Rule) -> Rule:
        for name in names:
            KINDS[name] = Kind(name, rule, defaults, needs, sink)
        return rule

    return enter
