"""Which blocks a block needs: those that its outputs depend on within the step, and those that it ever depends on."""

from collections.abc import Callable

from kennfeld.models.simulink.expressions.signals import Wired
from kennfeld.models.simulink.flattening.atoms import Atom, Source, begins_anew
from kennfeld.models.simulink.flattening.stores import Stores
from kennfeld.models.simulink.weaving.failures import Failures
from kennfeld.models.simulink.weaving.registry import KINDS
from kennfeld.models.simulink.weaving.site import Site

__all__ = ["Needs"]

_CONTROLLED = ("Held", "Control", "Pass", "DataStoreWrite")  # they ask themselves whether they run


class Needs:
    """What blocks need. `built` are the outputs of those that are there; `ahead` tells sources that always are."""

    def __init__(
        self, site: Callable[[Atom], Site], stores: Stores, ahead: Callable[[Source], bool], failures: Failures
    ) -> None:
        self.built: dict[Atom, tuple[Wired, ...]] = {}
        self._site = site
        self._stores = stores
        self._ahead = ahead
        self._failures = failures

    def ever(self, atom: Atom) -> list[Atom]:
        """The blocks that a block depends on in this step or in later ones."""
        found = [source.atom for source in atom.inputs if source is not None]
        found += self._stores.writers.get(atom, ())
        return [*found, atom.control] if atom.control is not None else found

    def now(self, atom: Atom) -> list[Atom]:
        """The blocks that a block's outputs depend on within the step."""
        sources = self._sources(atom)
        if sources is None:
            return []
        found = [source.atom for source in sources if not self._ahead(source)]
        if atom.control is not None and (atom.kind in _CONTROLLED or begins_anew(atom)):
            found.append(atom.control)
        if atom.earlier is not None:
            found += self._left_by(atom.earlier)
        return [*found, *(self._stores.before(atom) if atom.store is not None else ())]

    def _sources(self, atom: Atom) -> list[Source] | None:
        """The sources at the inputs that a block's outputs depend on; None where that cannot be told."""
        site, kind = self._site(atom), KINDS.get(atom.kind)
        with self._failures.noting(atom):
            every = range(len(atom.inputs)) if kind is not None else ()
            wanted = every if kind is None or kind.needs is None else kind.needs(site)
            sources = [atom.inputs[index] for index in wanted if index < len(atom.inputs)]
            return [source for source in sources if source is not None]
        return None

    def _left_by(self, atom: Atom) -> list[Atom]:
        """What has to be there so that the next pass of a block can read its memory."""
        site = self._site(atom)
        remembers = atom in self.built and (site.memories or site.before)
        return [atom, *self.ever(atom)] if remembers else [atom]
