"""The open projects that pages share, and the answers to their questions."""

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from kennfeld import __version__
from kennfeld.app.answer import Answer
from kennfeld.app.folders import confined, free_path
from kennfeld.app.questions import COMMANDS, QUESTIONS
from kennfeld.app.questions.overview import AppState, NoProject, StateNews, overview
from kennfeld.app.recent import RecentProject, forget, project_id, recent_projects, remember, summarise
from kennfeld.app.session.activity import Activity, StoppedError
from kennfeld.app.session.recovery import Recovery
from kennfeld.app.session.session import Session
from kennfeld.app.session.summary import PictureLines, summarise_session
from kennfeld.app.wire import ABSENT, Absent, Question, from_json, questions_of, to_answer
from kennfeld.base.errors import ArgumentError, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.output_paths import plain_name
from kennfeld.project.demo import all_or_none, prepare, write
from kennfeld.project.schemas import PROJECT_SCHEMA, directive, schema_text

UPLOAD_ENDING = ".upload.part"
ABANDONED = 600.0  # s after which an upload is not in progress any more

Push = Callable[[str, Answer, str], None]  # topic, news, and the project whose pages are told

KEPT = 3  # open projects without a page
UNSEEN = 60.0  # s after which a project without a page is closed, so that a page that is loaded again finds it


class AppWorkspace:
    """The open projects, each of which any number of pages show. All methods are called from one thread.

    Attributes:
        latest: id of the project that was opened last, which a page shows whose address names none; empty if none is.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._push: Push = lambda topic, answer, project: None
        self._wake: Callable[[str], object] = lambda project: None
        self._sessions: dict[str, Session] = {}
        self._changed: dict[str, Sequence[str]] = {}  # by project, what pages know to have changed on disk
        self._seen: dict[str, float] = {}  # by project, when a page last showed it
        self.latest = ""
        self._asking = ""  # the project whose pages are told what takes a while
        self._activity = Activity(self._tell_activity)
        if path is not None:
            self.open(path)

    @property
    def session(self) -> Session | None:
        """The project that was opened last."""
        return self._sessions.get(self.latest)

    def subscribe(self, push: Push, wake: Callable[[str], object]) -> None:
        """Set the functions that send news to pages, and that have `pump` called in the thread of the sessions."""
        self._push, self._wake = push, wake

    def pump(self, project: str) -> None:
        """Handle what a running job has reported, and tell the pages of its project."""
        session = self._sessions.get(project)
        if session is None:
            return
        runs = len(session.runs)
        with self._active(project):
            session.pump()
        if len(session.runs) > runs:
            self._summarise(session)
        self._tell(project)

    def open(self, path: Path) -> str:
        """Open a project, unless it is open already, and return its id.

        Raises:
            InputError: it does not exist, or is not text.
        """
        if path.is_dir():
            path = path / "kennfeld.toml"
        if not path.is_file():
            raise InputError.of(Location(str(path)), "the project file does not exist", "Name a kennfeld.toml.")
        path = path.resolve()
        project = project_id(path)
        if project not in self._sessions:
            _remove_parts(path.parent)
            self._sessions[project] = Session(path, lambda: self._wake(project), self._activity)
        self.latest, self._seen[project] = project, time.monotonic()
        remember(path)
        return project

    def join(self, asked: str) -> str:
        """Return the project that a new page shows.

        Args:
            asked: the project that its address names, which is opened if it was opened before; empty for the last one.

        Returns:
            Its id; empty if there is none.
        """
        if not asked:
            return self.latest
        with self._active(""):
            return self._joined(asked)

    def _joined(self, asked: str) -> str:
        if asked not in self._sessions:
            path = next((each.path for each in recent_projects() if project_id(each.path) == asked), None)
            with suppress(InputError):
                return "" if path is None else self.open(path)
        return asked if asked in self._sessions else ""

    def answer(self, ask: str, given: Mapping[str, Any], project: str | None = None) -> Answer:
        """Answer one question of a page about a project, by default the last one.

        Returns:
            The answer, with id and revision of the project that it is about; after a project was opened, of that one.

        Raises:
            KennfeldError: the question cannot be answered.
        """
        project = self.latest if project is None else project
        with self._active(project):
            return self._answer(ask, given, project)

    @contextmanager
    def _active(self, project: str) -> Iterator[None]:
        """Tell the pages of a project what takes a while within the block, and let them stop it."""
        self._asking = project
        self._activity.begin()
        try:
            yield
        except StoppedError:
            raise ArgumentError("stopped; nothing has changed") from None
        finally:
            self._activity.end()

    def _tell_activity(self, text: str, share: float | None) -> None:
        self._push("activity", to_answer(ActivityNews(text, share)), self._asking)

    def say(self, text: str) -> None:
        """Tell pages what takes a while. Raises `StoppedError` if a user has stopped it."""
        self._activity.say(text)

    def stop_activity(self) -> None:
        """Stop what takes a while; may be called from any thread."""
        self._activity.stop()

    def _answer(self, ask: str, given: Mapping[str, Any], project: str) -> Answer:
        if ask in _OWN:
            answer = _OWN[ask](self, given)
            if ask in OPENING:
                project = self.latest
                self._tell(project)
            return self._named(answer, project)
        question = QUESTIONS.get(ask) or COMMANDS.get(ask)
        if question is None:
            raise ArgumentError(f"unknown question {ask!r}")
        session = self.session_of(project)
        answer = question(session, given)
        if ask in COMMANDS:
            self._tell(project)
        if ask == "save":
            self._summarise(session)
        return self._named(answer, project)

    def _named(self, answer: Answer, project: str) -> Answer:
        """Return an answer with the project and the revision that it is about, by which pages drop that of another."""
        session = self._sessions.get(project)
        revision = 0 if session is None else session.revision
        return Answer({"project": project, "revision": revision, **answer.head}, answer.arrays)

    def session_of(self, project: str) -> Session:
        """Return an open project. Raises `ArgumentError` if it is not open."""
        if not project:
            raise ArgumentError("no project is open")
        if project not in self._sessions:
            raise ArgumentError("this project is not open any more; load the page again")
        return self._sessions[project]

    def is_open(self, path: Path) -> bool:
        """Return True if the project is open."""
        return project_id(path) in self._sessions

    def watch(self, shown: Collection[str]) -> None:
        """Tell pages if files on disk have changed, or are as saved again, and close projects that no page shows.

        Args:
            shown: the projects that pages show.
        """
        for project in shown:
            self._seen[project] = time.monotonic()
        self._close_unseen(shown)
        for project in [each for each in self._sessions if each in shown]:
            if [*map(str, self._sessions[project].disk_changes)] != self._changed.get(project, []):
                self._tell(project)

    def _close_unseen(self, shown: Collection[str]) -> None:
        """Close projects without a page, but for the last one, running ones, and some with unsaved edits."""
        hidden = [each for each in self._sessions if each not in shown and each != self.latest]
        hidden.sort(key=lambda project: self._seen.get(project, 0.0), reverse=True)
        for number, project in enumerate(each for each in hidden if not self._sessions[each].is_busy):
            session, unseen = self._sessions[project], time.monotonic() - self._seen.get(project, 0.0)
            if number >= KEPT or (unseen > UNSEEN and not session.has_edits):
                self._close(project)

    def close(self) -> None:
        """End running calibrations, and keep what the start page shows of the projects."""
        for project in [*self._sessions]:
            self._close(project)

    def _close(self, project: str) -> None:
        session = self._sessions.pop(project)
        session.close()
        self._summarise(session)

    def summarise_open(self) -> None:
        """Keep what the start page shows of the open projects."""
        for session in self._sessions.values():
            self._summarise(session)

    def _summarise(self, session: Session) -> None:
        summarise(session.path, summarise_session(session))

    def store(self, part: Path, name: str, project: str) -> Path:
        """Give an uploaded file its name, a free one of the folder of the project, and return its path."""
        target = free_path(self.folder(project), name)
        part.replace(target)
        return target

    def folder(self, project: str | None = None) -> Path:
        """Return the folder of a project. Raises `ArgumentError` if it is not open."""
        return self.session_of(self.latest if project is None else project).path.parent

    def download(self, name: str, project: str) -> Path:
        """Return a file of the project's folder. Raises `ArgumentError` if it is outside of it."""
        return confined(self.folder(project), name)

    def _tell(self, project: str) -> None:
        self._push("state", self.snapshot(project), project)

    def snapshot(self, project: str) -> Answer:
        """Return the state that every page of a project shows."""
        session = self._sessions.get(project)
        state = NoProject() if session is None else overview(session)
        # what pages know
        self._changed[project] = state.changed_on_disk if isinstance(state, AppState) else []
        return to_answer(StateNews(state))


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
class ActivityNews:
    """What takes a while, and the share of it that is done; an empty text at its end."""

    text: str
    share: float | None


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


