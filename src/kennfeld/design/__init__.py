"""Design of measurements: the drives or points that determine most of a fitted function, and designs without a fit.

`kennfeld.design` is a function as well: once this package is imported, its name in `kennfeld` is bound to it.
"""

import sys
from types import ModuleType
from typing import Any

from kennfeld.design.api import design
from kennfeld.design.comparison import DesignComparison
from kennfeld.design.design_result import ChosenSegment, Design

__all__ = ["ChosenSegment", "Design", "DesignComparison", "design"]


class _CallablePackage(ModuleType):
    """A package that can be called like the function of its name."""

    __wrapped__ = staticmethod(design)

    def __call__(self, *arguments: Any, **words: Any) -> Design:
        """Return `design` of the arguments."""
        return design(*arguments, **words)


sys.modules[__name__].__class__ = _CallablePackage
