"""Registry of block types and their default fields.

To add a block, write a function with `@block("Type", Field="default")` in the module of its library in `blocks`. It
gets a `BlockContext` and returns its output, or a tuple of outputs. All else that the importer knows of a block type
is an argument of `block`.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeAlias, TypeVar

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.flattening.flat_model import FlatBlock
from kennfeld.importers.simulink.reader.model_tree import ModelBlock
from kennfeld.importers.simulink.signals import SignalOrBus

Outputs: TypeAlias = SignalOrBus | tuple[SignalOrBus, ...]
# the argument of handlers and rules is a `BlockContext`, a type of the layer above
BlockHandler: TypeAlias = Callable[[Any], Outputs]
FeedthroughRule: TypeAlias = Callable[[Any], Iterable[int]] | None
Sample: TypeAlias = str | Callable[[ModelBlock], str]
Handler = TypeVar("Handler", bound=BlockHandler)


@dataclass(frozen=True)
class OutputType:
    """The type of an output as it follows from those of the inputs, unless the file specifies another one.

    Attributes:
        inputs: numbers of the inputs whose type the output has.
        floating: True if the output is a floating-point number if all inputs are.
        states: True if a specified integer type says that the values are integers already; else they are converted.
            Types of outputs that have the type of an input are only stated, too.
    """

    inputs: tuple[int, ...] = ()
    floating: bool = False
    states: bool = False

    @property
    def converts(self) -> bool:
        """True if a specified integer type converts values to integers."""
        return not self.states and not self.inputs


COMPUTED = OutputType()
ARITHMETIC = OutputType(floating=True)
LIKE_INPUT = OutputType((0,), floating=True)


@dataclass(frozen=True)
class BlockType:
    """A block type.

    Attributes:
        output: the type of the output, if the file specifies none.
        needs: returns the inputs with feedthrough; None for all.
        sample: name of the field with the sample time, or a function that returns it; "" for none.
        linked: True if the type is only a link into a Simulink library; a subsystem with a mask of that name is opened.
        refused: True if no setting of the type is supported; the handler raises the reason.
        held: False if the handler itself computes the outputs between sample hits.
        continuous: True if the block has continuous states.
        library_mask: True if a mask of Simulink's library has that type although it is one word.
        routes: True if the type only arranges its inputs, placeholders of unsupported ones included.
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
    output: OutputType = COMPUTED
    continuous: bool = False
    library_mask: bool = False
    routes: bool = False

    def sample_of(self, block: ModelBlock) -> str:
        """Return the field with the sample time of a block."""
        return self.sample if isinstance(self.sample, str) else self.sample(block)


BLOCK_TYPES: dict[str, BlockType] = {}


def output_type_of(flat: FlatBlock) -> OutputType:
    """Return how the output type of a block follows from its inputs."""
    return BLOCK_TYPES[flat.type].output if flat.type in BLOCK_TYPES else COMPUTED


def has_continuous_states(flat: FlatBlock) -> bool:
    """Return True for block types with continuous states."""
    return flat.type in BLOCK_TYPES and BLOCK_TYPES[flat.type].continuous


def field_text(flat: FlatBlock, name: str) -> str | None:
    """Return a field as written, else its default, None if there is none."""
    written = flat.block.value(name)
    # order: the block itself, its mask, the link to a library, the default of the type
    if written is None and flat.block.mask is not None:
        written = next((p.expression for p in flat.block.mask.parameters if p.name == name), None)
    if written is None and flat.block.reference is not None:
        written = flat.block.reference.parameters.get(name)
    if written is None and flat.type in BLOCK_TYPES:
        written = BLOCK_TYPES[flat.type].defaults.get(name)
    return written


def no_feedthrough(_: Any) -> Iterable[int]:
    """Return no inputs: the output depends only on previous steps."""
    return ()


def opaque_mask_types() -> frozenset[str]:
    """Return the mask types that are blocks of their own and not opened.

    Those of Simulink's library mostly contain blanks. A mask named like a block type, such as "Integrator", is a
    user's.
    """
    return frozenset(
        name for name, kind in BLOCK_TYPES.items() if not kind.linked and (" " in name or kind.library_mask)
    )


def maskable_types() -> dict[str, bool]:
    """Return all types, True if a mask of Simulink's library may have that type."""
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
    output: OutputType = COMPUTED,
    continuous: bool = False,
    library_mask: bool = False,
    routes: bool = False,
    **defaults: str,
) -> Callable[[Handler], Handler]:
    """Register a function as the handler of block types."""

    def enter(rule: Handler) -> Handler:
        for name in names:
            BLOCK_TYPES[name] = BlockType(
                name,
                rule,
                defaults,
                needs,
                sink,
                sample,
                linked,
                refused,
                held,
                output,
                continuous,
                library_mask,
                routes,
            )
        return rule

    return enter
