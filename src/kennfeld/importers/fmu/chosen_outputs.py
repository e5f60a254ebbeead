"""Choice of the variables of an FMU that become nodes: its outputs, and others by their names.

Many tools export models without outputs; each numeric variable that an FMU computes can be read nevertheless.
"""

import re
from collections.abc import Iterator, Sequence
from hashlib import blake2b
from pathlib import Path

from kennfeld.base.errors import Findings, Location
from kennfeld.base.formatting import join_names, nearest
from kennfeld.importers.fmu.description import FmuDescription, FmuVariable

_COMPUTED = ("local", "output", "calculatedParameter")
_MOST_NAMES = 8
SEPARATOR = "\n"  # of names in the arguments of a loader; XML has none in an attribute


def computed_variables(description: FmuDescription) -> tuple[FmuVariable, ...]:
    """Return the numbers and booleans that an FMU computes, states first, then derivatives and others."""
    states = {v.name for v in description.states}
    derivatives = {d.variable.name for d in description.derivatives}
    # parameters and inputs are set, not computed: as nodes they would only repeat what the caller gave
    computed = [v for v in description.numbers if v.causality in _COMPUTED]
    return tuple(sorted(computed, key=lambda v: (v.name not in states, v.name not in derivatives)))


def choose_outputs(description: FmuDescription, patterns: Sequence[str], path: Path) -> tuple[str, ...]:
    """Return the names of variables to be nodes in addition to the outputs; without outputs and patterns, the states.

    Args:
        description: the FMU.
        patterns: names of variables or of their elements, or patterns of them with `*` and `?`.
        path: its file, for messages.

    Raises:
        InputError: a pattern fits no variable that the FMU computes.
    """
    if not patterns:
        return () if description.number_outputs else tuple(v.name for v in description.states)
    computed, findings, chosen = computed_variables(description), Findings(), dict[str, None]()
    for pattern in patterns:
        # brackets are part of names, such as `pipe[1].p`, not of patterns
        expression = re.compile(re.escape(pattern).replace(r"\*", ".*").replace(r"\?", "."))
        matching = [v.name for v in computed if any(map(expression.fullmatch, _names(v)))]
        if not matching:
            findings.error(Location(path.name), *_unknown(description, computed, pattern))
        chosen |= dict.fromkeys(matching)
    findings.finish()
    # outputs come first in any case, so that an existing call does not change its meaning
    outputs = {v.name for v in description.number_outputs}
    return tuple(name for name in chosen if name not in outputs)


def describe_choice(description: FmuDescription) -> str:
    """Return a sentence on the variables that can be nodes; empty if there are none."""
    names = [v.name for v in computed_variables(description)]
    return f"`outputs` chooses among its variables: {join_names(names, _MOST_NAMES)}" if names else ""


def digest_with_outputs(digest: str, outputs: str) -> str:
    """Return what tells the functions of an FMU with these further outputs, a line each, from those with others."""
    return f"{digest}_{blake2b(outputs.encode(), digest_size=8).hexdigest()}" if outputs else digest


def _names(variable: FmuVariable) -> Iterator[str]:
    yield variable.name
    if variable.shape:
        yield from variable.elements


def _unknown(description: FmuDescription, computed: Sequence[FmuVariable], pattern: str) -> tuple[str, str]:
    """Return message and remedy for a pattern that fits nothing."""
    others = [v for v in description.variables if v.name == pattern]
    if others:
        message = (
            f"{pattern} is not a computed number: its causality is {others[0].causality}, its type {others[0].type}"
        )
        return message, "Choose another variable."
    remedy = nearest(pattern, (v.name for v in computed)) or describe_choice(description)
    return f"unknown variable {pattern}", remedy or "The FMU computes no numbers."
