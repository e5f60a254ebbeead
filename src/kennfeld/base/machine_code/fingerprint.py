"""Text that stands for a call of a function which writes code: for its source and its arguments."""

import copyreg
import io
import pickle
from collections.abc import Callable, Sequence
from functools import cache
from hashlib import blake2b
from pathlib import Path
from types import MappingProxyType
from typing import Any

from kennfeld.base.frozen_dict import FrozenDict

WRITERS = ("base/machine_code", "graph", "native")  # packages whose functions write code
OTHERS = ("domain/rbf.py",)  # modules from which they have constants


def fingerprint(write: Callable[..., Any], arguments: Sequence[Any]) -> str | None:
    """Return a text that differs if a function, or anything in its arguments, differs.

    Args:
        write: a function of `WRITERS`, which depends on its arguments and on the sources of `WRITERS` and `OTHERS`.
        arguments: tuples, mappings, arrays, numbers, texts, and classes of these.

    Returns:
        The text; None for a function of another package, or if the sources are not installed.
    """
    source = _source_hash()
    packages = tuple(f"kennfeld.{name.replace('/', '.')}." for name in WRITERS)
    if not source or not write.__module__.startswith(packages):
        return None
    content = io.BytesIO()
    _ArgumentPickler(content, protocol=5).dump(arguments)
    return " ".join((source, write.__module__, write.__qualname__, _hash(content.getvalue())))


def fingerprint_of_text(text: str) -> str | None:
    """Return a text that differs if some IR, or the code that compiles it, differs; None without the sources."""
    source = _source_hash()
    return f"{source} text {_hash(text.encode())}" if source else None


class _ArgumentPickler(pickle.Pickler):
    """Stores numbers and arrays bit for bit, and read-only mappings as dictionaries."""

    dispatch_table = copyreg.dispatch_table | dict.fromkeys(
        (FrozenDict, MappingProxyType), lambda mapping: (dict, (dict(mapping),))
    )


@cache
def _source_hash() -> str:
    """Return a hash of the sources; empty if a package is installed without."""
    root = Path(__file__).parents[2]
    # sorted, as a file system may list them in any order
    packages = [sorted((root / name).rglob("*.py")) for name in WRITERS]
    files = [*(file for package in packages for file in package), *(root / name for name in OTHERS)]
    if not all(packages) or not all(file.is_file() for file in files):
        return ""
    names = (file.relative_to(root).as_posix().encode() for file in files)
    return _hash(b"\0".join(name + b"\0" + file.read_bytes() for name, file in zip(names, files, strict=True)))


def _hash(content: bytes) -> str:
    return blake2b(content, digest_size=32).hexdigest()
