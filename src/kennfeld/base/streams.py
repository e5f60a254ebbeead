"""Open streams in place of files, for readers that need a file."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO

Source = str | Path | IO[bytes] | IO[str]

_NAME = "stream"


def stream_name(stream: Source) -> str:
    """Return the name of a stream: that of its file, if it has one.

    >>> import io
    >>> stream_name(io.BytesIO(b"Speed"))
    'stream'
    """
    name = getattr(stream, "name", "")
    return Path(name).name or _NAME if isinstance(name, str) else _NAME


@contextmanager
def local_file(source: Source) -> Iterator[str | Path]:
    r"""Yield the path of a file; of a stream, that of a copy of what is left to read, which lasts as long as the block.

    >>> import io
    >>> with local_file(io.StringIO("Speed\n1000\n")) as path:
    ...     Path(path).read_text(encoding="utf-8").split()
    ['Speed', '1000']
    """
    if isinstance(source, str | Path):
        yield source
        return
    content = source.read()
    with TemporaryDirectory(prefix="kennfeld-", ignore_cleanup_errors=True) as folder:
        path = Path(folder, stream_name(source))
        path.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        yield path
