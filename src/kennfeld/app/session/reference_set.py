"""A set of values that the present ones are compared with."""

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet


@dataclass(frozen=True, eq=False)
class ReferenceSet:
    """A set of values to compare with.

    Attributes:
        key: "start", the number of a run, or "file:NAME".
        title: in words.
        parameters: its values; of a file, as they were when it was chosen.
    """

    key: str
    title: str
    parameters: ParameterSet
