"""Models, and functions of other tools, made from a seed, for `fuzz.py` to damage."""

import random
import re
import zipfile
from collections.abc import Iterator
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.importers.simulink.simulink_files import Model
from fuzz_sample import Sample

STORED_NETWORKS = 12


def models(seed: int) -> Iterator[Sample]:
    """Models in every layout, each beside its script, and dictionaries of both formats beside a model."""
    from tests.importers.simulink.simulink_data import entry, sldd, thing
    from tests.importers.simulink.simulink_files import ENDINGS, LAYOUTS

    drawings = {"blocks": _blocks, "chart": _chart, "function": _function}
    for layout in LAYOUTS:
        for name, draw in drawings.items():
            model, script = draw(random.Random(f"{seed}{layout}{name}")), {"init.m": _SCRIPT}
            file = f"{name}{ENDINGS[layout]}"
            yield Sample(f"model {layout}", file, {file: model.written(layout), **script})
    user = {"blocks.slx": _blocks(random.Random(seed), "data.sldd").written("slx parts")}
    numbers = {"k": thing("Simulink.Parameter", Value=entry(2.5), Min=entry(0.0)), "T": entry([[1.0, 2.0, 4.0]])}
    yield Sample("dictionary .sldd", "data.sldd", {"data.sldd": sldd(numbers), **user})
    yield Sample("dictionary .sldd", "data.sldd", {"data.sldd": _DICTIONARY, **user})


def functions(seed: int) -> Iterator[Sample]:
    """Functions in C, with a file that they include and one of parameters, and in Python."""
    files = {"plant.c": _C_CODE, "plant.h": _C_HEADER, "plant_data.c": _C_DATA}
    yield Sample("function .c", "plant.c", {name: text.encode() for name, text in files.items()})
    yield Sample("function .c", "plant.h", {name: text.encode() for name, text in files.items()})
    yield Sample("function .py", "plant.py", {"plant.py": _PYTHON.encode()})


def stored_networks(seed: int) -> Iterator[Sample]:
    """Networks with layers, trees, functions, graphs and external data, and stored ones of the package onnx."""
    if find_spec("onnx") is None:
        return
    import onnx
    from fuzz_networks import networks

    for name, files in networks():
        yield Sample("network .onnx", name, files)
    stored = sorted((Path(onnx.__file__).parent / "backend/test/data").glob("pytorch-*/*/model.onnx"))
    for path in random.Random(seed).sample(stored, min(len(stored), STORED_NETWORKS)):
        yield Sample("network .onnx", "stored.onnx", {"stored.onnx": path.read_bytes()})


def fmus(seed: int) -> Iterator[Sample]:
    """Descriptions of FMUs, beside a library that no test loads."""
    from tests.importers.fmu.lag_fmu import DESCRIPTIONS
    from tests.importers.fmu.signals_fmu import description
    from tests.importers.fmu.test_library_format import elf

    for version in (2, 3):
        for text in (DESCRIPTIONS[version](), description(version, "")):
            packed = BytesIO()
            with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
                archive.writestr(zipfile.ZipInfo("modelDescription.xml"), text)
                for folder in ("linux64", "x86_64-linux"):
                    archive.writestr(zipfile.ZipInfo(f"binaries/{folder}/lag.so"), elf())
            yield Sample("function .fmu", "plant.fmu", {"plant.fmu": packed.getvalue()})


def _blocks(draw: random.Random, dictionary: str = "") -> "Model":
    """Algebra, a table, dynamics, a masked and an enabled subsystem."""
    from tests.importers.simulink.simulink_files import Mask, Model

    model = Model("blocks", step="0.1", code="" if dictionary else f"k = {draw.random():.3f};\nT = [1 2 4];")
    model.dictionary = dictionary
    model.inport("u")
    model.block("Gain", "K", Gain="k")
    model.block("Lookup_n-D", "L", NumberOfTableDimensions="1", BreakpointsForDimension1="[0 1 2]", Table="T")
    model.block("TransferFcn", "F", Numerator="[1]", Denominator=f"[{draw.random():.2f} 1]")
    inner = model.subsystem("S", mask=Mask({"gain": "2*k"}, initialization="twice = 2*gain;"))
    inner.inport("x")
    inner.block("EnablePort", "on", StatesWhenEnabling="reset")
    inner.block("Gain", "G", Gain="twice")
    inner.block("UnitDelay", "D", SampleTime="-1", InitialCondition="gain")
    inner.outport("y")
    inner.chain("x", "G", "D", "y")
    model.outport("y")
    model.chain("u", "K", "L", "F", "S", "y")
    model.line("u", "S#enable")
    return model


