"""The block types that can be built, each with what its parameters are where no one states them.

A new block is a function with `@block("Type", Parameter="its default")` in a file of its family, imported in
`blocktypes/__init__.py`. The function gets a `Site` and returns its output, or a tuple of them.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from kennfeld.models.simulink.lowering.block_context import Site
from kennfeld.models.simulink.reader.model_tree import Block
from kennfeld.models.simulink.signals import Wired

__all__ = ["KINDS", "Kind", "block", "named_by_masks", "nothing", "opaque"]

Rule: TypeAlias = Callable[[Site], Wired | tuple[Wired, ...]]
Needs: TypeAlias = Callable[[Site], Iterable[int]] | None
Sample: TypeAlias = str | Callable[[Block], str]
_ONE_WORD = ("Difference", "DocBlock", "EnumeratedConstant", "Ramp")


@dataclass(frozen=True)
class Kind:
    """A block type. `needs` gives the inputs that its output depends on within the step; None stands for all.

    `sample` is the parameter that holds its sample time, or says which one does; no parameter is called "". A `linked`
    type is only a link to Simulink's own library: a subsystem whose mask is called alike is looked into. A `refused`
    one is known for the reason why no setting of it can be built. `held` is false where the rule itself says what the
    outputs are between the hits of the sample time.
    """

    name: str
    rule: Rule
    defaults: Mapping[str, str]
    needs: Needs = None
    sink: bool = False
    sample: Sample = "SampleTime"
    linked: bool = False
    refused: bool = False
    held: bool = True

    def sample_of(self, block: Block) -> str:
        """The parameter that holds a block's sample time."""
        return self.sample if isinstance(self.sample, str) else self.sample(block)


KINDS: dict[str, Kind] = {}


def nothing(_: Site) -> Iterable[int]:
    """No input: the output of this step is known before."""
    return ()


def opaque() -> frozenset[str]:
    """The types of masks that are blocks of their own and not looked into.

    Those of Simulink's library are several words, but for a few. A mask that is called like a block type, "Integrator",
    is someone else's.
    """
    return frozenset(name for name, kind in KINDS.items() if not kind.linked and (" " in name or name in _ONE_WORD))


def named_by_masks() -> dict[str, bool]:
    """All types, with whether a mask of Simulink's library may be called so."""
    masks = opaque()
    return {name: kind.linked or name in masks for name, kind in KINDS.items()}


def block(
    *names: str,
    needs: Needs = None,
    sink: bool = False,
    sample: Sample = "SampleTime",
    linked: bool = False,
    refused: bool = False,
    held: bool = True,
    **defaults: str,
) -> Callable[[Rule], Rule]:
    """Enter a function as the rule of block types."""

    def enter(rule: Rule) -> Rule:
        for name in names:
            KINDS[name] = Kind(name, rule, defaults, needs, sink, sample, linked, refused, held)
        return rule

    return enter
