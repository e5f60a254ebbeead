"""Access to the server: only for the browser that opened the address it printed.

The printed address carries a random token. The first request swaps it for a cookie that scripts cannot read and other
sites cannot send. The browser that the command opens gets a token of its own, which opens one page, from a file that
only the user can read: other users see the arguments of all programs. `Host` must be one of the server's own names, so
that a name which an attacker lets point to this machine is refused (DNS rebinding); `Origin` must be the server itself,
so that another page cannot open the socket.
"""

import asyncio
import json
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from contextlib import suppress
from http.cookies import CookieError, SimpleCookie
from typing import Any

from kennfeld.app.server.restart import Handshake

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'nonce-{nonce}'; img-src 'self' data: blob:; "
    "font-src 'self'; connect-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'self'"
)
HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
)
TICKET = "open"  # key of the token that opens one page
# without an icon, browsers ask for one
WELCOME = b'<!doctype html><link rel="icon" href="data:,"><meta http-equiv="refresh" content="0;url=/">'
POLICY_VIOLATION = 1008  # close code of a socket
NORMAL_CLOSURE = 1000
MAX_BODY = 2000  # bytes of a request before a page is let in
PATIENCE = 10.0  # s for the question of a page that is not let in yet


class RequestGuard:
    """Lets requests through that carry the cookie, and have the right `Host` and `Origin`.

    Args:
        application: what is guarded.
        port: port of the server; the cookie is named after it, so that two servers do not share one.
        token: secret of this server.
        nonce: marks the style sheets that the page makes itself.
        handshake: lets pages in that were open before the server was restarted.
        hosts: names of the server in addition to those of the loopback interface.
        ticket: a token that opens one page; empty for none.
    """

    def __init__(
        self,
        application: Application,
        port: int,
        token: str,
        nonce: str,
        handshake: Handshake,
        hosts: tuple[str, ...] = (),
        ticket: str = "",
    ) -> None:
        self._ticket = ticket
        self._application, self._token, self._handshake = application, token, handshake
        self._headers = ((b"content-security-policy", POLICY.format(nonce=nonce).encode()), *HEADERS)
        self._cookie = f"kennfeld-{port}"
        self._hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost", "[::1]", *hosts)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._application(scope, receive, send)
            return
        headers = {name.decode("latin-1").lower(): value.decode("latin-1") for name, value in scope["headers"]}
        # foreign names and origins are refused before any secret is compared
        if headers.get("host", "").lower() not in self._hosts:
            await _refuse(scope, receive, send, 421, "This address is not served here.")
        elif not self._is_own_origin(scope, headers):
            await _refuse(scope, receive, send, 403, "Requests from other pages are refused.")
        elif scope["type"] == "http" and scope["path"] == "/" and _has_query(scope, "token", self._token):
            await _redirect(send, self._cookie, self._token)
        elif scope["type"] == "http" and scope["path"] == "/" and _has_query(scope, TICKET, self._ticket):
            self._ticket = ""
            await _welcome(send, self._cookie, self._token)
        elif scope["path"] == "/again" and scope["type"] == "websocket":
            await self._challenge(receive, send)
        elif scope["path"] == "/again" and scope["method"] == "POST":
            await self._let_in_again(receive, send)
        elif not self._has_cookie(headers):
            await _refuse(scope, receive, send, 403, "Open the address that kennfeld app printed.")
        else:
            await self._application(scope, receive, self._with_headers(send))

    async def _challenge(self, receive: Receive, send: Send) -> None:
        """Prove the key to a page that was open before the server was restarted, and ask it for its proof."""
        await receive()  # the request to connect
        await send({"type": "websocket.accept"})
        with suppress(TimeoutError):
            message = await asyncio.wait_for(receive(), PATIENCE)
            answer = self._handshake.challenge(_small_object(message.get("text") or "").get("nonce"))
            if answer is not None:
                await send({"type": "websocket.send", "text": json.dumps(answer)})
            if message["type"] == "websocket.disconnect":
                return
        await send({"type": "websocket.close", "code": NORMAL_CLOSURE})

    async def _let_in_again(self, receive: Receive, send: Send) -> None:
        """Give a page that proves the key the cookie."""
        proof = _small_object(await _small_body(receive))
        accepted = self._handshake.accepts(proof.get("challenge"), proof.get("proof"))
        cookie = [(b"set-cookie", _cookie_header(self._cookie, self._token))] if accepted else []
        headers = [(b"cache-control", b"no-store"), *cookie, *HEADERS]
        await send({"type": "http.response.start", "status": 204 if accepted else 403, "headers": headers})
        await send({"type": "http.response.body", "body": b""})

    def _with_headers(self, send: Send) -> Send:
        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", []), *self._headers]
            await send(message)

        return guarded

    def _is_own_origin(self, scope: Scope, headers: MutableMapping[str, str]) -> bool:
        """Check `Origin`, which browsers send with every socket and every request that changes something."""
        origin = headers.get("origin")
        # links and the address bar send no `Origin`; they must not change anything
        if origin is None:
            return scope["type"] == "http" and scope["method"] in ("GET", "HEAD")
        scheme, _, host = origin.lower().partition("://")
        return scheme in ("http", "https") and host == headers["host"].lower()

    def _has_cookie(self, headers: MutableMapping[str, str]) -> bool:
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(self._cookie)
        except CookieError:
            return False
        # in constant time, so that the answer does not tell how much of a guess is right
        return cookie is not None and secrets.compare_digest(
            cookie.value.encode("latin-1", "replace"), self._token.encode()
        )


