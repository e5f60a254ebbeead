"""Variants: which of several choices is active, and what that leaves of a block.

A variant subsystem holds its choices side by side, each with a label; its ports are those of the choices by their
names. A variant source or sink passes on one of its inputs or outputs.

Blocks that are commented out, or through.

What is commented out is as if it were not drawn: whatever it feeds reads 0. What is commented through passes its inputs
on to the outputs of the same numbers.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from kennfeld.graph.builder import GraphBuilder
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.simulink.calibration_parameters import DeclaredParameters
from kennfeld.models.simulink.expressions.parameter_expressions import Expressions
from kennfeld.models.simulink.flattening.iterated_subsystems import iterator_block
from kennfeld.models.simulink.reader.block_ports import port_number
from kennfeld.models.simulink.reader.model_tree import Endpoint, ModelBlock, SignalLine, System
from kennfeld.models.simulink.variables.mask_scope import Scope, Variable

__all__ = [
    "active_choice",
    "active_content",
    "choice_labels",
    "describe_choice",
    "is_variant",
    "member",
    "system_with_choice",
    "without_commented_blocks",
]

_PORTS = ("Inport", "Outport")
_BLOCKS = ("VariantSource", "VariantSink")
_MODES = ("expression", "label", "sim codegen switching")


def active_choice(block: ModelBlock, labels: Sequence[str], scope: Scope) -> int | None:
    """The number of the active choice of a block, counted from 0; None where none has to be.

    Raises `NoValueError` where the settings of the block do not decide.
    """
    if block.type == "ModelReference":
        raise EvaluationError("it chooses between models by itself, as before R2017b; put a variant subsystem there")
    if (block.value("VariantChoicesSpecifier") or "").strip():
        raise EvaluationError("it is a variant assembly, whose choices are files")
    written = block.value("VariantControlMode")
    named = (block.value("LabelModeActiveChoice") or "").strip()
    over = (block.value("OverrideUsingVariant") or "").strip()
    mode = written or ("label" if named else "expression")
    if mode not in _MODES:
        raise EvaluationError(f"VariantControlMode is {mode[:60]!r}, which is not supported")
    if mode == "label" or (mode == "expression" and over):
        return _labelled(labels, named if mode == "label" else over)
    return _true(block, labels, scope)


def _true(block: ModelBlock, labels: Sequence[str], scope: Scope) -> int | None:
    """The choice whose variant control is true, else the default."""
    found = [at for at, label in enumerate(labels) if _holds(label, scope)]
    if len(found) > 1:
        raise EvaluationError(f"several of its variants are active: {', '.join(labels[at] for at in found)}")
    found = found or [at for at, label in enumerate(labels) if label.strip() == "(default)"][:1]
    if not found and (block.value("AllowZeroVariantControls") or "off") != "on":
        raise EvaluationError(f"none of its variants is active: {', '.join(labels) or 'it has none'}")
    return found[0] if found else None


def _holds(label: str, scope: Scope) -> bool:
    """Whether a variant control is true; one that is commented out is not."""
    text = label.strip()
    if not text or text.startswith("%") or text in ("(default)", "(codegen)"):
        return False
    if text == "(sim)":
        return True
    numbers = Expressions(GraphBuilder(), DeclaredParameters()).numbers(condition_of(text, scope), scope)
    if numbers.size != 1:
        raise EvaluationError(f"its variant control {text[:60]} has {numbers.size} values where one is expected")
    return bool(numbers.item())


def condition_of(label: str, scope: Scope) -> str:
    """The expression that a variant control stands for: that of the Simulink.Variant of this name, or itself."""
    found = scope.find(label) if label.isidentifier() else None
    value = found.value if isinstance(found, Variable) else None
    condition = value.get("Condition") if isinstance(value, Mapping) else None
    return condition if isinstance(condition, str) else label


def _labelled(labels: Sequence[str], label: str) -> int:
    for at, one in enumerate(labels):
        if one.strip() == label:
            return at
    raise EvaluationError(
        f"its active variant {label[:60] or '(none)'} is not among {', '.join(labels) or 'its variants'}"
    )


def is_variant(block: ModelBlock) -> bool:
    """Whether a block is a subsystem of variants, or a source or sink of them."""
    holds = block.type in ("SubSystem", "ModelReference") and (block.value("Variant") or "off") == "on"
    return holds or block.type in _BLOCKS


def choices(system: System) -> tuple[ModelBlock, ...]:
    """The choices of a variant subsystem, in the order of the file."""
    return tuple(system.of("SubSystem", "ModelReference", "Reference"))


def choice_labels(block: ModelBlock) -> tuple[str, ...]:
    """The variant controls of a block's choices."""
    if block.type in _BLOCKS:
        return block.listed("VariantControls")
    return tuple((one.value("VariantControl") or "").strip() for one in choices(block.system or System()))


