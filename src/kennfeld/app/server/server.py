"""The server: the page, its socket, uploads and downloads.

It answers before what opens projects and answers questions is loaded, which the thread of the sessions does meanwhile.
"""

import asyncio
import contextlib
import json
import secrets
import socket
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

import uvicorn
from starlette.applications import Starlette
from starlette.background import BackgroundTask
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from kennfeld.app.answer import Answer
from kennfeld.app.archive import write_archive
from kennfeld.app.server.restart import Handshake
from kennfeld.app.server.security import RequestGuard, new_token
from kennfeld.app.server.static_files import StaticFiles
from kennfeld.app.workspace import UPLOAD_ENDING, AppWorkspace
from kennfeld.base.errors import ArgumentError, KennfeldError
from kennfeld.base.lazy_dataclass import dataclass

STATIC = Path(__file__).parent.parent / "static"
MAX_MESSAGE = 4_000_000  # bytes; a pasted table of 10 000 values takes 200 000
MAX_UPLOAD = 4_000_000_000  # bytes
CHUNK = 1_000_000  # bytes of a download that are sent at once
WATCH_INTERVAL = 1.0  # s between looks at the files on disk
SLOW_CLIENT = 10.0  # s after which a page that does not read is closed


@dataclass(frozen=True)
class PageQuestion:
    """A question of a page: its number, which the answer repeats, its name, its details, and the project it is about.

    Without a project, it is about the one that the page shows.
    """

    id: int
    ask: str
    with_: Mapping[str, Any] | None = None
    project: str | None = None


