"""Streams of unpacked content that end in a finding if they unpack to far more than the packed size."""

import io
from typing import BinaryIO, cast

from kennfeld.base.archives import most_unpacked
from kennfeld.base.errors import InputError, Location

_BUFFER = 1 << 16  # bytes


def limited(stream: io.BufferedIOBase, name: str, packed: int) -> BinaryIO:
    """Return a stream that unpacks so many packed bytes of a file.

    It raises `InputError` as soon as it has unpacked more than `most_unpacked`.
    """
    return cast(BinaryIO, io.BufferedReader(_LimitedStream(stream, name, packed), _BUFFER))


class _LimitedStream(io.RawIOBase):
    """The unpacked content of a file up to a limit."""

    def __init__(self, stream: io.BufferedIOBase, name: str, packed: int) -> None:
        self._stream, self._name, self._packed = stream, name, packed
        self._most = most_unpacked(packed)

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return self._stream.seekable()

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        return self._stream.seek(offset, whence)

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        content = self._stream.read1(len(buffer))
        # after each piece, so that at most one is unpacked beyond the limit
        if self._stream.tell() > self._most:
            raise InputError.of(Location(self._name), _describe_size(self._packed), "Unpack it first if you trust it.")
        buffer[: len(content)] = content
        return len(content)

    def close(self) -> None:
        self._stream.close()
        super().close()


def _describe_size(packed: int) -> str:
    most = most_unpacked(packed)
    ratio = f"{most / packed:.0f} times its size" if packed else "too much"
    return f"its {packed / 1e6:.3g} MB unpack to more than {most / 1e6:.0f} MB, {ratio}"
