"""`Sample`: a whole file that `fuzz.py` damages."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Sample:
    """A whole file, with the files that belong beside it; the one called `name` is damaged."""

    kind: str
    name: str
    files: Mapping[str, bytes]
