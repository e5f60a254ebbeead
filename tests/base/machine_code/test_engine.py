import gc
from collections import OrderedDict
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from kennfeld.base.machine_code import engine
from kennfeld.base.machine_code.engine import compile_functions
from kennfeld.base.machine_code.ir import FunctionWriter, literal
from tests.native.models import MODELS, case
from tests.native.reference import compiled


def adder(value):
    f = FunctionWriter("put", [("ptr", "x"), ("i64", "count")])
    with f.loop(0, "%count") as i:
        f.increase(literal(value), "%x", i)
    return f


def test_a_function_is_called_with_addresses_and_numbers():
    f = adder(2.5)
    x = np.arange(4.0)
    compile_functions(f)["put"](x.ctypes.data, 3)
    assert x.tolist() == [2.5, 3.5, 4.5, 3.0]


@pytest.mark.slow
def test_a_function_outlives_the_name_of_its_engine():
    call = compile_functions(adder(1.0))["put"]
    gc.collect()
    x = np.zeros(2)
    call(x.ctypes.data, 2)
    assert x.tolist() == [1.0, 1.0]


def test_engines_with_equal_names_do_not_meet():
    one, two = (compile_functions(adder(v))["put"] for v in (1.0, 10.0))
    x = np.zeros(1)
    one(x.ctypes.data, 1)
    two(x.ctypes.data, 1)
    assert x.tolist() == [11.0]


def test_code_that_was_loaded_before_is_loaded_again_only_if_it_is_large_old_or_what_it_calls_has_moved(monkeypatch):
    loads = []
    load = engine._load
    monkeypatch.setattr(engine, "_recent", OrderedDict())
    monkeypatch.setattr(engine, "_load", lambda code: loads.append(code) or load(code))

    def put(number):
        x = np.zeros(1)
        engine.compile_written(named_adder, number)["put"](x.ctypes.data, 1)
        return float(x[0])

    assert [put(3), put(3), put(4), put(3)] == [3.0, 3.0, 4.0, 3.0]
    assert len(loads) == 2
    monkeypatch.setattr(engine, "RECENT", 1)
    assert [put(5), put(3)] == [5.0, 3.0]
    assert len(loads) == 4
    monkeypatch.setattr(engine.Engine, "is_current", False)
    assert put(3) == 3.0
    assert len(loads) == 5
    monkeypatch.undo()
    monkeypatch.setattr(engine, "_recent", OrderedDict())
    monkeypatch.setattr(engine, "SMALL", 10)
    assert put(3) == 3.0
    assert not engine._recent


def named_adder(value):
    return [adder(value)]


named_adder.__module__ = "kennfeld.native.a_writer"


def test_wrong_code_is_refused():
    f = adder(1.0)
    f.do("add")
    with pytest.raises(RuntimeError, match="LLVM IR parsing error"):
        compile_functions(f)


def test_engines_compile_under_threads_at_once():
    def work(value):
        x = np.zeros(100)
        compile_functions(adder(value))["put"](x.ctypes.data, 100)
        return x

    with ThreadPoolExecutor(8) as pool:
        for value, x in zip(range(24), pool.map(work, map(float, range(24))), strict=True):
            assert (x == value).all()


def test_kernels_compile_and_run_under_threads_at_once():
    models = [MODELS[name] for name in ("coupled2", "external", "layers")] * 3

    def work(model):
        code = compiled(case(model(), 60, (0, 20)))
        return code.accumulator().normal(code.values).matrix.copy()

    expected = [work(model) for model in models[:3]] * 3
    with ThreadPoolExecutor(8) as pool:
        for got, alone in zip(pool.map(work, models), expected, strict=True):
            np.testing.assert_array_equal(got, alone)


def test_one_kernel_serves_several_accumulators_at_once():
    code = compiled(case(MODELS["lag"](), 400, (0, 90)))
    values = [code.values + 0.01 * i for i in range(8)]

    def work(v):
        return code.accumulator().normal(v).matrix.copy()

    alone = [work(v) for v in values]
    with ThreadPoolExecutor(8) as pool:
        for got, expected in zip(pool.map(work, values), alone, strict=True):
            np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize("value", [0.0, -0.0, 1.5, -2.25e-300, float("inf"), float("-inf"), float("nan"), 5e-324])
def test_a_literal_keeps_its_bits(value):
    f = FunctionWriter("put", [("ptr", "x")])
    f.store(literal(value), "%x")
    x = np.ones(1)
    compile_functions(f)[f.name](x.ctypes.data)
    assert x.tobytes() == np.array([value]).tobytes()
