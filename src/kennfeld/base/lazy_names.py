"""Names of a package that are loaded when they are first used, so that its face costs nothing."""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(package: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """Return the `__getattr__` of a package whose names are defined in its modules.

    Args:
        package: the name of the package.
        names: by module of the package, the names that it defines, separated by blanks. A name must differ from those
            of all modules of the package, by which Python would replace it.

    >>> get = lazy_names("kennfeld.graph", {"node": "Graph Node"})
    >>> get("Node").__module__
    'kennfeld.graph.node'
    """
    module_of = {name: module for module, defined in names.items() for name in defined.split()}

    def get(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{module_of[name]}"), name)
        # found without this function from the second time on
        setattr(sys.modules[package], name, value)
        return value

    return get
