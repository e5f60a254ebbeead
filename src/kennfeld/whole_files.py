"""Files that are written whole or not at all."""

import os
import threading
from contextlib import suppress
from pathlib import Path

__all__ = ["write_whole"]


def write_whole(path: Path, content: bytes | str, *, durable: bool = False) -> None:
    """Write beside, then rename, so that nobody ever sees half a file; text as UTF-8. A link stays a link.

    With `durable` it is on the disk before the old file goes: a power cut leaves one of the two. Raises `OSError`.
    """
    target = path.resolve()
    beside = target.with_name(f".{target.name}.{os.getpid()}-{threading.get_ident()}")
    try:
        with beside.open("wb") as file:
            file.write(content.encode("utf-8") if isinstance(content, str) else content)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        beside.replace(target)
    finally:
        with suppress(OSError):
            beside.unlink(missing_ok=True)
