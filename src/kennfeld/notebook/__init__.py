"""Display of values in notebooks: self-contained HTML that is readable on dark pages, and plots by matplotlib."""

from typing import TYPE_CHECKING

from kennfeld.base.lazy_names import lazy_names

if TYPE_CHECKING:
    from kennfeld.notebook.display import html_of

__all__ = ["html_of"]

__getattr__ = lazy_names(__name__, {"display": "html_of"})
