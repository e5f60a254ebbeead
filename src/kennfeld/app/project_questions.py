"""Questions about projects as such: the recent ones, the demos, and which of them is open."""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from kennfeld import __version__
from kennfeld.app.folders import free_path
from kennfeld.app.recent import RecentProject, forget, project_id, recent_projects
from kennfeld.app.session.recovery import Recovery
from kennfeld.app.session.summary import PictureLines
from kennfeld.app.wire import ABSENT, Absent, Question, from_json, questions_of
from kennfeld.base.errors import ArgumentError, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.output_paths import plain_name
from kennfeld.project.demo import all_or_none, prepare, write
from kennfeld.project.schemas import PROJECT_SCHEMA, directive, schema_text


class OpenProjects(Protocol):
    """The part of the workspace that these questions need.

    Attributes:
        latest: id of the project that was opened last.
    """

    latest: str

    def open(self, path: Path) -> str:
        """Open a project, unless it is open already, and return its id."""

    def join(self, asked: str) -> str:
        """Return the id of a project that was opened before, opened; empty if there is none."""

    def is_open(self, path: Path) -> bool:
        """Return True if the project is open."""

    def summarise_open(self) -> None:
        """Keep what the start page shows of the open projects."""

    def say(self, text: str) -> None:
        """Tell pages what takes a while."""


@dataclass(frozen=True)
class RecentRow:
    """A project that was opened before; the summary that follows `open` may lack any of its parts.

    Attributes:
        opened: when, in s since 1970; 0 if unknown.
        unsaved: true if it has unsaved edits.
        id: by which addresses of the page name it.
        open: true if it is open in this or in another page.
        state: status of the last run, or the number of problems.
        problem: the first problem.
        file: formula file.
        node: of the first criterion.
        training: RMSE on training data.
        test: RMSE on test data.
        histogram: of the errors on training data.
        nodes: number of nodes.
        datasets: name, use and samples of each.
        parameters: number of free parameters.
        values: number of free values.
        run: the last run in words.
    """

    id: str
    path: str
    name: str
    folder: str
    opened: float
    unsaved: bool
    open: bool
    state: str | Absent = ABSENT
    problem: str | Absent = ABSENT
    file: str | Absent = ABSENT
    node: str | Absent = ABSENT
    unit: str | Absent = ABSENT
    training: float | Absent = ABSENT
    test: float | Absent = ABSENT
    histogram: Sequence[float] | Absent = ABSENT
    nodes: int | Absent = ABSENT
    datasets: Sequence[tuple[str, str, int]] | Absent = ABSENT
    parameters: int | Absent = ABSENT
    values: int | Absent = ABSENT
    run: str | Absent = ABSENT
    without_data: int | Absent = ABSENT
    picture: PictureLines | Absent = ABSENT


@dataclass(frozen=True)
class DemoRow:
    """A demo that can be written."""

    name: str
    title: str
    text: str
    facts: str


@dataclass(frozen=True)
class KnownProjects:
    """Recent projects, the demos, the folder in which new projects are made, and the version of Kennfeld."""

    recent: Sequence[RecentRow]
    demos: Sequence[DemoRow]
    folder: str
    version: str


@dataclass(frozen=True)
class ProjectPath:
    """A project by its file or folder."""

    path: str


@dataclass(frozen=True)
class ProjectId:
    """A project that was opened before, by its id."""

    project: str


@dataclass(frozen=True)
class DemoName:
    """A demo by its name."""

    name: str


@dataclass(frozen=True)
class NewProject:
    """A new project.

    Attributes:
        name: of its folder.
        free: the name is that of a file that was dropped, and a number is added if the folder exists.
    """

    name: str
    free: bool = False


def _projects(workspace: OpenProjects) -> KnownProjects:
    """Return recent projects with their summaries, the demos, and the folder in which new projects are made."""
    workspace.summarise_open()
    recent = [_recent_row(each, is_open=workspace.is_open(each.path)) for each in recent_projects()]
    return KnownProjects(recent, DEMOS, _short(Path.cwd()), __version__)