def member(block: ModelBlock, number: int) -> ModelBlock:
    """A choice of a variant subsystem, by its number from 0."""
    return choices(block.system or System())[number]


def _is_port(block: ModelBlock) -> bool:
    return block.type in _PORTS or block.type.endswith("Port")


def active_content(block: ModelBlock, scope: Scope) -> tuple[System, str]:
    """The content of a subsystem, of one of variants with the active one alone, which is said in words.

    Raises `NoValueError` where none is.
    """
    if block.system is not None and iterator_block(block.system) is not None:
        raise EvaluationError("it runs several times in a step; import the system around it")
    if not is_variant(block) or block.system is None:
        return block.system or System(), ""
    labels = choice_labels(block)
    at = active_choice(block, labels, scope)
    return system_with_choice(block, member(block, at) if at is not None else None), describe_choice(labels, at, scope)


def describe_choice(labels: Sequence[str], at: int | None, scope: Scope) -> str:
    """Which variant is active, in words."""
    if at is None:
        return "none of its variants is active"
    meant = condition_of(labels[at], scope)
    return f"the variant {labels[at]}{f' ({meant})' if meant != labels[at] else ''} is active"


def system_with_choice(block: ModelBlock, choice: ModelBlock | None) -> System:
    """What a variant subsystem is with one of its choices: the ports of both are joined by their names.

    Raises `NoValueError` where the choice has a port that the variant subsystem does not have.
    """
    outer = block.system or System()
    kept = tuple(one for one in outer.blocks if _is_port(one))
    if choice is None:
        return System(kept)
    lines = []
    for kind, port in (("Inport", "in"), ("Outport", "out")):
        for name, number in _ports(choice, kind):
            outside = _outside(outer, kind, name, number)
            if outside is None:
                raise EvaluationError(f"its variant {choice.name} has the port {name}, which it does not have itself")
            ends = (Endpoint(outside.sid, "out"), Endpoint(choice.sid, "in", number))
            if port == "out":
                ends = (Endpoint(choice.sid, "out", number), Endpoint(outside.sid, "in"))
            lines.append(SignalLine(ends[0], (ends[1],)))
    return System((*kept, choice), tuple(lines))


def _ports(choice: ModelBlock, kind: str) -> list[tuple[str, int]]:
    """The ports of a choice: name and number; without names where its content is not there."""
    if choice.system is not None:
        return [(one.name, port_number(one)) for one in choice.system.of(kind)]
    count = (choice.ports.inputs if kind == "Inport" else choice.ports.outputs) if choice.ports is not None else 1
    return [("", number) for number in range(1, count + 1)]


def _outside(outer: System, kind: str, name: str, number: int) -> ModelBlock | None:
    """The port of the variant subsystem of a name, or of a number where there are no names."""
    return next((one for one in outer.of(kind) if (one.name == name if name else port_number(one) == number)), None)


def without_commented_blocks(system: System) -> System:
    """A level without its commented blocks, its lines led past them."""
    commented = {block.sid: _how(block) for block in system.blocks if _how(block) in ("on", "through")}
    if not commented:
        return system
    return System(
        tuple(block for block in system.blocks if block.sid not in commented), tuple(_lines(system, commented))
    )


def _how(block: ModelBlock) -> str:
    return (block.parameters.get("Commented") or "off").strip()


def _lines(system: System, commented: Mapping[str, str]) -> Iterator[SignalLine]:
    sources = {end: line.source for line in system.lines for end in line.destinations}
    for line in system.lines:
        ends = tuple(end for end in line.destinations if end.block not in commented)
        source = _past(line.source, sources, commented)
        if ends and source is not None:
            yield replace(line, source=source, destinations=ends)


def _past(
    source: Endpoint | None, sources: Mapping[Endpoint, Endpoint | None], commented: Mapping[str, str]
) -> Endpoint | None:
    """Where a signal begins, once the blocks that are commented through are wires."""
    seen: set[Endpoint] = set()
    while source is not None and source.block in commented:
        if commented[source.block] == "on" or source.port != "out" or source in seen:
            return None
        seen.add(source)
        source = sources.get(Endpoint(source.block, "in", source.number))
    return source
