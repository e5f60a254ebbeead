"""Takes a port and names the address of the page, before the server is loaded: the browser starts meanwhile."""

import gc
import socket
from collections.abc import Callable
from functools import partial
from pathlib import Path

from kennfeld.app.server.restart import KnownServer, known_server, remember_server
from kennfeld.app.server.security import new_token
from kennfeld.app.workspace import AppWorkspace
from kennfeld.base.garbage_collection import no_collection


def serve(
    workspace: AppWorkspace,
    port: int,
    ready: Callable[[str], None],
    project: Path | None = None,
    ticket: str = "",
    prepare: Callable[[], object] = lambda: None,
) -> None:
    """Serve a workspace on the loopback interface until Ctrl-C.

    Args:
        workspace: what is served.
        port: 0 takes that of the last server of the project if it is free, else any free one.
        ready: called with the address to open once connections to it wait for the server.
        project: opened while the browser starts.
        ticket: a token that opens one page, in place of that of the address.
        prepare: called before anything is opened, in the thread that does so.

    Raises:
        InputError: the project cannot be opened.
        OSError: the port cannot be used.
    """
    known = known_server(project)
    listener = _listener(port or (known.port if known else 0), fallback=not port)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # else short answers wait 40 ms for each other
    port = listener.getsockname()[1]
    # a key belongs to a port, at which the pages that know it look for the server
    token, key = new_token(), known.key if known is not None and known.port == port else new_token()
    remember_server(project, KnownServer(port, key))

    steps: list[Callable[[], object]] = [prepare, workspace.load]
    if project is not None:
        steps.append(partial(workspace.open_first, project))
    # what is loaded stays, and is not searched for garbage again and again
    steps = [*(no_collection()(step) for step in steps), gc.freeze]
    with listener:
        ready(f"http://127.0.0.1:{port}/?token={token}")
        from kennfeld.app.server.server import run_server

        run_server(workspace, listener, key, token, ticket, steps)


def _listener(port: int, *, fallback: bool) -> socket.socket:
    """Return a socket at a port of the loopback interface; with `fallback` at a free one if it is taken."""
    try:
        return socket.create_server(("127.0.0.1", port))
    except OSError:
        if not fallback:
            raise
        return socket.create_server(("127.0.0.1", 0))