class Server:
    """Serves a workspace to any number of pages; those of one project show the same state.

    Args:
        workspace: what is served.
        key: of the pages that know the server.
        first: called one after another in the thread of the sessions while the browser starts; pages wait for them,
            and see what is read. The end of the server skips those that have not begun.
        failed: called if one of them raises an exception.
    """

    def __init__(
        self,
        workspace: AppWorkspace,
        key: str = "",
        first: Sequence[Callable[[], object]] = (),
        failed: Callable[[BaseException], object] = lambda _: None,
    ) -> None:
        self.workspace, self.nonce, self._key = workspace, new_token(), key
        self._first, self._failed = first, failed
        self._pages: set[OpenPage] = set()
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="session")  # the session is used by one thread
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ended = threading.Event()

    def application(self) -> Starlette:
        """Return the application, without the guard."""

        @contextlib.asynccontextmanager
        async def lifespan(_: Starlette) -> Any:
            self._loop = asyncio.get_running_loop()
            self.workspace.subscribe(self._push_from_thread, self._pump_from_thread)
            self._executor.submit(self._begin)
            watch = asyncio.create_task(self._watch())
            yield
            watch.cancel()
            self._ended.set()
            self.workspace.stop_activity()  # else the end waits for what is read
            self._executor.shutdown(wait=False, cancel_futures=True)

        return Starlette(
            routes=[
                Route("/", self._page),
                WebSocketRoute("/socket", self._socket),
                Route("/upload/{name:path}", self._upload, methods=["PUT"]),
                Route("/file/{name:path}", self._download),
                Route("/project.zip", self._archive),
                Route("/stop-activity", self._stop_activity, methods=["POST"]),
                Mount("/static", StaticFiles(STATIC)),
            ],
            exception_handlers={KennfeldError: _refusal},
            lifespan=lifespan,
        )

    def _begin(self) -> None:
        try:
            for step in self._first:
                if not self._ended.is_set():
                    step()
        except BaseException as error:
            self._failed(error)

    async def _watch(self) -> None:
        """Tell the pages when another program changes the project file."""
        while True:
            await asyncio.sleep(WATCH_INTERVAL)
            shown = {page.project for page in self._pages}
            await self._in_session(partial(self.workspace.watch, shown))

    async def _page(self, request: Request) -> Response:
        text = (STATIC / "index.html").read_text(encoding="utf-8")
        metas = f'<meta name="nonce" content="{self.nonce}" /><meta name="again" content="{self._key}" />'
        page = text.replace("<head>", f"<head>{metas}", 1)
        return HTMLResponse(page, headers={"cache-control": "no-store"})

    async def _socket(self, websocket: WebSocket) -> None:
        await websocket.accept()
        asked = websocket.query_params.get("project", "")
        page = OpenPage(websocket)
        sender = asyncio.create_task(page.send_all())
        try:
            self._pages.add(page)  # before it has a project, it gets the progress of what takes a while
            if (activity := self.workspace.activity) is not None:
                page.put(activity, "activity")
            page.project = await self._in_session(lambda: self.workspace.join(asked))
            page.put(await self._snapshot(page.project), "state")
            while True:
                await self._answer(page, await websocket.receive())
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            self._pages.discard(page)
            sender.cancel()

    async def _answer(self, page: "OpenPage", message: Any) -> None:
        """Answer one question; an error is an answer too, so that no page waits for ever."""
        from kennfeld.app.project_questions import OPENING
        from kennfeld.app.wire import from_json

        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect
        number: Any = None
        try:
            said = _parsed(message.get("text") or "")
            number = said.get("id") if isinstance(said, dict) else None
            question: PageQuestion = from_json(PageQuestion, said, "question")
            project = page.project if question.project is None else question.project
            answer = await self._in_session(lambda: self.workspace.answer(question.ask, question.with_ or {}, project))
            if question.ask in OPENING:
                page.show(answer.head["project"], await self._snapshot(answer.head["project"]))
        except KennfeldError as error:
            page.put(Answer({"id": number, "error": str(error)}))
        except Exception as error:  # a page that waits for an answer would be lost
            page.put(
                Answer({"id": number, "error": f"The question cannot be answered: {type(error).__name__} {error}"})
            )
        else:
            page.put(Answer({"id": number, **answer.head}, answer.arrays))

    async def _snapshot(self, project: str) -> Answer:
        answer: Answer = await self._in_session(lambda: self.workspace.snapshot(project))
        return answer

    async def _in_session(self, work: Callable[[], Any]) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._executor, work)

    def _pump_from_thread(self, project: str) -> None:
        with contextlib.suppress(RuntimeError):  # the server has ended, and a run that it ends reports so
            self._executor.submit(self.workspace.pump, project)

    def _push_from_thread(self, topic: str, answer: Answer, project: str) -> None:
        if self._loop is not None and not self._loop.is_closed():
            # pages belong to the event loop, news come from the thread of the session
            self._loop.call_soon_threadsafe(self._push, topic, answer, project)

    def _push(self, topic: str, answer: Answer, project: str) -> None:
        for page in self._pages:
            if page.project == project:
                page.put(answer, topic)

    async def _upload(self, request: Request) -> Response:
        """Store a file that was dropped onto the page in the folder of the project."""
        project = await self._asked_for(request)
        folder = await self._in_session(lambda: self.workspace.folder(project))
        size = 0
        # a hidden file beside the target, so that the rename at the end stays within one file system
        part = folder / f".{secrets.token_hex(8)}{UPLOAD_ENDING}"
        try:
            with part.open("xb") as file:
                async for chunk in request.stream():
                    size += len(chunk)
                    if size > MAX_UPLOAD:
                        return JSONResponse({"error": f"larger than {MAX_UPLOAD / 1e9:.0f} GB"}, 413)
                    file.write(chunk)
            target = await self._in_session(lambda: self.workspace.store(part, request.path_params["name"], project))
        except OSError as error:
            return JSONResponse({"error": f"cannot be stored: {error.strerror or error}"}, 507)
        except ClientDisconnect:
            return Response(status_code=400)
        finally:
            part.unlink(missing_ok=True)
        return JSONResponse({"file": target.name})

    async def _download(self, request: Request) -> Response:
        name, project = request.path_params["name"], await self._asked_for(request)
        path = await self._in_session(lambda: self.workspace.download(name, project))
        return FileResponse(path, filename=path.name)

    async def _stop_activity(self, request: Request) -> Response:
        """Stop what takes a while. Not a question, as the thread that answers these is busy with it."""
        self.workspace.stop_activity()
        return Response(status_code=204)

    async def _asked_for(self, request: Request) -> str:
        """Return the project that an address names, else the last one; one that is being opened is waited for."""
        named = request.query_params.get("project")
        return named or await self._in_session(lambda: self.workspace.latest)

    async def _archive(self, request: Request) -> Response:
        """Return the folder of the project as it is on disk, without what begins with a dot."""
        project = await self._asked_for(request)
        folder = await self._in_session(lambda: self.workspace.folder(project))
        # on disk, as the archive may be larger than memory
        file = tempfile.TemporaryFile()  # noqa: SIM115  (closed when the answer has been sent)
        try:
            await asyncio.to_thread(write_archive, folder, file)
        except BaseException:
            file.close()
            raise
        size = file.tell()
        file.seek(0)
        headers = {"content-disposition": _attachment(f"{folder.name}.zip"), "content-length": str(size)}
        chunks = iter(lambda: file.read(CHUNK), b"")
        return StreamingResponse(chunks, 200, headers, "application/zip", BackgroundTask(file.close))


