"""Compilation of LLVM IR to callable machine code in memory.

The code contains no address, so that it can be kept on disk: what lies outside of a module is called through a pointer
in its data, which is set when the code is loaded.
"""

import ctypes
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import Any

import llvmlite
import llvmlite.binding as llvm

from kennfeld.base.machine_code.code_cache import keep_code, key_of, read_code
from kennfeld.base.machine_code.external import External, address_of, c_function, externals_of, load_pointer
from kennfeld.base.machine_code.fingerprint import fingerprint, fingerprint_of_text
from kennfeld.base.machine_code.ir import FunctionWriter
from kennfeld.base.machine_code.object_module import ObjectModule
from kennfeld.base.threads import computed_once

NativeFunction = Callable[..., None]
Functions = Sequence[FunctionWriter]
LONG = 200_000  # characters of IR from which compiling well takes longer than it gains
BEST = 2  # level at which LLVM selects instructions; 0 takes a fifth of the time, for code that runs longer
LEVEL = BEST  # of code that is written for a model
_WORTH = 0.004  # s of writing and compiling from which code is kept
RECENT = 32  # loaded modules that stay in memory for the next fit of the same model,
SMALL = 100_000  # each of at most so many bytes; loading a larger one is little beside running it

_loading = threading.Lock()  # of LLVM, which compiles and loads

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
    """Machine code of one module, kept alive by this object and the functions it returned."""

    def __init__(self, module: ObjectModule) -> None:
        self._externals = {external: _address_of(external) for external in module.externals}
        with _loading:
            self._engine = _load(module.code)
        for external, address in self._externals.items():
            ctypes.c_void_p.from_address(self._engine.get_global_value_address(external.pointer)).value = address
        self._parameters = module.functions
        self.size = len(module.code)

    @property
    def is_current(self) -> bool:
        """True if what lies outside of the module is still where the code calls it."""
        return all(_address_of(external) == address for external, address in self._externals.items())

    def address(self, name: str) -> int:
        """Return the address of a compiled function."""
        return int(self._engine.get_function_address(name))

    def functions(self) -> dict[str, NativeFunction]:
        """Return the compiled functions by name; arrays are passed by address."""
        return {name: self._function(name, kinds) for name, kinds in self._parameters.items()}

    def _function(self, name: str, kinds: Sequence[str]) -> NativeFunction:
        result: Any = ctypes.CFUNCTYPE(None, *(_KINDS[kind] for kind in kinds))(self.address(name))
        # the code lives as long as its engine
        result.engine = self
        native: NativeFunction = result
        return native


def compile_functions(*functions: FunctionWriter, loops: bool = False) -> dict[str, NativeFunction]:
    """Compile functions as one module, and return them by name.

    Args:
        functions: the functions.
        loops: optimise loops over doubles; the code of a model runs as fast without.
    """
    text = "".join(f.text() for f in functions)
    return Engine(_module(lambda: functions, fingerprint_of_text(text), BEST, loops=loops)).functions()


def compile_written(write: Callable[..., Functions], *arguments: Any) -> Mapping[str, NativeFunction]:
    """Compile the functions that `write(*arguments)` returns as one module, and return them by name.

    Nothing is written if the code of an equal call is kept; see `fingerprint` for what `write` may depend on.
    """
    content = fingerprint(write, arguments)
    key = f"{content} {LEVEL}"
    functions = None if content is None else _recent_functions(key)
    if functions is None:
        engine = Engine(_module(lambda: write(*arguments), content, LEVEL))
        functions = engine.functions()
        if content is not None and engine.size <= SMALL:
            _remember(key, engine, functions)
    return functions


_recent: OrderedDict[str, tuple[Engine, Mapping[str, NativeFunction]]] = OrderedDict()  # the most recently used last
_remembering = threading.Lock()


def _recent_functions(key: str) -> Mapping[str, NativeFunction] | None:
    with _remembering:
        engine, functions = _recent.get(key, (None, {}))
        if engine is None or not engine.is_current:
            return None
        _recent.move_to_end(key)
        return functions


def _remember(key: str, engine: Engine, functions: Mapping[str, NativeFunction]) -> None:
    with _remembering:
        _recent[key] = engine, functions
        while len(_recent) > RECENT:
            _recent.popitem(last=False)


class SharedFunction:
    """A model-independent function called by generated code, compiled once, when first needed."""

    def __init__(self, write: Callable[..., FunctionWriter], *arguments: int) -> None:
        self._write, self._arguments = write, arguments
        self._engine: Engine | None = None
        self._address = 0
        self._lock = threading.Lock()  # two threads might compile, and the engine of one be gone when it is called

    def pointer(self, f: FunctionWriter) -> str:
        """Return a register of a function under construction that holds the address."""
        return load_pointer(f, External(self._write.__module__, self._write.__name__, self._arguments))

    def address(self) -> int:
        """Return the address of the compiled function."""
        with self._lock:
            if self._engine is None:
                written = fingerprint(self._write, self._arguments)
                module = _module(lambda: [self._write(*self._arguments)], written, BEST)
                self._engine = Engine(module)
                (self._address,) = map(self._engine.address, module.functions)
            return self._address


@computed_once
def shared_function(write: Callable[..., FunctionWriter], *arguments: int) -> SharedFunction:
    """Return the function that `write(*arguments)` writes, the same for equal arguments.

    `write` is a function of a module that has no other object of its name.
    """
    return SharedFunction(write, *arguments)


def _address_of(external: External) -> int:
    if not external.module:
        return address_of(external.name)
    return shared_function(getattr(import_module(external.module), external.name), *external.arguments).address()


def _module(write: Callable[[], Functions], content: str | None, level: int, *, loops: bool = False) -> ObjectModule:
    """Return the code of functions, compiled now or before.

    `content` determines what is written, and how it is compiled; without, nothing is kept.
    """
    if content is None:
        return _compile(write(), level, loops)
    # code for another processor may have instructions that this one lacks
    target = f"{_target().triple} {llvm.get_host_cpu_name()} {_features()}"
    key = key_of(llvmlite.__version__, target, str(level), str(loops), content)
    kept = read_code(key)
    if kept is not None:
        return ObjectModule.of_bytes(kept)
    began = time.perf_counter()
    module = _compile(write(), level, loops)
    if time.perf_counter() - began > _WORTH:
        keep_code(key, module.to_bytes())
    return module


def _compile(functions: Functions, level: int, loops: bool) -> ObjectModule:
    text = "".join(f.text() for f in functions)
    externals = externals_of(text)
    # set after loading; the optimiser must not take the pointers for null
    text += "".join(f"@{external.pointer} = externally_initialized global ptr null\n" for external in externals)
    with _loading:
        code = _object_code(text, 0, False) if len(text) > LONG else _object_code(text, level, loops)
    return ObjectModule(code, {f.name: [kind.split()[0] for kind, _ in f.parameters] for f in functions}, externals)


def _load(code: bytes) -> Any:
    """Return an LLVM engine that holds the machine code of an object file."""
    module = llvm.parse_assembly("")
    engine = llvm.create_mcjit_compiler(module, _target().create_target_machine(codemodel="jitdefault"))
    engine.remove_module(module)  # which it would compile, empty as it is, in ten times the time that loading takes
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


def _object_code(text: str, level: int, loops: bool) -> bytes:
    machine = _machine(level)
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
