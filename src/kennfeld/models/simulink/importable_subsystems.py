"""Which subsystems of a model that is not whole can be imported by themselves, the largest first.

A subsystem is tried where none of its blocks is known to be unsupported; where it cannot be imported all the same,
those within it are tried. So each block is looked at a few times at most, and the operations of all trials have an end.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from kennfeld.errors import InputError
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.models.simulink.flattening.active_blocks import active_content
from kennfeld.models.simulink.import_report import ImportableSubsystem, ImportReport
from kennfeld.models.simulink.loaded_model import LoadedModel
from kennfeld.models.simulink.lowering.registry import BLOCK_TYPES
from kennfeld.models.simulink.model_import import ModelImport
from kennfeld.models.simulink.reader.model_tree import ModelBlock, System, split_path
from kennfeld.models.simulink.variables.mask_scope import Scope
from kennfeld.models.simulink.variables.model_variables import ParameterSource

__all__ = ["inspect_simulink"]

_SMALLEST = 2  # blocks besides ports
_AGAIN = 4  # times that the blocks of a model are built on the search
_MOST = 50  # subsystems told
_MOST_ASKED = 400_000  # operations of all trials, which take some seconds
_LEAST_ASKED = 10_000  # below which no trial is worth while
_ENDED = "the search for subsystems that can be imported by themselves ended early: name one to look into it"


def inspect_simulink(
    path: str | Path,
    subsystem: str | None = None,
    parameters: Iterable[ParameterSource] = (),
    folders: Iterable[str | Path] = (),
    bind: Mapping[str, str] | None = None,
) -> ImportReport:
    """What an import makes of a file or a subsystem and, where that stops, which subsystems within can be imported.

    The arguments are those of `simulink`. Raises `InputError` where the file cannot be read, or has more blocks than
    any model.
    """
    opened = LoadedModel.of(path, parameters, folders)
    system, scope, prefix = opened.system(subsystem)
    report = ModelImport(opened, system, scope, opened.cuts(bind or {}, prefix)).inspected()
    if report.whole:
        return report
    search = _SubsystemSearch(opened, report, len(split_path(prefix)) if prefix else 0)
    search.below(system, scope)
    found = sorted(search.found, key=lambda one: (-one.blocks, one.path))
    remarks = (*report.remarks, _ENDED) if search.ended else report.remarks
    return replace(report, subsystems=tuple(found[:_MOST]), remarks=remarks)


class _SubsystemSearch:
    """`left` are blocks and `asked` operations that the search may still build."""

    def __init__(self, opened: LoadedModel, report: ImportReport, depth: int) -> None:
        self.opened, self.depth = opened, depth
        self.bad = {names for one in report.unsupported for names in _around(one.path)}
        self.bad |= {names for loop in report.loops for path in loop for names in _around(path)}
        self.left = _AGAIN * report.total + 1000
        self.asked = _MOST_ASKED
        self.found: list[ImportableSubsystem] = []

    def below(self, root: System, scope: Scope) -> None:
        """Look through the blocks of a system and all below them."""
        waiting = [(block, scope) for block in reversed(root.blocks)]
        while waiting and not self.ended:
            block, scope = waiting.pop()
            if block.system is None or not _is_plain(block):
                continue
            inside = scope.inside(block, self.opened.models)
            one = None if split_path(block.path)[self.depth :] in self.bad else self._tried(block, inside)
            if one is None:
                waiting += [(inner, inside) for inner in reversed(block.system.blocks)]
            elif one.blocks - len(one.inputs) - len(one.outputs) >= _SMALLEST:
                self.found.append(one)

    @property
    def ended(self) -> bool:
        """Whether as much has been built as the search may."""
        return self.left <= 0 or self.asked <= _LEAST_ASKED

    def _tried(self, block: ModelBlock, scope: Scope) -> ImportableSubsystem | None:
        """The subsystem as it is imported; None where it is not whole."""
        if block.system is None or not any(block.system.of("Outport")):
            return None
        try:
            work = ModelImport(self.opened, active_content(block, scope)[0], scope)
        except (InputError, EvaluationError):
            return None
        self.left -= len(work.flat.atoms)
        work.most_asked = self.asked // 2  # what is too large leaves as much for what is within
        try:
            compiler = work.woven()
            report = work.report(compiler)
        except InputError:
            return None
        finally:
            self.asked -= work.asked
        if not report.whole or report.unsupported:
            return None
        outputs = tuple(port.block.name for port in work.flat.outports)
        return ImportableSubsystem(block.path, report.total, tuple(compiler.inputs), outputs)


def _around(path: str) -> Iterator[tuple[str, ...]]:
    """The names along the ways to the systems around a block."""
    names = split_path(path)
    return (names[:count] for count in range(1, len(names) + 1))


def _is_plain(block: ModelBlock) -> bool:
    """Whether a block is a subsystem by what is drawn in it."""
    drawn = (block.value("SFBlockType") or "NONE") == "NONE" and block.chart is None
    return drawn and (block.mask is None or block.mask.type not in BLOCK_TYPES)
