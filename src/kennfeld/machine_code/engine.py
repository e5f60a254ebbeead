"""Compilation of LLVM IR to callable machine code in memory."""

import ctypes
import sys
import threading
from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any

import llvmlite.binding as llvm

from kennfeld.machine_code.ir import FunctionWriter

NativeFunction = Callable[..., None]
LONG = 200_000  # characters of IR from which compiling well takes longer than it gains

_compiling = threading.Lock()

_KINDS = {"ptr": ctypes.c_void_p, "i64": ctypes.c_int64}

_DECLARATIONS = """
declare double @llvm.fabs.f64(double)
declare double @llvm.sqrt.f64(double)
declare double @llvm.copysign.f64(double, double)
declare double @llvm.floor.f64(double)
declare double @llvm.ceil.f64(double)
declare double @llvm.trunc.f64(double)
declare i64 @llvm.smin.i64(i64, i64)
declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)
declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)
declare i64 @llvm.smax.i64(i64, i64)
declare i8 @llvm.ctpop.i8(i8)
declare double @llvm.maxnum.f64(double, double)
declare <8 x double> @llvm.maxnum.v8f64(<8 x double>, <8 x double>)
declare <8 x double> @llvm.minnum.v8f64(<8 x double>, <8 x double>)
declare <8 x double> @llvm.masked.load.v8f64.p0(ptr, i32, <8 x i1>, <8 x double>)
declare void @llvm.masked.store.v8f64.p0(<8 x double>, ptr, i32, <8 x i1>)
declare <8 x double> @llvm.fabs.v8f64(<8 x double>)
declare double @llvm.vector.reduce.fadd.v8f64(double, <8 x double>)
declare void @llvm.prefetch.p0(ptr, i32, i32, i32)
"""


class Engine:
    """Machine code of one module, kept alive by this object and the functions it returned.

    `loops` enables optimisation of loops over doubles; the code of a model runs as fast without.
    """

    def __init__(self, text: str, *, loops: bool = False) -> None:
        with _compiling:
            long = len(text) > LONG
            self._machine = _target().create_target_machine(
                cpu=llvm.get_host_cpu_name(),
                features=llvm.get_host_cpu_features().flatten(),
                opt=0 if long else 2,
                codemodel="jitdefault",  # reaches the C library at any address
            )
            module = llvm.parse_assembly(_DECLARATIONS + text)
            module.triple = self._machine.triple
            module.data_layout = str(self._machine.target_data)
            (_optimise if loops and not long else _tidy)(module, self._machine)
            self._engine = llvm.create_mcjit_compiler(module, self._machine)
            self._engine.finalize_object()

    def address(self, name: str) -> int:
        """Return the address of a compiled function."""
        return int(self._engine.get_function_address(name))

    def function(self, name: str, parameters: Sequence[tuple[str, str]]) -> NativeFunction:
        """Return the compiled function with these (type, name) parameters; arrays are passed by address."""
        result: Any = ctypes.CFUNCTYPE(None, *(_KINDS[kind.split()[0]] for kind, _ in parameters))(self.address(name))
        result.engine = self
        native: NativeFunction = result
        return native


def compile_functions(*functions: FunctionWriter, loops: bool = False) -> dict[str, NativeFunction]:
    """Compile functions as one module, and return them by name; see `Engine`."""
    engine = Engine("".join(f.text() for f in functions), loops=loops)
    return {f.name: engine.function(f.name, f.parameters) for f in functions}


class SharedFunction:
    """A model-independent function called by generated code, compiled once, when first needed."""

    def __init__(self, write: Callable[[], FunctionWriter]) -> None:
        self._write = write
        self._compiled: tuple[Engine, str] | None = None
        self._lock = threading.Lock()  # two threads might compile, and the engine of one be gone when it is called

    def __str__(self) -> str:
        with self._lock:
            if self._compiled is None:
                f = self._write()
                engine = Engine(f.text())
                self._compiled = engine, f"inttoptr (i64 {engine.address(f.name)} to ptr)"
            return self._compiled[1]


@cache
def shared_function(write: Callable[..., FunctionWriter], *arguments: object) -> SharedFunction:
    """Return the function that `write(*arguments)` writes, the same for equal arguments."""
    return SharedFunction(partial(write, *arguments))


@cache
def c_function(name: str) -> int:
    """Return the address of a function of the C library."""
    library = ctypes.CDLL("ucrtbase" if sys.platform == "win32" else None)
    address = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
    assert address is not None
    return address


@cache
def _target() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    for name in ("memset", "memcpy", "memmove"):  # LLVM itself writes calls of these
        llvm.add_symbol(name, c_function(name))
    return llvm.Target.from_default_triple()


def _tidy(module: Any, machine: Any) -> None:
    """Run the few passes that pay off on long straight-line code; it then runs within 10 % of its best speed."""
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
