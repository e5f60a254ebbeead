"""What an import made of a model: what is supported, what is not and why, and what was put in place of what."""

from dataclasses import dataclass, field

from kennfeld.errors import Finding

__all__ = [
    "TYPES_IGNORED",
    "CalibratableParameter",
    "ImportReport",
    "ImportableSubsystem",
    "Quantity",
    "UnsupportedBlock",
]

TYPES_IGNORED = "number types are left aside: all values are physical, in double precision"

_LOOP = "Put a unit delay into the loop, or bind one of its blocks."


@dataclass(frozen=True)
class Quantity:
    """An input or output of the function, as a project names it."""

    name: str
    unit: str = ""


@dataclass(frozen=True)
class CalibratableParameter:
    """A parameter: its kind, its size, the range of its values, its limits where it has some, where it comes from.

    `locked` says that its values stay unless they are asked for by name.
    """

    name: str
    kind: str
    shape: tuple[int, ...]
    smallest: float
    largest: float
    unit: str
    lower: float | None
    upper: float | None
    locked: bool
    source: str


@dataclass(frozen=True)
class UnsupportedBlock:
    """A block that could not be built. `stops` says whether an output of the model depends on it.

    `undefined` is the variable that nothing gives a value, where that is the reason.
    """

    path: str
    type: str
    why: str
    remedy: str
    stops: bool
    undefined: str = ""

    @property
    def finding(self) -> Finding:
        """The same as a problem of the file."""
        remedy = self.remedy or f'Bind it: bind = {{ "{self.path}" = "a channel or formula" }}.'
        return Finding(self.path, self.why, remedy)


@dataclass(frozen=True)
class ImportableSubsystem:
    """A subsystem that can be imported by itself, with all of its blocks: how many, its inputs and its outputs."""

    path: str
    blocks: int
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


@dataclass(frozen=True)
class ImportReport:
    """What became of a model's blocks.

    `total` counts the blocks that compute something, `supported` those that were built or could be. `substitutions` are
    sentences on what runs in another way than in Simulink. `sources` says by parameter where its value comes from.
    `frozen` are expressions whose variables are fixed, with the reason. `inputs` and `outputs` are those of the
    function, where it is whole; `parameters` are what can be calibrated. `subsystems` are those that can be imported
    by themselves, where that was asked for. `reasons` are why scripts could give variables no value. `stopped` is what
    keeps the blocks from being built at all.
    """

    total: int
    supported: int
    unsupported: tuple[UnsupportedBlock, ...]
    loops: tuple[tuple[str, ...], ...]
    substitutions: tuple[str, ...]
    remarks: tuple[str, ...]
    sources: dict[str, str]
    frozen: dict[str, str]
    solver: str
    step: float | None
    parameters: tuple[CalibratableParameter, ...] = ()
    inputs: tuple[Quantity, ...] = ()
    outputs: tuple[Quantity, ...] = ()
    subsystems: tuple[ImportableSubsystem, ...] = ()
    reasons: dict[str, str] = field(default_factory=dict)
    stopped: tuple[Finding, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether all outputs could be built."""
        return not self.stopped and not self.loops and not any(one.stops for one in self.unsupported)

    @property
    def fixed(self) -> tuple[str, ...]:
        """A sentence for each expression whose variables are fixed."""
        frozen = {" ".join(text.split())[:100]: why for text, why in self.frozen.items()}
        return tuple(f"{text} is fixed, and so are the variables in it: {why}" for text, why in frozen.items())

    @property
    def told(self) -> tuple[str, ...]:
        """What somebody should know who calibrates the model."""
        substitutions = (one for one in self.substitutions if one != TYPES_IGNORED)
        remarks = (one for one in self.remarks if not one.endswith("is passed over"))  # drawings of a script, and such
        return (*substitutions, *self.fixed, *remarks)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What keeps the outputs from being built; variables without a value first, each once."""
        valueless = (_valueless(name, paths, self._reason(name)) for name, paths in self.undefined.items())
        others = (_together(several) for several in self.groups if several[0].stops)
        return (*self.stopped, *valueless, *others, *(Finding(loop[0], _loop(loop), _LOOP) for loop in self.loops))

    def _reason(self, name: str) -> str:
        return self.reasons.get(name) or self.reasons.get(name.partition(".")[0], "")

    @property
    def groups(self) -> tuple[tuple[UnsupportedBlock, ...], ...]:
        """The blocks that could not be built though their variables have values, by what stops them."""
        found: dict[tuple[str, str, bool], list[UnsupportedBlock]] = {}
        for one in self.unsupported:
            if not one.undefined:
                found.setdefault((one.why, one.remedy, one.stops), []).append(one)
        return tuple(tuple(several) for several in found.values())

    @property
    def undefined(self) -> dict[str, tuple[str, ...]]:
        """The variables that nothing gives a value, each with the paths of the blocks that need it."""
        names = dict.fromkeys(one.undefined for one in self.unsupported if one.undefined)
        return {name: tuple(one.path for one in self.unsupported if one.undefined == name) for name in names}


def _together(several: tuple[UnsupportedBlock, ...]) -> Finding:
    """One problem of all blocks that the same thing stops."""
    first = several[0].finding
    return (
        first
        if len(several) == 1
        else Finding(f"{first.place} and {len(several) - 1} more", first.message, first.remedy)
    )


def _valueless(name: str, paths: tuple[str, ...], why: str) -> Finding:
    who = f"{paths[0]} needs it" if len(paths) == 1 else f"{paths[0]} and {len(paths) - 1} more need it"
    remedy = "Give it among the parameters: in a script, a .mat, .sldd or calibration file."
    return Finding(f"variable {name}", f"has no value{f' ({why})' if why else ''}; {who}", remedy)


def _loop(loop: tuple[str, ...]) -> str:
    names = " -> ".join([*loop, loop[0]]) if len(loop) < 12 else f"{' -> '.join(loop[:10])} -> ... -> {loop[0]}"
    return f"an algebraic loop: {names}"
