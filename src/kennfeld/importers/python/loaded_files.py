"""The files that a Python file loads from its folder, found without running it: modules that it imports, and data.

Modules are followed through their `import` statements. Data are the files whose names are texts of these modules, such
as `"table.csv"`, and those that a pattern or an extension of such a text matches, such as `"*.pkl"` or `f"{name}.pkl"`.
What code finds under other names, or outside of its folder, cannot be known beforehand.
"""

import ast
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path
from typing import Final

from kennfeld.base.lazy_dataclass import dataclass

_MAX_NAME: Final = 200  # characters of a text that may be the name of a file
_MAX_FILES: Final = 500  # that one pattern matches
_PATTERN: Final = re.compile(r"\*?\.[A-Za-z]\w{0,9}|[^\n]*[*?][^\n]*")
_DIGEST_SIZE: Final = 32  # bytes


@dataclass(frozen=True)
class SiblingModule:
    """A module beside a Python file: its name for `import`, its file and content, and if it is a package."""

    name: str
    path: Path
    content: bytes
    is_package: bool


@dataclass(frozen=True)
class LoadedFiles:
    """A Python file with what it loads from its folder.

    Attributes:
        path: the file.
        content: its content.
        modules: the modules that it imports, by name.
        data: the files that it may read.
    """

    path: Path
    content: bytes
    modules: dict[str, SiblingModule]
    data: tuple[Path, ...]

    @property
    def others(self) -> tuple[Path, ...]:
        """The modules and the data, without the file itself."""
        return tuple(sorted({*self._modules, *self.data}))

    @property
    def digest(self) -> str:
        """The digest of all contents; that of the content of the file if it loads no other."""
        data = {path: _digest_of_file(path) for path in self.data}
        return self._joined(self._modules | data)

    @property
    def source_digest(self) -> str:
        """The digest of the code alone, which stays while the code writes files."""
        return self._joined(self._modules)

    @property
    def _modules(self) -> dict[Path, str]:
        """The digests of the modules."""
        modules = {module.path: _digest(module.content) for module in self.modules.values()}
        return {path: digest for path, digest in modules.items() if path != self.path}

    def _joined(self, others: dict[Path, str]) -> str:
        own = _digest(self.content)
        if not others:
            return own
        folder = self.path.parent
        rows = [f"{digest} {path.relative_to(folder).as_posix()}" for path, digest in sorted(others.items())]
        return _digest("\n".join([own, *rows]).encode("utf-8", "surrogateescape"))


def _digest(content: bytes) -> str:
    return blake2b(content, digest_size=_DIGEST_SIZE).hexdigest()


def _digest_of_file(path: Path) -> str:
    digest = blake2b(digest_size=_DIGEST_SIZE)
    with suppress(OSError), path.open("rb") as file:
        while chunk := file.read(1 << 20):
            digest.update(chunk)
    return digest.hexdigest()


def find_loaded_files(path: Path) -> LoadedFiles:
    """Find what a Python file loads from its folder. Raises `OSError` if the file itself cannot be read."""
    path = path.resolve()
    content, folder = path.read_bytes(), path.parent
    modules: dict[str, SiblingModule] = {}
    data: set[Path] = set()
    waiting = [("", path, content)]
    while waiting:
        package, file, text = waiting.pop()
        tree = _parsed(text)
        data.update(named for place in {folder, file.parent} for named in _named_files(tree, place))
        for name in _imported(tree, package):
            for module in _modules(folder, name):
                if module.name not in modules:
                    modules[module.name] = module
                    # relative imports count from the package itself, or from that of the module
                    inner = module.name if module.is_package else module.name.rpartition(".")[0]
                    waiting.append((inner, module.path, module.content))
    sources = {module.path for module in modules.values()}
    return LoadedFiles(path, content, modules, tuple(sorted(data - sources - {path})))


def files_loaded_by(path: Path) -> tuple[Path, ...]:
    """Return the files that a Python file loads, without itself. Raises `OSError`."""
    return find_loaded_files(path).others


def digest_of_loaded(path: Path) -> str:
    """Return the digest of a Python file with all that it loads. Raises `OSError`."""
    return find_loaded_files(path).digest


def _parsed(content: bytes) -> ast.Module:
    try:
        return ast.parse(content)
    except (SyntaxError, RecursionError, MemoryError, ValueError):
        return ast.Module([], [])  # it cannot be imported either


def _imported(tree: ast.Module, package: str) -> Iterator[str]:
    """Yield the names of modules that a module of a package may import, as seen from the folder of the file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            # one dot is the package itself, each further one the package around
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*filter(None, above), *([node.module] if node.module else [])])
            if base:
                yield base
            # `from a import b`: b may be a module of a, or a name in it
            yield from (f"{base}.{alias.name}".lstrip(".") for alias in node.names)


def _modules(folder: Path, name: str) -> Iterator[SiblingModule]:
    """Yield the packages that lead to a module of the folder, and the module, as far as they exist."""
    parts = name.split(".")
    if parts[0] in sys.stdlib_module_names or not all(part.isidentifier() for part in parts):
        return
    for count in range(1, len(parts) + 1):
        place = folder.joinpath(*parts[:count])
        for path, is_package in ((place / "__init__.py", True), (place.with_name(f"{place.name}.py"), False)):
            with suppress(OSError):
                if path.is_file():
                    yield SiblingModule(".".join(parts[:count]), path, path.read_bytes(), is_package)
                    break
        else:
            if not place.is_dir():
                return
            # a folder without __init__.py is a namespace package
            yield SiblingModule(".".join(parts[:count]), place / "__init__.py", b"", True)


def _named_files(tree: ast.Module, folder: Path) -> Iterator[Path]:
    """Yield the files of a folder that texts of a module name."""
    texts = (node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str))
    for text in dict.fromkeys(texts):
        if not text or len(text) > _MAX_NAME or "\0" in text:
            continue
        with suppress(OSError, ValueError, NotImplementedError):  # not a path, or not a pattern
            if _PATTERN.fullmatch(text):
                pattern = text if text.startswith("*") or not text.startswith(".") else f"*{text}"
                yield from _inside(sorted(folder.glob(pattern))[:_MAX_FILES], folder)
            else:
                yield from _inside([folder / text], folder)


def _inside(paths: list[Path], folder: Path) -> Iterator[Path]:
    root = folder.resolve()
    for path in paths:
        whole = path.resolve()
        if whole.is_file() and whole.is_relative_to(root) and whole.stat().st_size:  # an empty one holds no data
            yield whole
