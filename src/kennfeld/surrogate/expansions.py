"""The expansions of surrogates as parameters, which compiled code reads like those of any table."""

from collections.abc import Iterable

from kennfeld.parameters import ParameterSet
from kennfeld.rbf import RBF
from kennfeld.surrogate.stored import Surrogate

__all__ = ["expansions"]


def expansions(surrogates: Iterable[Surrogate]) -> ParameterSet:
    """One parameter a surrogate, under its name and locked: it comes with the model and is not calibrated."""
    return ParameterSet(RBF(s.name, s.expansion, locked=True) for s in surrogates)
