"""The digest of all code that computes what is remembered: another version of it remembers nothing of this one."""

import platform
from functools import cache
from hashlib import blake2b
from importlib.util import find_spec
from pathlib import Path

# packages whose versions decide how data are read or computed
LIBRARIES = (
    "asammdf", "can", "canmatrix", "cantools", "fmpy", "h5py", "nptdms", "numpy", "openpyxl", "pint", "pyarrow",
    "python_calamine", "scipy",
)  # fmt: skip


@cache
def code_digest() -> str:
    """Return the digest of the sources of this package, and of the versions of Python and the libraries that it uses.

    It takes all sources, not those that a result seems to depend on: what is left out is what is missed.
    """
    digest = blake2b(digest_size=20)
    root = Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode())
        digest.update(path.read_bytes())
    digest.update(f"{platform.python_implementation()} {platform.python_version()}\0".encode())
    for library in LIBRARIES:
        digest.update(f"{library} {_version(library)}\0".encode())
    return digest.hexdigest()


def _version(library: str) -> str:
    """Return what tells versions of a library apart, without importing it; nothing if it is not installed."""
    try:
        spec = find_spec(library)
        if spec is None or not spec.origin:
            return ""
        folder = Path(spec.origin).parent
        versions = sorted(path.name for path in folder.parent.glob(f"{library}-*.dist-info"))
        stat = Path(spec.origin).stat()
        return f"{versions} {stat.st_size} {stat.st_mtime_ns}"
    except (ImportError, ValueError, OSError):
        return ""
