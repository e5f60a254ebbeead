"""A link of limited speed: a proxy in front of a scheduler that delays what passes, both ways."""

import asyncio
import threading
from dataclasses import dataclass
from typing import Self

__all__ = ["DelayedLink"]

BLOCK = 65536  # bytes


@dataclass
class DelayedLink:
    """A proxy before a scheduler at this host and port; `latency` in s one way, `bandwidth` in bytes per s."""

    host: str
    port: int
    latency: float
    bandwidth: float

    def __enter__(self) -> Self:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        self._server = asyncio.run_coroutine_threadsafe(
            asyncio.start_server(self._connect, "127.0.0.1", 0), self._loop
        ).result()
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._server.close)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    @property
    def address(self) -> str:
        """Address of the proxy."""
        return f"tcp://127.0.0.1:{self._server.sockets[0].getsockname()[1]}"

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        other_reader, other_writer = await asyncio.open_connection(self.host, self.port)
        await asyncio.gather(self._pass(reader, other_writer), self._pass(other_reader, writer))

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Pass blocks on: each leaves when the link has carried those before, and arrives the latency later."""
        loop, free = asyncio.get_running_loop(), 0.0
        waiting: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
        arriving = loop.create_task(_deliver(waiting, writer))
        try:
            while block := await reader.read(BLOCK):
                free = max(free, loop.time()) + len(block) / self.bandwidth
                waiting.put_nowait((free + self.latency, block))
            await waiting.join()
        except OSError:
            pass
        finally:
            arriving.cancel()
            writer.close()


async def _deliver(waiting: "asyncio.Queue[tuple[float, bytes]]", writer: asyncio.StreamWriter) -> None:
    loop = asyncio.get_running_loop()
    while True:
        at, block = await waiting.get()
        await asyncio.sleep(max(0.0, at - loop.time()))
        writer.write(block)
        await writer.drain()
        waiting.task_done()
