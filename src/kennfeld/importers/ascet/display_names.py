"""Names of parameters, inputs and nodes in the model, by their labels in the program.

The label `SOCClasses.SOC.accu.temp_curve` becomes `accu.temp_curve` if the class SOC is imported, and `SOC.temp_curve`
or the whole label only if that name is taken.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Sequence

from kennfeld.graph import CLOCK


class DisplayNames:
    """Chooses names, each once.

    Args:
        roots: labels of the imported instances.
        interfaces: labels of the data interfaces; their messages are named without them if that is unambiguous.
        known: names of parameters in calibration files, which are preferred.
    """

    def __init__(self, roots: Collection[str], interfaces: Iterable[str], known: Collection[str] = ()) -> None:
        self._prefixes = [*roots, *interfaces]
        self._known = frozenset(known)
        self._taken: set[str] = set(CLOCK)

    def choose(self, labels: Sequence[str]) -> dict[str, str]:
        """Return a name for each label; names of earlier calls are taken."""
        levels = {label: self._candidates(label) for label in labels}
        result: dict[str, str] = {}
        for label in labels:
            for candidate in levels[label]:
                # names of calibration files come first, whatever their length
                if candidate in self._known and candidate not in self._taken:
                    result[label] = candidate
                    self._taken.add(candidate)
                    break
        # shortest names first; a name that two labels want is for neither, so that it does not depend on their order
        for level in range(3):
            counts = Counter(levels[label][level] for label in labels if label not in result)
            for label in labels:
                candidate = levels[label][level]
                if label not in result and counts[candidate] == 1 and candidate not in self._taken:
                    result[label] = candidate
                    self._taken.add(candidate)
        for label in labels:
            result.setdefault(label, self._free(label))
        return {label: result[label] for label in labels}

    def claim(self, name: str, qualified: str) -> str:
        """Return a name that is not taken: this one, else the qualified one, else one with a number."""
        for candidate in (name, qualified):
            if candidate not in self._taken:
                self._taken.add(candidate)
                return candidate
        return self._free(qualified)

    def _free(self, name: str) -> str:
        number = 2
        while f"{name}_{number}" in self._taken:
            number += 1
        self._taken.add(f"{name}_{number}")
        return f"{name}_{number}"

    def _candidates(self, label: str) -> tuple[str, str, str]:
        """Return the names of a label, from the shortest to the whole label."""
        # the innermost root around the label
        around = max((prefix for prefix in self._prefixes if label.startswith(f"{prefix}.")), key=len, default="")
        if not around:
            owner, _, name = label.rpartition(".")
            return f"{owner.rpartition('.')[2]}.{name}".removeprefix("."), label, label
        rest = label[len(around) + 1 :]
        return rest, f"{around.rpartition('.')[2]}.{rest}", label
