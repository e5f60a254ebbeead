"""The block types that can be built, each with what its parameters are where no one states them.

A new block is a function with `@block("Type", Parameter="its default")` in a file of its family, imported in
`blocktypes/__init__.py`. The function gets a `Site` and returns its output, or a tuple of them.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from kennfeld.models.simulink.lowering.block_context import BlockContext
from kennfeld.models.simulink.reader.model_tree import ModelBlock
from kennfeld.models.simulink.signals import SignalOrBus

__all__ = ["BLOCK_TYPES", "BlockType", "block", "maskable_types", "no_feedthrough", "opaque_mask_types"]

BlockHandler: TypeAlias = Callable[[BlockContext], SignalOrBus | tuple[SignalOrBus, ...]]
FeedthroughRule: TypeAlias = Callable[[BlockContext], Iterable[int]] | None
Sample: TypeAlias = str | Callable[[ModelBlock], str]
_ONE_WORD = ("Difference", "DocBlock", "EnumeratedConstant", "Ramp")


@dataclass(frozen=True)
class BlockType:
    """A block type. `needs` gives the inputs that its output depends on within the step; None stands for all.

    `sample` is the parameter that holds its sample time, or says which one does; no parameter is called "". A `linked`
    type is only a link to Simulink's own library: a subsystem whose mask is called alike is looked into. A `refused`
    one is known for the reason why no setting of it can be built. `held` is false where the rule itself says what the
    outputs are between the hits of the sample time.
    """

    name: str
    rule: BlockHandler
    defaults: Mapping[str, str]
    needs: FeedthroughRule = None
    sink: bool = False
    sample: Sample = "SampleTime"
    linked: bool = False
    refused: bool = False
    held: bool = True

    def sample_of(self, block: ModelBlock) -> str:
        """The parameter that holds a block's sample time."""
        return self.sample if isinstance(self.sample, str) else self.sample(block)


BLOCK_TYPES: dict[str, BlockType] = {}


def no_feedthrough(_: BlockContext) -> Iterable[int]:
    """No input: the output of this step is known before."""
    return ()


def opaque_mask_types() -> frozenset[str]:
    """The types of masks that are blocks of their own and not looked into.

    Those of Simulink's library are several words, but for a few. A mask that is called like a block type, "Integrator",
    is someone else's.
    """
    return frozenset(
        name for name, kind in BLOCK_TYPES.items() if not kind.linked and (" " in name or name in _ONE_WORD)
    )


def maskable_types() -> dict[str, bool]:
    """All types, with whether a mask of Simulink's library may be called so."""
    masks = opaque_mask_types()
    return {name: kind.linked or name in masks for name, kind in BLOCK_TYPES.items()}


def block(
    *names: str,
    needs: FeedthroughRule = None,
    sink: bool = False,
    sample: Sample = "SampleTime",
    linked: bool = False,
    refused: bool = False,
    held: bool = True,
    **defaults: str,
) -> Callable[[BlockHandler], BlockHandler]:
    """Enter a function as the rule of block types."""

    def enter(rule: BlockHandler) -> BlockHandler:
        for name in names:
            BLOCK_TYPES[name] = BlockType(name, rule, defaults, needs, sink, sample, linked, refused, held)
        return rule

    return enter
