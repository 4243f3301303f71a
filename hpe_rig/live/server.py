"""Server of the live page: loopback only, a random token in the address, one task for each viewer.

A slow viewer misses states. It delays neither the reading of the next state nor the acquisition.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import secrets
import socket
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from importlib import resources
from typing import final

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.http.h11_impl import H11Protocol

from hpe_rig.live.source import Source
from hpe_rig.store import StoreError, reason

HOST = "127.0.0.1"
START_S = 5.0
MIN_PAUSE_S = 0.15
FINAL_PAUSE_S = 0.02
IDLE_RATIO = 2.0
"""Pause of the reader over the time of its last reading, which leaves the processor core to the acquisition."""
REQUEST_TIMEOUT_S, CHECK_PERIOD_S = 5.0, 1.0
"""Time limit of a complete request, which ends half-open connections, and period of its check."""
MAX_CONNECTIONS = 64
"""Limit on connections without the page's token, and on viewers, since each costs memory and file handles."""
TOKEN_TIME_S = 0.2
"""Time after which a connection without the token may be closed: its request may not have been read yet."""
ENDED = ("complete", "aborted", "failed", "killed")


@final
class LimitedProtocol(H11Protocol):
    """HTTP with a limit on connections; a connection without a complete request in ``REQUEST_TIMEOUT_S`` is closed.

    The limit applies to connections that have not sent the page's token, so that its holder reaches the stop button.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Accept a connection; after ``TOKEN_TIME_S`` those without the token are limited to ``MAX_CONNECTIONS``."""
        super().connection_made(transport)
        self._made_s = self._waits_since_s = self.loop.time()
        self._check_timeout()
        self.loop.call_later(TOKEN_TIME_S, self._close_oldest)

    def _close_oldest(self) -> None:
        """Close the oldest connections without the token that are too many."""
        strangers = [item for item in self.connections if isinstance(item, LimitedProtocol) and not item.has_token]
        for item in sorted(strangers, key=lambda item: item._made_s)[:-MAX_CONNECTIONS]:
            item.transport.abort()

    @property
    def has_token(self) -> bool:
        """Whether the latest request of the connection has the page's token in its path."""
        return self.scope is not None and self.scope["path"].startswith(self.app_state["base"])

    def _check_timeout(self) -> None:
        """Close the connection after the time limit of a request; else schedule the next check."""
        if self.transport.is_closing() or self.transport.get_protocol() is not self:
            # Closed, or upgraded to the web socket of a viewer.
            return
        if self.cycle is not None and not self.cycle.response_complete:
            self._waits_since_s = self.loop.time()
        elif self.loop.time() - self._waits_since_s > REQUEST_TIMEOUT_S:
            self.transport.abort()
            return
        self.loop.call_later(CHECK_PERIOD_S, self._check_timeout)


