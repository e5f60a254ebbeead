"""A server in a process of its own, and requests to it as a browser or an attacker would send them."""

import http.client
import json
import re
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from websockets.sync.client import ClientConnection, connect

from tests.app.app_processes import AppProcess, app_process


@dataclass
class Served:
    """A running server: its port, its token, and its process."""

    port: int
    token: str
    process: AppProcess

    @property
    def host(self) -> str:
        return f"127.0.0.1:{self.port}"

    @property
    def cookie(self) -> str:
        return f"kennfeld-{self.port}={self.token}"

    def request(
        self, method: str, path: str, headers: Mapping[str, str] | None = None, body: bytes = b""
    ) -> tuple[int, dict[str, str], bytes]:
        """Send a request with exactly these headers; return status, headers and body."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        try:
            connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            for name, value in {"Host": self.host, **(headers or {})}.items():
                connection.putheader(name, value)
            if body:
                connection.putheader("Content-Length", str(len(body)))
            connection.endheaders(body or None)
            answer = connection.getresponse()
            return answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read()
        finally:
            connection.close()

    @contextmanager
    def page(self, **headers: str) -> Iterator["Page"]:
        """Open a socket as the page does; keyword arguments replace its headers."""
        own = {"Origin": f"http://{self.host}", "Cookie": self.cookie} | headers
        origin = own.pop("Origin")
        with connect(
            f"ws://{self.host}/socket",
            origin=origin,
            additional_headers=own,
            max_size=None,
            open_timeout=20,  # type: ignore[arg-type]
            close_timeout=0.2,  # a page that does not read gets no answer to its good-bye
        ) as socket:
            yield Page(socket)


class Page:
    """A socket that asks questions."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket, self.state, self._count = socket, {}, 0
        self.activities: list[str] = []  # what took a while
        while self.receive()[0].get("push") != "state":
            pass  # the progress of what takes a while comes before

    def receive(self) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Return the next frame; a pushed state is kept."""
        frame = self.socket.recv(timeout=60)
        assert isinstance(frame, bytes)
        (length,) = struct.unpack_from("<I", frame)
        head, at, arrays = json.loads(frame[4 : 4 + length]), 4 + length, {}
        for name, size in head["arrays"]:
            arrays[name] = np.frombuffer(frame, "<f4", size, at)
            at += 4 * size
        if head.get("push") == "state":
            self.state = head["state"]
        if head.get("push") == "activity":
            self.activities.append(head["text"])
        return head, arrays

    def ask(self, question: str, **arguments: Any) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
        """Ask, and return the answer."""
        self._count += 1
        self.socket.send(json.dumps({"id": self._count, "ask": question, "with": arguments}))
        while True:
            head, arrays = self.receive()
            if head.get("id") == self._count:
                return head, arrays

    def wait_for(self, *states: str) -> None:
        """Wait until the job is in one of these states."""
        while self.state["job"]["state"] not in states:
            self.receive()


@contextmanager
def served(path: Path | None, home: Path | None = None, prelude: str = "") -> Iterator[Served]:
    """Serve a project.

    Args:
        path: the project file; None shows the start page.
        home: folder of the user; one of its own keeps what one server leaves for the next.
        prelude: a statement that the process of the server runs first.
    """
    if home is None:
        assert path is not None
        home = path.parent
    with app_process(path, home, home, prelude) as (line, process):
        match = re.fullmatch(r"Kennfeld runs at http://127\.0\.0\.1:(\d+)/\?token=(\S+)\n", line)
        assert match is not None
        yield Served(int(match[1]), match[2], process)