def _parsed(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError as error:
        raise ArgumentError(f"the question is not JSON: {error}") from None


def _attachment(name: str) -> str:
    return f"attachment; filename*=utf-8''{quote(name)}"


async def _refusal(request: Request, error: Exception) -> Response:
    return JSONResponse({"error": str(error)}, 404)


def packed(answer: Answer) -> bytes:
    """Return the frame of an answer; of one that cannot be sent, an error in its place, so that no page waits."""
    from kennfeld.app.server.frames import pack

    try:
        return pack(answer.head, answer.arrays)
    except (TypeError, ValueError) as error:
        about = {key: answer.head[key] for key in ("id", "push") if key in answer.head}
        return pack({**about, "error": f"The answer cannot be sent: {error}"}, {})


class OpenPage:
    """One page: what is to be sent to it, in order. Of each topic only the newest message waits.

    The state after a command precedes the answer to it: when that comes, the page shows what the command did.

    Attributes:
        project: id of the project that it shows; empty if none.
    """

    def __init__(self, websocket: WebSocket) -> None:
        self.project = ""
        self._websocket = websocket
        self._waiting: list[tuple[str, Answer]] = []  # with its topic, which answers lack
        self._ready = asyncio.Event()

    def put(self, answer: Answer, topic: str = "") -> None:
        if topic:
            answer = Answer({"push": topic, **answer.head}, answer.arrays)
            self._drop_older(topic)
        self._waiting.append((topic, answer))
        self._ready.set()

    def _drop_older(self, topic: str) -> None:
        """Drop the message of a topic that waits, unless an answer waits behind it, which it is to precede."""
        for index in range(len(self._waiting) - 1, -1, -1):
            if self._waiting[index][0] in ("", topic):
                if self._waiting[index][0]:
                    del self._waiting[index]
                return

    def show(self, project: str, state: Answer) -> None:
        """Show another project: its state precedes the answer to the question that opened it."""
        self.project = project
        self.put(state, "state")

    async def send_all(self) -> None:
        """Send what waits, for as long as the page is open."""
        while True:
            await self._ready.wait()
            self._ready.clear()
            waiting, self._waiting = self._waiting, []
            for _, answer in waiting:
                data = packed(answer)
                try:
                    await asyncio.wait_for(self._websocket.send_bytes(data), SLOW_CLIENT)
                except (TimeoutError, RuntimeError, WebSocketDisconnect):
                    with contextlib.suppress(RuntimeError):
                        await self._websocket.close()
                    return


def run_server(
    workspace: AppWorkspace,
    listener: socket.socket,
    key: str,
    token: str,
    ticket: str = "",
    first: Sequence[Callable[[], object]] = (),
) -> None:
    """Serve a workspace at a socket until Ctrl-C.

    Args:
        workspace: what is served.
        listener: a listening socket of the loopback interface.
        key: of the pages that know the server.
        token: opens a page.
        ticket: opens one page, in place of the token.
        first: called one after another in the thread of the sessions; what one of them raises ends the server.

    Raises:
        BaseException: what one of `first` has raised.
    """
    port, errors = listener.getsockname()[1], list[BaseException]()

    def failed(error: BaseException) -> None:
        errors.append(error)
        server.should_exit = True

    own = Server(workspace, key, first, failed)
    guarded = RequestGuard(own.application(), port, token, own.nonce, Handshake(port, key), ticket=ticket)
    config = uvicorn.Config(
        guarded, log_level="error", ws="websockets-sansio", ws_max_size=MAX_MESSAGE, lifespan="on", server_header=False
    )
    server = uvicorn.Server(config)
    asyncio.run(server.serve(sockets=[listener]))
    if errors:
        raise errors[0]
