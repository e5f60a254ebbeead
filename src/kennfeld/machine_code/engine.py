"""Compilation of LLVM IR to callable machine code in memory.

The code contains no address, so that it can be kept on disk: what lies outside of a module is called through a pointer
in its data, which is set when the code is loaded.
"""

import ctypes
import re
import threading
import time
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import llvmlite
import llvmlite.binding as llvm

from kennfeld.machine_code.code_cache import keep_code, key_of, read_code
from kennfeld.machine_code.external import address_of, c_function, external
from kennfeld.machine_code.ir import FunctionWriter

NativeFunction = Callable[..., None]
LONG = 200_000  # characters of IR from which compiling well takes longer than it gains
_PASSES = "1"  # changes with the passes below, so that code of earlier ones is not used
_WORTH = 0.004  # s of compiling from which code is kept

_compiling = threading.Lock()

_POINTER = re.compile(r"@(kf\.[\w.]+)")
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
        pointers = sorted(set(_POINTER.findall(text)))
        text += "".join(f"@{name} = externally_initialized global ptr null\n" for name in pointers)
        addresses = {name: address_of(name) for name in pointers}
        with _compiling:
            self._engine = _load(_object_code(text, loops))
        for name, address in addresses.items():
            ctypes.c_void_p.from_address(self._engine.get_global_value_address(name)).value = address

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

    def __init__(self, write: Callable[..., FunctionWriter], *arguments: object) -> None:
        self._write, self._arguments = write, arguments
        self._name = ".".join(("shared", write.__module__, write.__name__, *map(str, arguments)))
        self._engine: Engine | None = None
        self._address = 0
        self._lock = threading.Lock()  # two threads might compile, and the engine of one be gone when it is called

    def pointer(self, f: FunctionWriter) -> str:
        """Return a register of a function under construction that holds the address."""
        return external(f, self._name, self._compiled)

    def _compiled(self) -> int:
        with self._lock:
            if self._engine is None:
                f = self._write(*self._arguments)
                self._engine = Engine(f.text())
                self._address = self._engine.address(f.name)
            return self._address


@cache
def shared_function(write: Callable[..., FunctionWriter], *arguments: object) -> SharedFunction:
    """Return the function that `write(*arguments)` writes, the same for equal arguments."""
    return SharedFunction(write, *arguments)


def _load(code: bytes) -> Any:
    """Return an LLVM engine that holds the machine code of an object file."""
    module = llvm.parse_assembly("")
    engine = llvm.create_mcjit_compiler(module, _target().create_target_machine(codemodel="jitdefault"))
    engine.remove_module(module)  # which it would compile, empty as it is, in ten times the time that loading takes
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


def _object_code(text: str, loops: bool) -> bytes:
    """Return the machine code of IR, compiled now or before."""
    loops = loops and len(text) <= LONG
    target = f"{_target().triple} {llvm.get_host_cpu_name()} {_features()}"
    key = key_of(_PASSES, llvmlite.__version__, target, str(loops), _DECLARATIONS, text)
    code = read_code(key)
    if code is None:
        began = time.perf_counter()
        code = _compile(text, loops)
        if time.perf_counter() - began > _WORTH:
            keep_code(key, code)
    return code


def _compile(text: str, loops: bool) -> bytes:
    machine = _machine(0 if len(text) > LONG else 2)
    module = llvm.parse_assembly(_DECLARATIONS + text)
    module.triple = machine.triple
    module.data_layout = str(machine.target_data)
    (_optimise if loops else _tidy)(module, machine)
    return bytes(machine.emit_object(module))


def _machine(opt: int) -> Any:
    return _target().create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=_features(), opt=opt, codemodel="jitdefault"
    )


@cache
def _features() -> str:
    features: str = llvm.get_host_cpu_features().flatten()
    return features


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
