"""Libraries of FMUs for other machines, by the C compiler of the package `ziglang`."""

import sys
from importlib.util import find_spec
from typing import Literal, get_args

from kennfeld.base.errors import ArgumentError
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.export.host_compiler import HostCompiler

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

    @property
    def timeout(self) -> float:
        """The longest time that it may take, in s: at first, it compiles the C library of the machine, too."""
        return TIMEOUT

    @property
    def name(self) -> str:
        """Name for messages."""
        return f"zig cc for {self.command[-1]}"
