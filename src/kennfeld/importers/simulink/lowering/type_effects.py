"""Effects of integer and fixed-point types: limits of those that saturate are kept, other effects are reported.

Values stay physical and are not rounded: a rounded model has derivatives of 0 almost everywhere, with which nothing
can be calibrated.
"""

from collections.abc import Callable, Iterable
from typing import Final

from kennfeld.base.formatting import join_names
from kennfeld.importers.simulink.flattening.flat_model import FlatBlock
from kennfeld.importers.simulink.lowering.integer_signals import INTEGER_CAST, fixed_point_type_of, is_saturating
from kennfeld.importers.simulink.lowering.registry import BLOCK_TYPES, output_type_of
from kennfeld.importers.simulink.variables.data_types import (
    FixedPointType,
    UndefinedType,
    has_type_of_input,
    has_type_of_readers,
)
from kennfeld.models.imperative.integer_types import integer_type_named

_ASSIGNED: Final = ("LOCAL_DATA", "OUTPUT_DATA")
_STATES_TYPE: Final = ("Outport", "SignalSpecification")
_MAX_NAMED: Final = 3

Readers = Callable[[FlatBlock], Iterable[FlatBlock]]


def converted_type(flat: FlatBlock, readers: Readers) -> FixedPointType | UndefinedType | None:
    """Return the type to which a block converts its result, None if that is a floating-point or unknown type."""
    kind = flat.output_type
    if isinstance(kind, FixedPointType | UndefinedType):
        return kind
    if has_type_of_input(flat.block) and flat.inputs:
        return fixed_point_type_of(flat.inputs[0])
    if flat.type == "DataTypeConversion" and has_type_of_readers(flat.block):
        return _type_of_readers(flat, readers)
    return None


def _type_of_readers(flat: FlatBlock, readers: Readers) -> FixedPointType | None:
    """Return the type that all readers of a signal require of it, None if one of them does not state a type."""
    kinds = set()
    for reader in readers(flat):
        # what only displays a signal accepts any type
        if reader.type in BLOCK_TYPES and BLOCK_TYPES[reader.type].sink and reader.type != "Outport":
            continue
        kinds.add(reader.output_type if reader.type in _STATES_TYPE else None)
    kind = kinds.pop() if len(kinds) == 1 else None
    return kind if isinstance(kind, FixedPointType) else None


def saturation_limits(flat: FlatBlock, readers: Readers) -> tuple[float, float] | None:
    """Return the smallest and largest value of the type to which a block converts, None if values are not limited."""
    # the type of an inport or a constant says what values are, it does not change them
    if not is_saturating(flat) or output_type_of(flat).states:
        return None
    kind = converted_type(flat, readers)
    return kind.limits if isinstance(kind, FixedPointType) else None


def ignored_effects(blocks: Iterable[FlatBlock], readers: Readers) -> tuple[str, ...]:
    """Return a sentence on each effect of types that is ignored, with the blocks in which Simulink has it."""
    # a model may have thousands of such blocks: a sentence for each kind, not for each block
    named: dict[str, dict[str, None]] = {}
    for flat in blocks:
        if effect := _ignored_effect(flat, readers):
            sentence, name = effect
            named.setdefault(sentence, {})[name] = None
    return tuple(sentence.format(names=join_names(list(names), _MAX_NAMED)) for sentence, names in named.items())


def _ignored_effect(flat: FlatBlock, readers: Readers) -> tuple[str, str] | None:
    """Return the sentence that applies to a block, and the block as it is named there."""
    if not output_type_of(flat).converts:
        # types that are only stated, as that of an inport, say that the values are as the type requires
        return None
    kind = converted_type(flat, readers)
    if isinstance(kind, UndefinedType):
        name = f"{flat.path} ({kind.name})"
        return "data types that are not defined are ignored in {names}: Simulink may round and limit values there", name
    if kind is None:
        code = "integer types are ignored in {names}: Simulink rounds there, and wraps or saturates"
        return (code, flat.path) if _casts_in_code(flat) else None
    rest = "Simulink rounds there" if is_saturating(flat) else "Simulink rounds there, and wraps beyond their limits"
    kept = ", except for their limits" if is_saturating(flat) else ""
    if kind.is_integer:
        return f"integer types are ignored in {{names}}{kept}: {rest}", flat.path
    return f"fixed-point types are ignored in {{names}}{kept}: {rest}", f"{flat.path} ({kind})"


def _casts_in_code(flat: FlatBlock) -> bool:
    """Return True if a block converts to integers by a cast in its code or in a chart variable."""
    if INTEGER_CAST.search(flat.block.script):
        return True
    chart = flat.block.chart if flat.type == "Chart" else None
    return chart is not None and any(integer_type_named(data.type) for data in chart.data if data.scope in _ASSIGNED)