def _has_query(scope: Scope, key: str, secret: str) -> bool:
    name, _, value = scope["query_string"].decode("latin-1").partition("=")
    return bool(secret) and name == key and secrets.compare_digest(value.encode("latin-1"), secret.encode())


def new_token() -> str:
    """Return a secret that cannot be guessed."""
    return secrets.token_urlsafe(32)


def _cookie_header(cookie: str, token: str) -> bytes:
    return f"{cookie}={token}; Path=/; HttpOnly; SameSite=Strict".encode()


async def _small_body(receive: Receive) -> bytes:
    """Return the body of a request; empty if it is too large."""
    body, more = b"", True
    while more:
        message = await receive()
        body += message.get("body", b"")
        more = bool(message.get("more_body"))
        # also if the client has gone, which sends no further parts
        if message["type"] != "http.request" or len(body) > MAX_BODY:
            return b""
    return body


def _small_object(text: str | bytes) -> dict[str, Any]:
    """Return a JSON object; empty if the text is malformed or too large."""
    try:
        content = json.loads(text) if len(text) <= MAX_BODY else {}
    except (ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


async def _redirect(send: Send, cookie: str, token: str) -> None:
    """Swap the token of the address for a cookie."""
    value = _cookie_header(cookie, token)
    headers = [(b"location", b"/"), (b"set-cookie", value), (b"cache-control", b"no-store"), *HEADERS]
    await send({"type": "http.response.start", "status": 303, "headers": headers})
    await send({"type": "http.response.body", "body": b""})


async def _welcome(send: Send, cookie: str, token: str) -> None:
    """Swap the token of a file for a cookie; the page itself goes on, as browsers send no such cookie for a file."""
    kind = (b"content-type", b"text/html; charset=utf-8")
    headers = [kind, (b"set-cookie", _cookie_header(cookie, token)), (b"cache-control", b"no-store"), *HEADERS]
    await send({"type": "http.response.start", "status": 200, "headers": headers})
    await send({"type": "http.response.body", "body": WELCOME})


async def _refuse(scope: Scope, receive: Receive, send: Send, status: int, reason: str) -> None:
    if scope["type"] == "websocket":
        await receive()  # the request to connect; closing before it is accepted answers with 403
        await send({"type": "websocket.close", "code": POLICY_VIOLATION})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8"), *HEADERS]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": reason.encode()})
