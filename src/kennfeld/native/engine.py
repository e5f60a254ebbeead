"""LLVM IR text to callable machine code, compiled in memory."""

import ctypes
import sys
import threading
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import llvmlite.binding as llvm

__all__ = ["C_FUNCTIONS", "Engine"]

C_FUNCTIONS = {
    "exp": 1, "log": 1, "log10": 1, "sin": 1, "cos": 1, "tan": 1, "asin": 1, "acos": 1, "atan": 1, "atan2": 2,
    "sinh": 1, "cosh": 1, "tanh": 1, "pow": 2, "erfc": 1,
}  # fmt: skip

LONG = 200_000  # characters of IR from which compiling well takes longer than it gains

_compiling = threading.Lock()


class Engine:
    """Machine code of one module; it lives as long as this object and the functions it handed out."""

    def __init__(self, text: str) -> None:
        with _compiling:
            long = len(text) > LONG
            self._machine = _target_machine(effort=0 if long else 2)
            module = llvm.parse_assembly(_DECLARATIONS + text)
            module.triple = self._machine.triple
            module.data_layout = str(self._machine.target_data)
            (_tidy if long else _optimise)(module, self._machine)
            self._engine = llvm.create_mcjit_compiler(module, self._machine)
            self._engine.finalize_object()

    def function(self, name: str, parameters: Sequence[tuple[str, str]]) -> Callable[..., None]:
        """The compiled function with these (type, name) parameters; arrays are passed by their address."""
        address = self._engine.get_function_address(name)
        made: Any = ctypes.CFUNCTYPE(None, *(_KINDS[kind.split()[0]] for kind, _ in parameters))(address)
        made.engine = self
        called: Callable[..., None] = made
        return called


_KINDS = {"ptr": ctypes.c_void_p, "i64": ctypes.c_int64}


@cache
def _initialise() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    library = _c_library()
    for name in (*C_FUNCTIONS, "memset", "memcpy", "memmove"):
        address = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
        llvm.add_symbol("kf_" + name if name in C_FUNCTIONS else name, address)


def _c_library() -> ctypes.CDLL:
    """The C library with the elementary functions, by each system's own name."""
    return ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)


def _target_machine(effort: int) -> Any:
    _initialise()
    target = llvm.Target.from_default_triple()
    # Code model "jitdefault" reaches the C library wherever the system has put it.
    return target.create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=effort,
        codemodel="jitdefault",
    )


def _tidy(module: Any, machine: Any) -> None:
    """The few passes that pay on long straight-line code, which then runs within a tenth of its best speed."""
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=0))
    passes = llvm.create_new_module_pass_manager()
    passes.add_always_inliner_pass()
    passes.add_sroa_pass()
    passes.run(module, builder)


def _optimise(module: Any, machine: Any) -> None:
    # The SLP vectorizer takes minutes on long straight-line code and gains nothing there.
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    options.slp_vectorization = False
    options.loop_vectorization = True
    # Interleaving and unrolling double the time to compile; the loops are bound by memory.
    options.loop_interleaving = False
    options.loop_unrolling = False
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)


def _declare(name: str, arguments: int) -> str:
    return f"declare double @kf_{name}({', '.join(['double'] * arguments)}) nounwind memory(none)\n"


_INTRINSICS = """
declare double @llvm.fabs.f64(double)
declare double @llvm.sqrt.f64(double)
declare double @llvm.copysign.f64(double, double)
declare double @llvm.floor.f64(double)
declare double @llvm.ceil.f64(double)
declare double @llvm.trunc.f64(double)
declare i64 @llvm.fptosi.sat.i64.f64(double)
declare i64 @llvm.smin.i64(i64, i64)
declare i64 @llvm.smax.i64(i64, i64)
declare double @llvm.maxnum.f64(double, double)
declare <8 x double> @llvm.fabs.v8f64(<8 x double>)
declare double @llvm.vector.reduce.fadd.v8f64(double, <8 x double>)
declare void @llvm.prefetch.p0(ptr, i32, i32, i32)
"""
_DECLARATIONS = _INTRINSICS + "".join(_declare(name, count) for name, count in C_FUNCTIONS.items())
