"""The display of values in notebooks, which is written by a package that only notebooks load."""

from importlib import import_module

_PACKAGE = "kennfeld.notebook"  # in a higher layer: no type knows how it is drawn


class NotebookDisplay:
    """Base class of values that notebooks display with tables and pictures; see `kennfeld.notebook`."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        """Return the value as HTML, as notebooks ask for it."""
        return str(import_module(_PACKAGE).html_of(self))
