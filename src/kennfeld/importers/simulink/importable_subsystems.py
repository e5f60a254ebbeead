"""Search for subsystems of a model that can be imported on their own, largest first.

A subsystem is tried if none of its blocks is known to be unsupported; if its import fails, the subsystems within it are
tried. Each block is therefore lowered a few times at most, and the number of operations is bounded.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.garbage_collection import no_collection
from kennfeld.importers.simulink.flattening.active_blocks import active_content
from kennfeld.importers.simulink.import_report import ImportableSubsystem, SimulinkReport
from kennfeld.importers.simulink.loaded_model import LoadedModel
from kennfeld.importers.simulink.lowering.registry import BLOCK_TYPES
from kennfeld.importers.simulink.model_import import ModelImport
from kennfeld.importers.simulink.reader.model_tree import ModelBlock, System, split_path
from kennfeld.importers.simulink.variables.mask_scope import Scope
from kennfeld.importers.simulink.variables.model_variables import ParameterSource
from kennfeld.models.imperative.evaluation_errors import EvaluationError

_MIN_BLOCKS = 2  # blocks other than ports
_MAX_TRIALS_PER_BLOCK = 4  # times that a search lowers each block
_MAX_SUBSYSTEMS = 50  # listed in the report
_MAX_OPERATIONS = 400_000  # in all trials, a few seconds
_MIN_OPERATIONS = 10_000  # below this, a trial is pointless
_LIMIT_REACHED = "the search for importable subsystems reached its limit: name a subsystem to inspect it"


@no_collection()
def inspect_simulink(
    path: str | Path,
    subsystem: str | None = None,
    parameters: Iterable[ParameterSource] = (),
    folders: Iterable[str | Path] = (),
    *,
    bind: Mapping[str, str] | None = None,
    step: float | None = None,
) -> SimulinkReport:
    """Report on the import of a file or subsystem and, if it fails, on the subsystems that can be imported.

    Args:
        path: the `.slx` or `.mdl` file.
        subsystem: path of a subsystem, None for the whole model.
        parameters: sources of variables as in `simulink`.
        folders: folders to search for libraries.
        bind: blocks to replace as in `simulink`.
        step: time step in s that replaces the one of the model.

    Returns:
        The report.

    Raises:
        InputError: if the file cannot be read or has too many blocks.

    >>> inspect_simulink("engine.slx", parameters=[{"Slope": 2.0}]).whole
    True
    """
    loaded = LoadedModel.of(path, parameters, folders)
    system, scope, prefix = loaded.system(subsystem)
    report = ModelImport(loaded, system, scope, loaded.cuts(bind or {}, prefix), step=step).inspect().report
    if report.whole:
        return report
    search = _SubsystemSearch(loaded, report, len(split_path(prefix)) if prefix else 0)
    search.search(system, scope)
    limit = [Finding(Location(), _LIMIT_REACHED, severity="warning")] if search.ended else []
    return replace(report, subsystems=search.largest, remarks=(*limit, *report.remarks))


@no_collection()
def find_subsystems(
    path: str | Path, parameters: Iterable[ParameterSource] = (), folders: Iterable[str | Path] = ()
) -> tuple[ImportableSubsystem, ...]:
    """Return the subsystems of a file that can be imported on their own, also if the whole model can; largest first.

    Args:
        path: the `.slx` or `.mdl` file.
        parameters: sources of variables as in `simulink`.
        folders: folders to search for libraries.

    Raises:
        InputError: if the file cannot be read or has too many blocks.
    """
    loaded = LoadedModel.of(path, parameters, folders)
    system, scope, _ = loaded.system(None)
    search = _SubsystemSearch(loaded, ModelImport(loaded, system, scope).survey(), 0, nested=True)
    search.search(system, scope)
    return search.largest


class _SubsystemSearch:
    """Search with a budget: `blocks_left` and `asked` operations; `nested` also tries what importable ones contain."""

    def __init__(self, loaded: LoadedModel, report: SimulinkReport, depth: int, *, nested: bool = False) -> None:
        self.loaded, self.depth, self.nested = loaded, depth, nested
        self.bad = {names for block in report.unsupported for names in _enclosing_paths(block.path)}
        self.bad |= {names for loop in report.loops for path in loop for names in _enclosing_paths(path)}
        self.blocks_left = _MAX_TRIALS_PER_BLOCK * report.total + 1000
        self.asked = _MAX_OPERATIONS
        self.subsystems: list[ImportableSubsystem] = []

    def search(self, root: System, scope: Scope) -> None:
        """Search the blocks of a system and all below them."""
        waiting = [(block, scope) for block in reversed(root.blocks)]
        while waiting and not self.ended:
            block, scope = waiting.pop()
            if block.system is None or not _is_plain(block):
                continue
            inside = scope.inside(block, self.loaded.models)
            # paths of the report begin at the inspected subsystem
            subsystem = None if split_path(block.path)[self.depth :] in self.bad else self._try_import(block, inside)
            if subsystem is None or self.nested:
                waiting += [(inner, inside) for inner in reversed(block.system.blocks)]
            if subsystem is not None and _inner_blocks(subsystem) >= _MIN_BLOCKS:
                self.subsystems.append(subsystem)

    @property
    def largest(self) -> tuple[ImportableSubsystem, ...]:
        """The subsystems, largest first."""
        ordered = sorted(self.subsystems, key=lambda subsystem: (-subsystem.blocks, subsystem.path))
        return tuple(ordered[:_MAX_SUBSYSTEMS])

    @property
    def ended(self) -> bool:
        """True if the budget is used up."""
        return self.blocks_left <= 0 or self.asked <= _MIN_OPERATIONS

    def _try_import(self, block: ModelBlock, scope: Scope) -> ImportableSubsystem | None:
        """Try to import a subsystem; return None if an output is unsupported."""
        if block.system is None or not any(block.system.of("Outport")):
            return None
        try:
            attempt = ModelImport(self.loaded, active_content(block, scope), scope)
        except (InputError, EvaluationError):
            return None
        self.blocks_left -= len(attempt.flat.blocks)
        attempt.most_asked = self.asked // 2  # keep a budget for inner subsystems
        try:
            compiler = attempt.compile()
            report = attempt.report(compiler)
        except InputError:
            return None
        finally:
            # a failed attempt has used operations as well
            self.asked -= attempt.asked
        if not report.whole or report.unsupported:
            return None
        outputs = tuple(port.block.name for port in attempt.flat.outports)
        return ImportableSubsystem(block.path, report.total, tuple(compiler.inputs), outputs)


def _inner_blocks(subsystem: ImportableSubsystem) -> int:
    return subsystem.blocks - len(subsystem.inputs) - len(subsystem.outputs)


def _enclosing_paths(path: str) -> Iterator[tuple[str, ...]]:
    names = split_path(path)
    return (names[:count] for count in range(1, len(names) + 1))


def _is_plain(block: ModelBlock) -> bool:
    """Return True if a block is a subsystem defined by its drawing."""
    drawn = block.is_set_to("SFBlockType", "NONE", default="NONE") and block.chart is None
    return drawn and (block.mask is None or block.mask.type not in BLOCK_TYPES)
