"""Active variants and commented-out blocks.

A variant subsystem contains its choices side by side, each with a label; its ports are matched to those of the choices
by name. A variant source or sink passes on one of its inputs or outputs. Commented-out blocks are removed, and what
they feed reads 0; blocks commented through connect each input to the output of the same number.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.simulink.calibration_parameters import DeclaredParameters
from kennfeld.importers.simulink.expressions.parameter_expressions import ParameterExpressions
from kennfeld.importers.simulink.flattening.iterated_subsystems import iterator_block
from kennfeld.importers.simulink.reader.block_ports import port_number
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.reader.model_tree import Endpoint, ModelBlock, SignalLine, System
from kennfeld.importers.simulink.variables.mask_scope import Scope, Variable
from kennfeld.models.imperative.evaluation_errors import EvaluationError

_PORTS = ("Inport", "Outport")
_BLOCKS = ("VariantSource", "VariantSink")
_MODES = ("expression", "label", "sim codegen switching")


def active_choice(block: ModelBlock, labels: Sequence[str], scope: Scope) -> int | None:
    """Determine the index of the active choice of a variant block, None if none needs to be active.

    Raises:
        EvaluationError: if the settings of the block do not determine it.
    """
    if block.type == "ModelReference":
        raise EvaluationError("it is a Model block with variants (before R2017b); use a variant subsystem instead")
    if (block.value("VariantChoicesSpecifier") or "").strip():
        raise EvaluationError("it is a Variant Assembly Subsystem, whose choices are files; this is not supported")
    named = (block.value("LabelModeActiveChoice") or "").strip()
    # names a choice by its label, whatever the controls say
    over = (block.value("OverrideUsingVariant") or "").strip()
    # older files have no mode: a label that is chosen says which one it is
    written = block.value("VariantControlMode") or ("label" if named else "expression")
    mode = match_word(written, _MODES)
    if mode is None:
        raise EvaluationError(f"VariantControlMode {written[:60]!r} is not supported")
    if mode == "label" or (mode == "expression" and over):
        return _choice_labelled(labels, named if mode == "label" else over)
    return _true_choice(block, labels, scope)


def _true_choice(block: ModelBlock, labels: Sequence[str], scope: Scope) -> int | None:
    """Return the index of the choice whose variant control is true, else of the default."""
    active = [at for at, label in enumerate(labels) if _is_true(label, scope)]
    if len(active) > 1:
        raise EvaluationError(f"several of its variants are active: {', '.join(labels[at] for at in active)}")
    active = active or [at for at, label in enumerate(labels) if label.strip() == "(default)"][:1]
    if not active and not block.is_set_to("AllowZeroVariantControls", "on"):
        raise EvaluationError(f"none of its variants is active: {', '.join(labels) or 'it has none'}")
    return active[0] if active else None


def _is_true(label: str, scope: Scope) -> bool:
    """Return True if a variant control is true; commented-out ones are false."""
    text = label.strip()
    if not text or text.startswith("%") or text in ("(default)", "(codegen)"):
        return False
    # an import simulates, so that (sim) is active and (codegen) is not
    if text == "(sim)":
        return True
    numbers = ParameterExpressions(GraphBuilder(), DeclaredParameters()).numbers(condition_of(text, scope), scope)
    if numbers.size != 1:
        raise EvaluationError(f"its variant control {text[:60]} must be scalar, got {numbers.size} values")
    return bool(numbers.item())


def condition_of(label: str, scope: Scope) -> str:
    """Look up the expression of a variant control: that of the Simulink.Variant of this name, or itself."""
    variable = scope.find(label) if label.isidentifier() else None
    value = variable.value if isinstance(variable, Variable) else None
    condition = value.get("Condition") if isinstance(value, Mapping) else None
    return condition if isinstance(condition, str) else label


def _choice_labelled(labels: Sequence[str], label: str) -> int:
    for at, text in enumerate(labels):
        if text.strip() == label:
            return at
    known = ", ".join(labels) or "its variants"
    raise EvaluationError(f"its active variant {label[:60] or '(none)'} is not one of {known}")


def is_variant(block: ModelBlock) -> bool:
    """Return True if a block is a variant subsystem, source or sink."""
    holds = block.type in ("SubSystem", "ModelReference") and block.is_set_to("Variant", "on")
    return holds or block.type in _BLOCKS


def choices(system: System) -> tuple[ModelBlock, ...]:
    """List the choices of a variant subsystem in file order."""
    return tuple(system.of("SubSystem", "ModelReference", "Reference"))


def choice_labels(block: ModelBlock) -> tuple[str, ...]:
    """List the variant controls of a block's choices."""
    if block.type in _BLOCKS:
        return block.listed("VariantControls")
    return tuple((choice.value("VariantControl") or "").strip() for choice in choices(block.system or System()))