def _recent_row(own: RecentProject, *, is_open: bool) -> RecentRow:
    """Return a recent project; of a summary that another version has kept, nothing is shown."""
    row = {
        "id": project_id(own.path),
        "path": str(own.path),
        "name": own.path.parent.name,
        "folder": _short(own.path.parent),
        "opened": own.opened,
        "unsaved": Recovery(own.path).exists,
        "open": is_open,
    }
    try:
        recent: RecentRow = from_json(RecentRow, {**row, **own.summary}, "recent")
    except ArgumentError:
        recent = from_json(RecentRow, row, "recent")
    return recent


def _short(folder: Path) -> str:
    """Return a path as users write it: `~/calibration`."""
    home = Path.home()
    if not folder.is_relative_to(home):
        return str(folder)
    return "~" if folder == home else f"~/{folder.relative_to(home).as_posix()}"


def _forget(workspace: OpenProjects, asked: ProjectPath) -> None:
    forget(Path(asked.path))


def _open(workspace: OpenProjects, asked: ProjectPath) -> None:
    """Open a project, unless it is open already."""
    workspace.open(Path(asked.path).expanduser())


def _show(workspace: OpenProjects, asked: ProjectId) -> None:
    """Open a project that was opened before."""
    joined = workspace.join(asked.project)
    if not joined:
        raise ArgumentError(f"{asked.project[:100]} is not among the recent projects")
    workspace.latest = joined


def _demo(workspace: OpenProjects, asked: DemoName) -> None:
    """Write a demo into the working directory, unless it is there, and open it."""
    name = asked.name
    folder = Path(f"kennfeld-demo-{name}")
    workspace.say(f"Writing the demo into {folder}")
    with all_or_none(folder):
        path = write(name, folder)
        workspace.say("Preparing the demo")
        prepare(name, path.parent, lambda line: workspace.say(f"Preparing the demo: {line}"))
    workspace.open(path)


NEW = f'{directive(PROJECT_SCHEMA)}\n\n[model]\nfile = "function.kf"\n'
NEW_FUNCTION = "# A line a node: name[unit] = expression\n"


def _new(workspace: OpenProjects, asked: NewProject) -> None:
    """Create an empty project in a new folder of the working directory, and open it."""
    name = asked.name.strip()
    folder = free_path(Path(), Path(plain_name(name)).stem) if asked.free else Path(name or "project")
    folder = folder.expanduser()
    if folder.exists() and any(folder.iterdir()):
        raise InputError.of(Location(str(folder)), "the folder is not empty", "Choose another name.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "function.kf").write_text(NEW_FUNCTION, encoding="utf-8")
        (folder / PROJECT_SCHEMA).write_text(schema_text(PROJECT_SCHEMA), encoding="utf-8")
        (folder / "kennfeld.toml").write_text(NEW, encoding="utf-8")
    except OSError as error:
        raise InputError.of(Location(str(folder)), f"cannot be created: {error.strerror or error}") from None
    workspace.open(folder / "kennfeld.toml")


DEMOS = [
    DemoRow(
        "torque",
        "Engine torque",
        "Three maps and a curve, steady points from a test bench.",
        "2839 + 1000 points, 519 values",
    ),
    DemoRow(
        "exhaust",
        "Exhaust gas temperature",
        "A map and a time constant, 44 minutes of driving.",
        "26 482 + 12 000 samples, 154 values",
    ),
    DemoRow(
        "idle",
        "Idle speed governor",
        "Two gains around an engine learnt from recordings.",
        "1500 samples, 2 values",
    ),
]
PROJECT_QUESTIONS: dict[str, Question[OpenProjects]] = questions_of(
    {"projects": _projects, "open": _open, "show": _show, "demo": _demo, "new": _new, "forget": _forget}
)
OPENING = ("open", "show", "demo", "new")  # questions after which the page that asked shows another project
