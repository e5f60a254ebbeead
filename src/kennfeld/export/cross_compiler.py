"""Libraries of FMUs for other machines, by the C compiler of the package `ziglang`."""

import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Literal, get_args

from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.export.host_compiler import FLAGS, HostCompiler

Platform = Literal["x86_64-windows", "x86_64-linux", "aarch64-linux", "x86_64-darwin", "aarch64-darwin"]
PLATFORMS: tuple[Platform, ...] = get_args(Platform)
TIMEOUT = 3600  # s
# an old version of the C library of Linux, so that the library loads on older systems as well
_TARGETS = {
    "x86_64-windows": "x86_64-windows-gnu",
    "x86_64-linux": "x86_64-linux-gnu.2.17",
    "aarch64-linux": "aarch64-linux-gnu.2.17",
    "x86_64-darwin": "x86_64-macos",
    "aarch64-darwin": "aarch64-macos",
}
# Else zig compiles the C library of MinGW first, hundreds of files. Of it, a library of an FMU needs nothing: it takes
# functions from the C library of Windows, and large frames of the stack from the runtime of the compiler. No entry,
# as there is nothing to do when it is loaded.
_FOR_WINDOWS = ("-nolibc", "-nostartfiles", "-Wl,--no-entry", "-rtlib=compiler-rt")
_OF_WINDOWS = tuple(f"-lapi-ms-win-crt-{part}-l1-1-0" for part in ("math", "heap", "string", "private"))


@dataclass(frozen=True)
class CrossCompiler(HostCompiler):
    """A compiler for another machine."""

    @classmethod
    def of(cls, platform: str) -> "CrossCompiler":
        """Return the compiler for a machine, named as in FMI 3.0.

        Raises:
            ArgumentError: ziglang is not installed.
        """
        if find_spec("ziglang") is None:
            message = f"a library for {platform} needs the package ziglang, which is not installed"
            raise ArgumentError(f"{message}. Run: pip install kennfeld[platforms]")
        # stripped, as it would hold the paths of this machine for debuggers, of a folder with another name every time
        return cls((sys.executable, "-m", "ziglang", "cc", "-s", "-target", _TARGETS[platform]))

    def shared_library(self, sources: Sequence[Path], target: Path, flags: Sequence[str] = ()) -> None:
        """Compile sources to a shared library.

        Raises:
            CompilationError: the compiler fails.
        """
        if "-windows-" not in self.command[-1]:
            super().shared_library(sources, target, flags)
            return
        # in two steps, as without a C library there are no headers of it either
        objects = [f"{source.stem}.o" for source in sources]
        for source, compiled in zip(sources, objects, strict=True):
            self.run([*FLAGS, *flags, "-c", "-o", compiled, str(source)], target.parent)
        self.run(["-shared", *_FOR_WINDOWS, "-o", target.name, *objects, *_OF_WINDOWS], target.parent)

    @property
    def timeout(self) -> float:
        """The longest time that it may take, in s: at first, it compiles the C library of the machine, too."""
        return TIMEOUT

    @property
    def name(self) -> str:
        """Name for messages."""
        return f"zig cc for {self.command[-1]}"
