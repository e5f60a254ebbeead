"""Start of the app: serve a project and open the page in the browser."""

import gc
import webbrowser
from contextlib import ExitStack, suppress
from html import escape
from pathlib import Path
from urllib.parse import urlsplit, urlunsplit

from kennfeld.app.server.restart import servers_folder
from kennfeld.app.server.security import TICKET, new_token
from kennfeld.app.server.serving import serve
from kennfeld.app.session.files_on_disk import read_exactly
from kennfeld.app.workspace import AppWorkspace, project_file
from kennfeld.base.atomic_files import write_whole
from kennfeld.base.errors import InputError, Location
from kennfeld.base.run_processes import unmarked

COLLECTIONS = (200_000, 50, 50)  # thresholds: what is loaded stays, and looking for garbage in it delays answers
REDIRECT = """<!doctype html>
<meta charset="utf-8">
<meta name="referrer" content="no-referrer">
<meta http-equiv="refresh" content="0;url={address}">
<title>Kennfeld</title>
<p><a href="{address}">Open Kennfeld</a></p>
"""


def launch(path: Path | None, port: int = 0, *, browser: bool = True) -> None:
    """Serve a project until Ctrl-C. The first line on stdout is the address of the page.

    Args:
        path: a project file; None shows the start page.
        port: 0 takes that of the last start of the project if it is free, else any free one.
        browser: open the page.

    Raises:
        InputError: the project file does not exist or is not text, or the port is taken.
    """
    if path is not None:
        read_exactly(project_file(path))  # what cannot be opened is refused before the browser starts
    gc.set_threshold(*COLLECTIONS)
    with ExitStack() as gates:
        _launch(AppWorkspace(), path, port, browser, gates)


def _launch(workspace: AppWorkspace, path: Path | None, port: int, browser: bool, gates: ExitStack) -> None:
    ticket, redirects = new_token(), list[Path]()

    def prepare() -> None:
        from kennfeld.models.code_consent import allowed_only

        gates.enter_context(allowed_only())  # what the user has not allowed is refused; the page asks

    def ready(address: str) -> None:
        print(f"Kennfeld runs at {address}", flush=True)
        if browser:
            with suppress(OSError), unmarked():  # the address is printed
                redirects.append(write_redirect(address, ticket))
                webbrowser.open(redirects[0].as_uri())

    try:
        serve(workspace, port, ready, path, ticket, prepare)
    except OSError as error:
        message = f"port {port} cannot be used: {error.strerror or error}"
        raise InputError.of(Location("--port"), message, "Name another one, or 0 for a free one.") from None
    except KeyboardInterrupt:
        pass
    finally:
        for redirect in redirects:
            with suppress(OSError):
                redirect.unlink(missing_ok=True)
        workspace.close()


def write_redirect(address: str, ticket: str) -> Path:
    """Write a page that leads to the app, which only the user can read, and return its path.

    The browser is given its path: other users see the arguments of a program, where the address with its token would
    stand.

    Args:
        address: the address of the app.
        ticket: the token that opens one page.

    Raises:
        OSError: the folder of the user cannot be written.
    """
    folder = servers_folder()
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    parts = urlsplit(address)._replace(query=f"{TICKET}={ticket}")
    path = folder / f"open-{parts.port}.html"
    write_whole(path, REDIRECT.format(address=escape(urlunsplit(parts))), private=True)
    return path.resolve()
