"""Runs a Python file so that it can import the modules beside it, as a script can, without others seeing these.

The modules are submodules of one that is named after the digest of all their contents. Two projects may thus have
different modules of the same name, a changed file is another module, and a module beside the file hides none of the
libraries that Kennfeld uses. Only contents that were read for the digest are run.

What they print goes to the standard error stream, as the standard output is that of commands, and each `print` of the
code prints once: a function is called for thousands of samples, many times.
"""

import builtins
import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType
from typing import Any

from kennfeld.importers.python.loaded_files import LoadedFiles

_PREFIX = "kennfeld_function_"
_PRINTED: set[tuple[str, str, int]] = set()  # places of code that have printed: the module, the file and the line


def run_module(files: LoadedFiles, digest: str) -> ModuleType:
    """Run a file and return it as a module, named after a digest. Whatever its code raises passes through."""
    _FINDER.install()
    name = f"{_PREFIX}{digest[:32]}"
    _FINDER.files[name] = files
    spec = spec_from_loader(name, _ContentLoader(name, files.path, files.content), is_package=True)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class _SiblingFinder(MetaPathFinder):
    """Finds the modules beside the files that were run."""

    def __init__(self) -> None:
        self.files: dict[str, LoadedFiles] = {}  # by the name of the module of each file

    def install(self) -> None:
        if self not in sys.meta_path:
            sys.meta_path.append(self)

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return a module by its whole name; None if it is not beside a file."""
        owner, _, name = fullname.partition(".")
        files = self.files.get(owner)
        module = None if files is None else files.modules.get(name)
        if module is None:
            return None
        loader = _ContentLoader(owner, module.path, module.content)
        return spec_from_loader(fullname, loader, is_package=module.is_package)


_FINDER = _SiblingFinder()


class _ContentLoader(Loader):
    """Runs a content in a module whose imports find the modules beside the file of its owner."""

    def __init__(self, owner: str, path: Path, content: bytes) -> None:
        self._owner, self._path, self._content = owner, path, content

    def is_package(self, fullname: str) -> bool:
        """Return False: the specification says it."""
        return False

    def exec_module(self, module: ModuleType) -> None:
        """Run the content."""
        module.__file__ = str(self._path)
        own = {"__import__": self._import, "print": self._print}
        module.__dict__["__builtins__"] = {**vars(builtins), **own}
        exec(compile(self._content, str(self._path), "exec", dont_inherit=True), module.__dict__)

    def _print(
        self, *values: Any, sep: str | None = None, end: str | None = None, file: Any = None, **more: Any
    ) -> None:
        """Print the first text of each place of the code; the signature is that of `print`."""
        if file is not None and file is not sys.stdout:
            print(*values, sep=sep, end=end, file=file, **more)
            return
        caller = sys._getframe(1)
        place = (self._owner, caller.f_code.co_filename, caller.f_lineno)
        if place not in _PRINTED:
            _PRINTED.add(place)
            print(*values, sep=sep, end=end, file=sys.stderr, **more)

    def _import(
        self,
        name: str,
        namespace: Mapping[str, Any] | None = None,
        variables: Mapping[str, Any] | None = None,
        names: Sequence[str] | None = (),
        level: int = 0,
    ) -> ModuleType:
        """Import a module beside the file, else any other; the signature is that of `__import__`."""
        first = name.partition(".")[0]
        if level or first not in _FINDER.files[self._owner].modules:
            return builtins.__import__(name, namespace, variables, names or (), level)
        if names:
            return builtins.__import__(f"{self._owner}.{name}", namespace, variables, names, 0)
        # `import a.b` binds a
        import_module(f"{self._owner}.{name}")
        return sys.modules[f"{self._owner}.{first}"]
