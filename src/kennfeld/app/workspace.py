"""The open projects that pages share, and the answers to their questions.

What opens a project and answers questions is imported when it is first used, in the thread of the sessions: the server
answers the browser before.
"""

import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kennfeld.app.answer import Answer
from kennfeld.app.folders import confined, free_path
from kennfeld.app.recent import project_id, recent_projects, remember, summarise
from kennfeld.app.session.activity import Activity, StoppedError
from kennfeld.base.errors import ArgumentError, InputError, Location
from kennfeld.base.lazy_dataclass import dataclass

if TYPE_CHECKING:
    from kennfeld.app.session.session import Session

UPLOAD_ENDING = ".upload.part"
ABANDONED = 600.0  # s after which an upload is not in progress any more

Push = Callable[[str, Answer, str], None]  # topic, news, and the project whose pages get it

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
        self._asking = ""  # the project whose pages get the progress of what takes a while
        self._activity = Activity(self._tell_activity)
        if path is not None:
            self.open(path)

    def load(self) -> None:
        """Import what opens projects and answers questions, which takes longer than all else at the start."""
        import_module("kennfeld.app.questions.overview")

    @property
    def session(self) -> "Session | None":
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
        path = project_file(path).resolve()
        project = project_id(path)
        if project not in self._sessions:
            from kennfeld.app.session.session import Session

            _remove_parts(path.parent)
            self._sessions[project] = Session(path, lambda: self._wake(project), self._activity)
        self.latest, self._seen[project] = project, time.monotonic()
        remember(path)
        return project

    def open_first(self, path: Path) -> None:
        """Open a project while pages without one wait for it; they show the progress, and can stop it.

        Raises:
            InputError: it does not exist, or is not text.
        """
        with self._active(""):
            self.open(path)

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

    @property
    def activity(self) -> Answer | None:
        """The present activity, for a page that was opened after it began; None if there is none.

        May be read from any thread.
        """
        text, share = self._activity.present
        return _activity_news(text, share) if text else None

    def _tell_activity(self, text: str, share: float | None) -> None:
        self._push("activity", _activity_news(text, share), self._asking)

    def say(self, text: str) -> None:
        """Tell pages what takes a while. Raises `StoppedError` if a user has stopped it."""
        self._activity.say(text)

    def stop_activity(self) -> None:
        """Stop what takes a while; may be called from any thread."""
        self._activity.stop()

    def _answer(self, ask: str, given: Mapping[str, Any], project: str) -> Answer:
        from kennfeld.app.project_questions import OPENING, PROJECT_QUESTIONS
        from kennfeld.app.questions import COMMANDS, QUESTIONS

        if ask in PROJECT_QUESTIONS:
            answer = PROJECT_QUESTIONS[ask](self, given)
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

    def session_of(self, project: str) -> "Session":
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

    def _summarise(self, session: "Session") -> None:
        from kennfeld.app.session.summary import summarise_session

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
        from kennfeld.app.questions.overview import AppState, NoProject, StateNews, overview
        from kennfeld.app.wire import to_answer

        session = self._sessions.get(project)
        state = NoProject() if session is None else overview(session)
        # what pages know
        self._changed[project] = state.changed_on_disk if isinstance(state, AppState) else []
        return to_answer(StateNews(state))


@dataclass(frozen=True)
class ActivityNews:
    """An activity that takes a while, and the share of it that is done; an empty text at its end."""

    text: str
    share: float | None


def _activity_news(text: str, share: float | None) -> Answer:
    from kennfeld.app.wire import to_answer

    return to_answer(ActivityNews(text, share))


def project_file(path: Path) -> Path:
    """Return a project file, or that of a folder. Raises `InputError` if it does not exist."""
    if path.is_dir():
        path = path / "kennfeld.toml"
    if not path.is_file():
        raise InputError.of(Location(str(path)), "the project file does not exist", "Name a kennfeld.toml.")
    return path


def _remove_parts(folder: Path) -> None:
    """Remove what uploads to an earlier server left behind that was killed."""
    with suppress(OSError):
        for path in folder.glob(f".*{UPLOAD_ENDING}"):
            if time.time() - path.stat().st_mtime > ABANDONED:
                path.unlink(missing_ok=True)
