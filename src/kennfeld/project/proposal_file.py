"""`proposals.json` in the results folder: the last list of `kennfeld propose`, and the calibration that it is about."""

import hashlib
import json
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kennfeld.analysis.missing.picture import DrawnProposals, TermArtist
from kennfeld.analysis.missing.proposal import TermProposals
from kennfeld.analysis.missing.proposing import SearchScope
from kennfeld.analysis.missing.stored_proposals import proposals_as_json, proposals_from_json
from kennfeld.base.content_digest import digest_of
from kennfeld.base.errors import InputError, Location
from kennfeld.base.file_state import note_opened, while_unchanged
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.problem.problem import Problem
from kennfeld.optimize.search.problem_digest import problem_digest
from kennfeld.preprocessing.recording_sources import find_addresses, is_remote, recording_files, size_in_store
from kennfeld.project.missing_terms import calibrated_values
from kennfeld.project.results import PROPOSALS, results_folder, write_text

if TYPE_CHECKING:
    from kennfeld.project.project import Project

VALUES = "the values have"
SUBJECT, SCOPE, TIME = "calibration", "scope", "made"  # its keys, beside those of `kennfeld propose --json`


@dataclass(frozen=True)
class ProposalSubject:
    """Digests of what proposals are about.

    Attributes:
        problem: function, settings and scored data.
        recordings: files with all their channels, also those that the function does not read.
        values: of the free parameters.
    """

    problem: str
    recordings: str
    values: str

    @classmethod
    def of(cls, project: "Project", parameters: ParameterSet) -> "ProposalSubject":
        """Return the subject of proposals for a project at these values."""
        problem = project.problem()
        return cls(problem_digest(problem, project.options), _recordings(project), _values(problem, parameters))

    def change(self, now: "ProposalSubject") -> str:
        """Return what has changed, as the subject of a sentence; "" if nothing has."""
        if self.problem != now.problem:
            return "the function, the project or its data have"
        if self.recordings != now.recordings:
            return "the recordings have"
        return "" if self.values == now.values else VALUES


def _values(problem: Problem, parameters: ParameterSet) -> str:
    tables = []
    for name in sorted(problem.free_names):
        free = [axis.free for axis in problem.parameters[name].axes]
        moved = [axis.breakpoints for axis, own in zip(parameters[name].axes, free, strict=True) if own]
        tables.append((name, parameters[name].values, moved))
    return digest_of(tables)


def _recordings(project: "Project") -> str:
    """Return the digest of the recordings; of data in partitions, the problem knows the versions of the files."""
    if project.is_partitioned:
        return ""
    folder = project.file.folder
    addresses = [each for entry in project.file.datasets for own in entry.files for each in find_addresses(folder, own)]
    return digest_of([str(size_in_store(each)) if is_remote(each) else _content(each) for each in addresses])


@while_unchanged(1024)
def _content(address: str) -> tuple[str, ...]:
    """Return the SHA-256 of the files of a recording; empty for one that cannot be read."""
    digests = []
    for path in recording_files(address):
        note_opened(path)
        try:
            with path.open("rb") as file:
                digests.append(hashlib.file_digest(file, "sha256").hexdigest())
        except OSError:
            digests.append("")
    return tuple(digests)


@dataclass(frozen=True, eq=False)
class StoredProposals:
    """Proposals of an earlier search.

    Attributes:
        drawn: the proposals with their pictures and fitted values.
        scope: what took part.
        made: time of the search, ISO 8601.
        subject: what they are about.
    """

    drawn: DrawnProposals
    scope: SearchScope
    made: str
    subject: ProposalSubject


def write_proposals(project: "Project", found: TermProposals, scope: SearchScope) -> Path | None:
    """Write proposals into the results folder; None if it has no values of this function, which they would be about.

    Raises:
        InputError: the folder cannot be written.
    """
    values = calibrated_values(project, project.problem())
    if values is None:
        return None
    return store_proposals(project, TermArtist().drawn(found), scope, values, results_folder(project.path))


def store_proposals(
    project: "Project", drawn: DrawnProposals, scope: SearchScope, values: ParameterSet, folder: Path
) -> Path:
    """Write proposals beside the results that they are about.

    Args:
        project: the project.
        drawn: the proposals.
        scope: what took part.
        values: the calibration for which they were searched.
        folder: the results folder.

    Raises:
        InputError: the folder cannot be written.
    """
    names = [name for name in project.problem().free_names if name not in project.surrogates]
    content = proposals_as_json(drawn, names) | {
        TIME: datetime.now().astimezone().isoformat(" ", "seconds"),
        SCOPE: {"channels": list(scope.channels), "nodes": list(scope.nodes), "kinds": list(scope.kinds)}
        | {"least": scope.least},
        SUBJECT: vars(ProposalSubject.of(project, values)),
    }
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    return write_text(f"{text}\n", folder / PROPOSALS)


def read_proposals(folder: Path) -> StoredProposals | None:
    """Return the proposals in a results folder; None if it has none.

    Raises:
        InputError: the file is damaged.
    """
    path = folder / PROPOSALS
    if not path.is_file():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        subject = ProposalSubject(**{name: str(content[SUBJECT][name]) for name in ("problem", "recordings", "values")})
        return StoredProposals(proposals_from_json(content), _scope(content[SCOPE]), str(content[TIME]), subject)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError, InputError) as error:
        message = f"not a valid list of proposals ({type(error).__name__}: {error})"
        raise InputError.of(Location.of_file(path), message, "Run kennfeld propose again.") from None


def _scope(content: Mapping[str, Any]) -> SearchScope:
    names = {name: tuple(map(str, content[name])) for name in ("channels", "nodes", "kinds")}
    scope = SearchScope(**names, least=float(content["least"]))  # type: ignore[arg-type]
    scope.check()
    return scope
