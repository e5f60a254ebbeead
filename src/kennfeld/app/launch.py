"""Start of the app: serve a project and open the page in the browser."""

import webbrowser
from pathlib import Path

from kennfeld.app.server.server import serve
from kennfeld.app.workspace import AppWorkspace
from kennfeld.errors import InputError, Location
from kennfeld.run_processes import unmarked


def launch(path: Path | None, port: int = 0, *, browser: bool = True) -> None:
    """Serve a project until Ctrl-C. The first line on stdout is the address of the page.

    Args:
        path: a project file; None shows the start page.
        port: 0 takes that of the last start of the project if it is free, else any free one.
        browser: open the page.

    Raises:
        InputError: the project file does not exist, or the port is taken.
    """
    workspace = AppWorkspace(path)

    def ready(address: str) -> None:
        print(f"Kennfeld runs at {address}", flush=True)
        if browser:
            with unmarked():
                webbrowser.open(address)

    try:
        serve(workspace, port, ready, path)
    except OSError as error:
        message = f"port {port} cannot be used: {error.strerror or error}"
        raise InputError.of(Location("--port"), message, "Name another one, or 0 for a free one.") from None
    except KeyboardInterrupt:
        pass
    finally:
        workspace.close()
