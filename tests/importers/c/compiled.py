"""A function of C as the compiler of this machine makes it."""

import ctypes
import shutil
import subprocess

import pytest

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
OPTIONS = ("-O1", "-fwrapv", "-ffp-contract=off", "-w", "-shared", "-fPIC", "-D_GNU_SOURCE")

needs_compiler = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")


def compiled_step(source, result, *arguments):
    """Compile a file; return its function `step` with these types of its result and arguments."""
    library = source.with_suffix(".so")
    subprocess.run([COMPILER, *OPTIONS, "-o", str(library), str(source), "-lm"], check=True)
    step = ctypes.CDLL(str(library)).step
    step.restype, step.argtypes = result, arguments
    return step
