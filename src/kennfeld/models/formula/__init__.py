"""Formula text (`.kf`): compile it to a graph, extend a model with it, and print any graph as formula text."""

from typing import TYPE_CHECKING

from kennfeld.base.lazy_names import lazy_names

if TYPE_CHECKING:
    from kennfeld.models.formula.frontend import (
        declared_inputs,
        expression,
        extend,
        formula,
        read,
        surrogates_beside,
        text_of,
    )
    from kennfeld.models.formula.printer import spell_name, to_lines, to_text

__all__ = [
    "declared_inputs",
    "expression",
    "extend",
    "formula",
    "read",
    "spell_name",
    "surrogates_beside",
    "text_of",
    "to_lines",
    "to_text",
]

__getattr__ = lazy_names(
    __name__,
    {
        "frontend": "declared_inputs expression extend formula read surrogates_beside text_of",
        "printer": "spell_name to_lines to_text",
    },
)