@final
class LivePage:
    """The page of ``source`` at ``address``; ``serve`` runs until ``close``, in this or another thread."""

    def __init__(self, source: Source, port: int = 0, token: str | None = None) -> None:
        """Bind a loopback port, by default any free one; raise ``StoreError`` if it is in use."""
        self._source = source
        self._token = token or secrets.token_urlsafe(24)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        if os.name == "posix":
            # The page of the next run may reuse the port at once; Windows permits this by default.
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind((HOST, port))
            # Connections before the start of the server wait instead of being refused.
            self._socket.listen(64)
        except OSError as error:
            self._socket.close()
            remedy = "another --port, or none for any free one"
            raise StoreError(f"port {port} cannot be used ({reason(error)}). Try: {remedy}.") from None
        self._port = int(self._socket.getsockname()[1])
        self.address = f"http://{HOST}:{self._port}/{self._token}/"
        self._latest, self._version = json.dumps({"status": "waiting"}), 0
        self._ended = self._serving = self._closing = False
        self._sent: dict[WebSocket, int] = {}  # version of the last state sent to each viewer
        config = uvicorn.Config(
            self._application(),
            log_level="error",
            access_log=False,
            http=LimitedProtocol,
            ws="websockets-sansio",
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)

    def serve(self) -> None:
        """Serve until ``close`` or Ctrl-C."""
        self._serving = True
        try:
            self._server.run(sockets=[self._socket])
        finally:
            # A server stopped during its start leaves the port open.
            self._socket.close()

    def close(self, grace_s: float = 0.0) -> None:
        """Stop serving once every viewer has the last state, at most after ``grace_s``."""
        if not self._serving:
            self._socket.close()
            return
        self._closing = True
        _wait(lambda: self._ended and all(version == self._version for version in [*self._sent.values()]), grace_s)
        # A server stopped during its start does not release its resources.
        _wait(lambda: self._server.started, START_S)
        self._server.should_exit = True

    def _application(self) -> Starlette:
        base = f"/{self._token}"
        routes = [
            Route(f"{base}/", self._local_only(self._page)),
            Route(f"{base}/stop", self._local_only(self._stop), methods=["POST"]),
            Route(f"{base}/pause", self._local_only(self._pause), methods=["POST"]),
            Route(f"{base}/close", self._local_only(self._close), methods=["POST"]),
            Route(f"{base}/state", self._local_only(self._state)),
            WebSocketRoute(f"{base}/ws", self._watch),
        ]
        return Starlette(routes=routes, lifespan=self._reading)

    def _local_only(self, answer: Callable[[Request], Awaitable[Response]]) -> Callable[[Request], Awaitable[Response]]:
        """Return ``answer`` such that requests from elsewhere get status 403."""

        async def guarded(request: Request) -> Response:
            return await answer(request) if self._is_allowed(request.headers) else Response(status_code=403)

        return guarded

    @contextlib.asynccontextmanager
    async def _reading(self, application: Starlette) -> AsyncIterator[dict[str, str]]:
        """Read the source while the application runs; yield its state, which the connections get."""
        self._changed = asyncio.Condition()
        reader = asyncio.create_task(self._read())
        try:
            yield {"base": f"/{self._token}/"}
        finally:
            reader.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await reader

    async def _read(self) -> None:
        """Poll the source, and wake the viewers after every change."""
        while True:
            start_s = time.monotonic()
            text = await asyncio.to_thread(self._next)
            if text is not None:
                async with self._changed:
                    self._latest, self._version = text, self._version + 1
                    self._changed.notify_all()
            pause_s = max(MIN_PAUSE_S, IDLE_RATIO * (time.monotonic() - start_s))
            deadline_s = time.monotonic() + pause_s
            # After a request to stop, or while the page closes, the last state is urgent.
            while time.monotonic() < deadline_s and not self._closing:
                await asyncio.sleep(min(pause_s, 0.1))
            await asyncio.sleep(FINAL_PAUSE_S)

    def _next(self) -> str | None:
        try:
            state = self._source.poll()
        except Exception as error:
            # An error of one state must not end the page, which has the stop button.
            state = {"status": "waiting", "why": f"{type(error).__name__}: {error}"}
        if state is None:
            return None
        # The last state has the estimates of every complete shot.
        self._ended = state.get("status") in ENDED and not state.get("shots_pending")
        return json.dumps(state, allow_nan=False, separators=(",", ":"))

    async def _page(self, request: Request) -> Response:
        nonce = secrets.token_urlsafe(12)
        text = (resources.files("hpe_rig.live") / "live.html").read_text(encoding="utf-8")
        policy = f"default-src 'none'; style-src 'nonce-{nonce}'; script-src 'nonce-{nonce}'; connect-src 'self'"
        headers = {
            "Content-Security-Policy": f"{policy}; base-uri 'none'; form-action 'self'; frame-ancestors 'none'",
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
        }
        return HTMLResponse(text.replace("@NONCE@", nonce), headers=headers)

    async def _state(self, request: Request) -> Response:
        return Response(self._latest, media_type="application/json", headers={"Cache-Control": "no-store"})

    async def _stop(self, request: Request) -> Response:
        response = await _forwarded(self._source.stop, {"stopping": True})
        self._closing = self._closing or response.status_code == 200
        return response

    async def _pause(self, request: Request) -> Response:
        return await _forwarded(self._source.pause, {"asked": True})

    async def _close(self, request: Request) -> Response:
        """Close the page after the end of the run."""
        if not self._ended:
            return JSONResponse({"error": "the run is active. Try: Stop safely first."}, status_code=409)
        self._server.should_exit = True
        return JSONResponse({"closed": True})

    async def _watch(self, viewer: WebSocket) -> None:
        """Send the latest state to a viewer whenever it is ready for one."""
        if not self._is_allowed(viewer.headers) or len(self._sent) >= MAX_CONNECTIONS:
            await viewer.close(code=1008)
            return
        await viewer.accept()
        disconnected = asyncio.create_task(_until_disconnected(viewer))
        self._sent[viewer] = -1
        try:
            while not disconnected.done():
                async with self._changed:
                    with contextlib.suppress(TimeoutError):
                        changed = self._changed.wait_for(lambda: self._sent[viewer] != self._version)
                        await asyncio.wait_for(changed, timeout=1.0)
                    text, version = self._latest, self._version
                if version != self._sent[viewer] and not disconnected.done():
                    await viewer.send_text(text)
                    self._sent[viewer] = version
        except (WebSocketDisconnect, RuntimeError):
            # The viewer left between two states.
            return
        finally:
            disconnected.cancel()
            del self._sent[viewer]

    def _is_allowed(self, headers: Headers) -> bool:
        """Return whether host and origin are local; this blocks DNS rebinding and requests of other pages."""
        local = {f"{HOST}:{self._port}", f"localhost:{self._port}"}
        origin = headers.get("origin")
        return headers.get("host") in local and (origin is None or origin.removeprefix("http://") in local)


async def _forwarded(action: Callable[[], None], answer: dict[str, bool]) -> Response:
    """Return ``answer`` after the request of a viewer, or the reason why it is impossible."""
    try:
        await asyncio.to_thread(action)
    except StoreError as error:
        return JSONResponse({"error": str(error)}, status_code=409)
    return JSONResponse(answer)


def _wait(ready: Callable[[], bool], longest_s: float) -> None:
    deadline_s = time.monotonic() + longest_s
    while not ready() and time.monotonic() < deadline_s:
        time.sleep(0.02)


async def _until_disconnected(viewer: WebSocket) -> None:
    """Return when the viewer has disconnected; discard its messages."""
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            message = await viewer.receive()
            if message["type"] == "websocket.disconnect":
                return
