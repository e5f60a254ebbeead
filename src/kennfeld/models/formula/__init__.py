"""Formula text (`.kf`): read it, extend a model by it, print any graph as it."""

from kennfeld.models.formula.frontend import expression, extend, formula, read, surrogates_beside, text_of
from kennfeld.models.formula.printer import to_text

__all__ = ["expression", "extend", "formula", "read", "surrogates_beside", "text_of", "to_text"]
