"""The C compiler of this machine, if there is one: it makes the binary of an FMU, and checks exported code."""

import ctypes
import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.base.arrays import ArrayLike, Float
from kennfeld.base.errors import KennfeldError
from kennfeld.base.fmi_platform import LIBRARY_SUFFIX
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.export.c_code import write_c
from kennfeld.export.prepared import Precision, PreparedFunction

CANDIDATES = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
TIMEOUT = 600  # s


class CompilationError(KennfeldError):
    """The compiler of this machine does not accept exported code; the text begins with its first message."""


@dataclass(frozen=True)
class HostCompiler:
    """A compiler that takes options like GCC and Clang."""

    command: tuple[str, ...]

    @classmethod
    def find(cls) -> "HostCompiler | None":
        """Return the compiler that the variable CC names, or the first one on the path; None if there is none."""
        named = shlex.split(os.environ.get("CC", ""))
        if named and shutil.which(named[0]):
            return cls(tuple(named))
        return next((cls((path,)) for name in CANDIDATES if (path := shutil.which(name))), None)

    @property
    def timeout(self) -> float:
        """The longest time that it may take, in s."""
        return TIMEOUT

    @property
    def name(self) -> str:
        """Name for messages."""
        return Path(self.command[0]).name

    def shared_library(self, sources: Sequence[Path], target: Path, flags: Sequence[str] = ()) -> None:
        """Compile sources to a shared library.

        Raises:
            CompilationError: the compiler fails.
        """
        self.run([*FLAGS, *flags, "-fPIC", "-shared", "-o", str(target), *map(str, sources), "-lm"], target.parent)

    def run(self, arguments: Sequence[str], folder: Path) -> None:
        """Run the compiler in a folder.

        Raises:
            CompilationError: it fails.
        """
        command = [*self.command, *arguments]
        try:
            run = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, errors="replace", timeout=self.timeout, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise CompilationError(f"{self.name} cannot be run: {error}") from None
        if run.returncode:
            lines = [line for line in run.stderr.splitlines() if "error" in line] or run.stderr.splitlines()
            raise CompilationError(f"{self.name} fails: {lines[0] if lines else f'status {run.returncode}'}")


class CompiledFunction:
    """Exported C code in the memory of this process.

    Raises:
        CompilationError: the compiler fails.
    """

    def __init__(
        self, function: PreparedFunction, precision: Precision, compiler: HostCompiler, flags: Sequence[str] = ()
    ) -> None:
        self._function = function
        with tempfile.TemporaryDirectory(prefix="kennfeld-", ignore_cleanup_errors=True) as name:
            folder = Path(name)
            for file, text in write_c(function, precision).items():
                (folder / file).write_text(text, encoding="utf-8")
            driver, library = folder / "driver.c", folder / f"driver{LIBRARY_SUFFIX}"
            driver.write_text(_driver(function, precision), encoding="utf-8")
            compiler.shared_library([driver, folder / f"{function.name}.c"], library, flags)
            # the library stays loaded when its file has gone
            self._library = ctypes.CDLL(str(library))

    @cached_property
    def _run(self) -> Any:
        run = self._library.kennfeld_run
        run.argtypes, run.restype = [ctypes.c_int64, *[ctypes.c_void_p] * 3], None
        return run

    def over(self, columns: Mapping[str, ArrayLike], count: int, starts: Sequence[int] = (0,)) -> Float:
        """Compute the outputs over samples, Float[outputs, samples].

        Args:
            columns: the inputs by name, Float[samples].
            count: number of samples.
            starts: samples at which the memory starts anew.
        """
        inputs = self._function.inputs
        table = np.empty((count, len(inputs)))
        for at, signal in enumerate(inputs):
            table[:, at] = columns[signal.name]
        fresh = np.zeros(count, dtype=np.uint8)
        fresh[[start for start in starts if start < count]] = 1
        out = np.empty((count, len(self._function.outputs)))
        self._run(count, table.ctypes.data, fresh.ctypes.data, out.ctypes.data)
        return np.ascontiguousarray(out.T)


def _driver(function: PreparedFunction, precision: Precision) -> str:
    name = function.name
    reads = [f"        u.{u.member} = ({precision})in[{at}];" for at, u in enumerate(function.inputs)]
    writes = [f"        out[{at}] = (double)y.{y.member};" for at, y in enumerate(function.outputs)]
    lines = [
        "#include <string.h>",
        f'#include "{name}.h"',
        "#ifdef _WIN32",
        "__declspec(dllexport)",
        "#endif",
        "void kennfeld_run(int64_t count, const double *in, const uint8_t *fresh, double *out)",
        "{",
        f"    {name}_states s;",
        f"    {name}_inputs u;",
        f"    {name}_outputs y;",
        "    int64_t k;",
        f"    {name}_init(&s);",
        "    (void)memset(&u, 0, sizeof(u));",
        "    for (k = 0; k < count; k++) {",
        "        if (fresh[k] != 0) {",
        f"            {name}_init(&s);",
        "        }",
        *reads,
        f"        {name}_step(&{name}_defaults, &s, &u, &y);",
        *writes,
        f"        in = &in[{len(function.inputs)}];",
        f"        out = &out[{len(function.outputs)}];",
        "    }",
        "}",
    ]
    return "\n".join(lines) + "\n"