def _chart(draw: random.Random) -> "Model":
    """A chart of states within states and a junction."""
    from tests.importers.simulink.simulink_files import Chart, Model

    states = {"A": "A\nen: y = 1;", "B": "B\nen: y = u;\ndu: c = c + 1;", "B1": "B1", "B2": "B2\nex: y = c;"}
    ways = [
        ("", "A", ""),
        ("A", "j", f"[u > {draw.random():.2f}]"),
        ("j", "B", "{c = 0;}"),
        ("B", "A", "after(3, tick)"),
    ]
    ways += [("", "B1", ""), ("B1", "B2", "[c > 1]")]
    data = [("u", "INPUT_DATA"), ("y", "OUTPUT_DATA"), ("c", "LOCAL_DATA", "0")]
    model = Model("chart", step="0.1", solver="FixedStepDiscrete")
    model.inport("u")
    model.chart("C", Chart(states, ways, data, parents={"B1": "B", "B2": "B"}, junctions=("j",)))
    model.outport("y")
    model.chain("u", "C", "y")
    return model


def _function(draw: random.Random) -> "Model":
    """A MATLAB Function with a memory, a loop and a function of its own."""
    from tests.importers.simulink.simulink_files import Model

    model = Model("function", step="0.1", solver="FixedStepDiscrete")
    model.inport("u")
    model.function("F", _CODE.replace("SIZE", str(draw.randrange(2, 9))))
    model.outport("y")
    model.chain("u", "F", "y")
    return model


_SCRIPT = b"""k = 2.5; % a parameter
T = linspace(1, 3, 3);
for i = 1:3
    T(i) = T(i) + i^2;
end
s.a = {1, 'two', [3; 4]};
if exist('k', 'var') && k > 2, k = k / 2; end
"""
_CODE = """function y = F(u)
persistent total
if isempty(total), total = zeros(SIZE, 1); end
for i = 1:SIZE
    total(i) = total(i) + squared(u) * i;
end
y = sum(total(1:2));
n = 0;
while y > 10 && n < 5
    y = y - 10;
    n = n + 1;
    if y < 5, break; end
end
function z = squared(x)
z = x .^ 2;
"""
_DICTIONARY = b"""{"__MW_TEXT_COREPROPERTIES__": {}, "__MW_TEXT_PARTS__": {
 "__MW_TEXT_PART__/data/chunk0": {"__MW_TEXT_content": {
 "entries": [
  {"name": "k", "metadata": {"uuid": "x"}, "value": {"_array_class": "Simulink.Parameter", "_dimensions": [1, 1],
    "_elements": [{"_id": "1", "_properties": {"Value": 9.81, "Min": 0, "DocUnits": "m/s^2"}}]}},
  {"name": "T", "metadata": {"uuid": "y"}, "value": {"_type": "double", "_value": "Matrix(1,3)\\n[1.0, 2.0, 4.0]"}}],
 "Dictionary References": [], "AllowAccessBWS": false}}}}
"""


def classes(seed: int) -> Iterator[Sample]:
    """ESDL classes, with an application beside them, and the messages that they read."""
    from tests.importers.ascet.esdl_projects import BATTERY, LIBRARY, MACHINE, VEHICLE
    from tests.importers.ascet.random_programs import HEAD

    body = "public real calc(real in x, integer in k, boolean in on) {\n" + _STATEMENTS + "}\n}\n"
    flat = {Path(name).name: text for name, text in {**LIBRARY, **BATTERY}.items()}
    texts = {
        "Own.esdl": f"package Cell;\n{HEAD}{body}",
        "Machine.esdl": f"package Cell;\n{MACHINE}",
        "Vehicle.esdl": VEHICLE,
        **{name: flat[name] for name in ("Plant.esdl", "Accu.esdl", "Messages.esdl")},
    }
    beside = {
        name: re.sub(r"^package [\w.]+;", "package Cell;", text).encode()
        for name, text in flat.items()
        if name.endswith(".esdl")
    }
    for name, text in texts.items():
        yield Sample("ESDL", name, {**beside, name: text.encode()} if name == "Plant.esdl" else {name: text.encode()})
    packages = {name.partition("/")[2]: text.encode() for name, text in {**LIBRARY, **BATTERY}.items()}
    for name, text in (("Battery.app", flat["Battery.app"]), ("Tasks.app", _TASKS)):
        yield Sample("application", name, {**packages, name: text.encode()})