def active_content(block: ModelBlock, scope: Scope) -> System:
    """Select the active variant of a subsystem, and return its content.

    Raises:
        EvaluationError: if no variant is active.
    """
    if block.system is not None and iterator_block(block.system) is not None:
        raise EvaluationError("it is in an iterated subsystem; import the enclosing system")
    if not is_variant(block) or block.system is None:
        return block.system or System()
    return system_with_choice(block, active_choice(block, choice_labels(block), scope))


def describe_choice(labels: Sequence[str], at: int | None, scope: Scope) -> str:
    """Describe the active variant in a sentence."""
    if at is None:
        return "none of its variants is active"
    meant = condition_of(labels[at], scope)
    return f"the variant {labels[at]}{f' ({meant})' if meant != labels[at] else ''} is active"


def system_with_choice(block: ModelBlock, at: int | None) -> System:
    """Build the system of a variant subsystem with one choice, by index from 0, their ports joined by name.

    Raises:
        EvaluationError: if the choice has a port that the variant subsystem lacks.
    """
    outer = block.system or System()
    # ports of the subsystem and its control ports, such as EnablePort
    kept = tuple(block for block in outer.blocks if block.type in _PORTS or block.type.endswith("Port"))
    if at is None:
        return System(kept)
    choice, lines = choices(outer)[at], []
    for kind in _PORTS:
        for name, number in _ports(choice, kind):
            outside = _outer_port(outer, kind, name, number)
            if outside is None:
                problem = f"has a port {name}, which the variant subsystem does not have"
                raise EvaluationError(f"its variant {choice.name} {problem}")
            if kind == "Inport":
                lines.append(SignalLine(Endpoint(outside.sid, "out"), (Endpoint(choice.sid, "in", number),)))
            else:
                lines.append(SignalLine(Endpoint(choice.sid, "out", number), (Endpoint(outside.sid, "in"),)))
    return System((*kept, choice), tuple(lines))


def _ports(choice: ModelBlock, kind: str) -> list[tuple[str, int]]:
    """Return name and number of the ports of a choice; the names are empty if its content was not found."""
    if choice.system is not None:
        return [(block.name, port_number(block)) for block in choice.system.of(kind)]
    count = (choice.ports.inputs if kind == "Inport" else choice.ports.outputs) if choice.ports is not None else 1
    return [("", number) for number in range(1, count + 1)]


def _outer_port(outer: System, kind: str, name: str, number: int) -> ModelBlock | None:
    """Return the port of a variant subsystem by name, or by number if the names are unknown."""
    ports = (block for block in outer.of(kind) if (block.name == name if name else port_number(block) == number))
    return next(ports, None)


def without_commented_blocks(system: System) -> System:
    """Remove the commented blocks of a system, and reroute its lines."""
    commented = {block.sid: _how(block) for block in system.blocks if _how(block) in ("on", "through")}
    if not commented:
        return system
    kept = tuple(block for block in system.blocks if block.sid not in commented)
    lines = tuple(_lines(system, commented))
    # by destination, the commented block that fed it, for the report
    fed = {
        end: system.by_sid[line.source.block].name
        for line in lines
        if line.source is not None and line.source.block in commented
        for end in line.destinations
    }
    connected = tuple(line for line in lines if line.source is not None and line.source.block not in commented)
    return System(kept, connected, fed)


def _how(block: ModelBlock) -> str:
    return match_word(block.parameters.get("Commented") or "off", ("on", "through")) or "off"


def _lines(system: System, commented: Mapping[str, str]) -> Iterator[SignalLine]:
    sources = {end: line.source for line in system.lines for end in line.destinations}
    for line in system.lines:
        ends = tuple(end for end in line.destinations if end.block not in commented)
        source = _trace_commented(line.source, sources, commented)
        if ends:
            yield replace(line, source=source, destinations=ends)


def _trace_commented(
    source: Endpoint | None, sources: Mapping[Endpoint, Endpoint | None], commented: Mapping[str, str]
) -> Endpoint | None:
    """Return the origin of a signal, seen through blocks that are commented through; it may be commented out."""
    # blocks that are commented through may form a ring, which has no origin
    seen: set[Endpoint] = set()
    while source is not None and source.block in commented:
        if commented[source.block] == "on" or source.port != "out" or source in seen:
            return source
        seen.add(source)
        source = sources.get(Endpoint(source.block, "in", source.number))
    return source
