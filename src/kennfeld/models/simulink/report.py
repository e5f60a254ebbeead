"""What an import made of a model: what is supported, what is not and why, and what was put in place of what."""

from dataclasses import dataclass

from kennfeld.errors import Finding

__all__ = ["ImportReport", "Unsupported"]


@dataclass(frozen=True)
class Unsupported:
    """A block that could not be built. `stops` says whether an output of the model depends on it."""

    path: str
    type: str
    why: str
    mend: str
    stops: bool

    @property
    def finding(self) -> Finding:
        """The same as a problem of the file."""
        mend = self.mend or f'Bind it: bind = {{ "{self.path}" = "a channel or formula" }}.'
        return Finding(self.path, self.why, mend)


@dataclass(frozen=True)
class ImportReport:
    """What became of a model's blocks.

    `total` counts the blocks that compute something, `supported` those that were built or could be. `substitutions` are
    sentences on what runs in another way than in Simulink. `sources` says by parameter where its value comes from.
    `frozen` are expressions whose variables are fixed, with the reason.
    """

    total: int
    supported: int
    unsupported: tuple[Unsupported, ...]
    loops: tuple[tuple[str, ...], ...]
    substitutions: tuple[str, ...]
    remarks: tuple[str, ...]
    sources: dict[str, str]
    frozen: dict[str, str]
    solver: str
    step: float | None

    @property
    def whole(self) -> bool:
        """Whether all outputs could be built."""
        return not self.loops and not any(one.stops for one in self.unsupported)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What keeps the outputs from being built."""
        stopping = tuple(one.finding for one in self.unsupported if one.stops)
        return (*stopping, *(Finding(loop[0], _loop(loop), _LOOP) for loop in self.loops))


_LOOP = "Put a unit delay into the loop, or bind one of its blocks."


def _loop(loop: tuple[str, ...]) -> str:
    names = " -> ".join([*loop, loop[0]]) if len(loop) < 12 else f"{' -> '.join(loop[:10])} -> ... -> {loop[0]}"
    return f"an algebraic loop: {names}"