def _projects(workspace: AppWorkspace) -> KnownProjects:
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


def _forget(workspace: AppWorkspace, asked: ProjectPath) -> None:
    forget(Path(asked.path))


def _open(workspace: AppWorkspace, asked: ProjectPath) -> None:
    """Open a project, unless it is open already."""
    workspace.open(Path(asked.path).expanduser())


def _show(workspace: AppWorkspace, asked: ProjectId) -> None:
    """Open a project that was opened before."""
    joined = workspace.join(asked.project)
    if not joined:
        raise ArgumentError(f"{asked.project[:100]} is not among the recent projects")
    workspace.latest = joined


def _remove_parts(folder: Path) -> None:
    """Remove what uploads to an earlier server left behind that was killed."""
    with suppress(OSError):
        for path in folder.glob(f".*{UPLOAD_ENDING}"):
            if time.time() - path.stat().st_mtime > ABANDONED:
                path.unlink(missing_ok=True)


def _demo(workspace: AppWorkspace, asked: DemoName) -> None:
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


def _new(workspace: AppWorkspace, asked: NewProject) -> None:
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
_OWN: dict[str, Question[AppWorkspace]] = questions_of(
    {"projects": _projects, "open": _open, "show": _show, "demo": _demo, "new": _new, "forget": _forget}
)
OPENING = ("open", "show", "demo", "new")  # questions after which the page that asked shows another project