_TASKS = """application { class Cell.Plant class Cell.Sensor representation Cell.Sensor.Impl }
schedule {
	startup { process Cell.Plant.init }
	shutdown { }
	task Fast priority 1 scheduling none period 2.5ms delay 0ms { process Cell.Plant.calc }
	task Slow priority 0 period 10ms delay 5ms { process Cell.Sensor.calc }
	task Event priority 2 { process Cell.Plant.init }
}
"""


def components(seed: int) -> Iterator[Sample]:
    """Components of ASCET 6: archives, and each file of a component with the others beside it."""
    from tests.importers.ascet.amd_files import archive
    from tests.importers.ascet.component_samples import LOW_PASS, machine_component, plant_component

    plant, machine = plant_component(), machine_component()
    yield Sample(".axl", "Engine.axl", {"Engine.axl": archive(plant, LOW_PASS)})
    yield Sample(".axl", "Machine.axl", {"Machine.axl": archive(machine)})
    for component, others in ((plant, (LOW_PASS,)), (LOW_PASS, ()), (machine, ())):
        files = {Path(path).name: content for own in (component, *others) for path, content in own.files().items()}
        for name in files:
            if name.startswith(f"{component.name}."):
                yield Sample(".amd", name, files)


_STATEMENTS = """	real y = if (x > 0.0 && on) then first.step(x, on) else C.getAt(x) / a;
	for (n in 0 .. 2) { v[n] = v[n] * 0.5 + real(n % 2); }
	while (i < 5) { i += 2; }
	switch (k) { case 0, 1 : { j = k << 2; } default : j = -j & 7; }
	if (q) { return M.getAt(x, y) * half; } else { p = !q; }
	mode = Mode.Fast;
	return max(min(y, 3.0), -3.0) + real(j / 2);
"""
_C_HEADER = """
#ifndef PLANT_H
#define PLANT_H
#include <stdint.h>
#define CLIP(x, low, high) (((x) < (low)) ? (low) : (((x) > (high)) ? (high) : (x)))
#define SIZE 4
typedef struct { double speed; float load[2]; struct { int32_t gear; uint8_t on; } box; } In;
typedef struct { double torque; double held; } Out;
typedef struct { double sum; float ring[SIZE]; uint8_t at; } State;
typedef struct { double gain; double table[SIZE]; } P_plant;
extern P_plant plant_P;
enum mode { OFF, SLOW = 2, FAST };
#endif
"""
_C_DATA = """
#include "plant.h"
P_plant plant_P = { 2.5, { 1.0, 2.0, 4.0, 8.0 } };
"""
_C_CODE = """
#include <math.h>
#include "plant.h"
const volatile float K = 2.0f;
const volatile double CURVE[SIZE] = { 0, 1, [3] = 9 };
static const double places[SIZE] = { 0.0, 1.0, 2.0, 3.0 };
#if defined(PLANT_H) && (SIZE > 2)
static double look(double u, const double *x, const volatile double y[], int n)
{
    int i = 0;
    while (i < n - 2 && u > x[i + 1]) { i++; }
    return y[i] + CLIP((u - x[i]) / (x[i + 1] - x[i]), 0.0, 1.0) * (y[i + 1] - y[i]);
}
#else
#error the table is too short
#endif
void step(const In *in, Out *out, State *s)
{
    static int calls;
    uint32_t hash = 2166136261u;
    double sum = 0.0;
    int i;
    for (i = 0; i < 2; i++) { if (in->load[i] < 0.0f) continue; sum += in->load[i]; }
    s->ring[s->at] = (float)sum;
    s->at = (uint8_t)((s->at + 1U) % SIZE);
    s->sum += 0.1 * (sum - s->sum);
    hash = (hash ^ (uint32_t)in->box.gear) * 16777619u;
    switch (in->box.gear) {
    case OFF: sum = -1.0; break;
    case 1: case SLOW: sum += 10.0;
    case FAST: sum += look(in->speed, places, CURVE, SIZE); break;
    default: sum = plant_P.table[hash >> 30];
    }
    do { sum *= 0.5; } while (sum > 100.0 && calls++ < 3);
    out->torque = K * sum + plant_P.gain * fmax(s->ring[0], s->sum);
    if (in->box.on && !(in->speed < 1e-3)) out->held = sin(in->speed) + pow(2.0, sum / 50.0);
}
"""
_PYTHON = """
import math

GAIN = 2.5


def eta(speed, load, offset=0.0):
    if speed < 800:
        return offset, speed
    total = 0.0
    for k in range(3):
        total += GAIN * math.tanh(load / (40 + k))
    return offset + total, max(speed, load)


def called(x):
    return {1: x}[1]
"""
