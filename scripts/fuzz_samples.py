"""Whole files of every format, made from a seed, for `fuzz.py` to damage."""

import random
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from fuzz_models import classes, components, fmus, functions, models, stored_networks
from fuzz_recordings import bus_logs, diadem, recordings
from fuzz_sample import Sample

from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Block, Cube, Curve, Map, Parameter, Scalar
from kennfeld.domain.texts import Text

ROOT = Path(__file__).parents[1]
LARGEST = 300_000  # bytes of a real file that is damaged as well


def samples(seed: int, folder: Path | None = None) -> list[Sample]:
    """Some files a kind, and the small ones of a folder as kind `real`."""
    sys.path.append(str(ROOT))  # for `tests`, which write files
    collected = [sample for maker in (*CORE, *GUESTS) for sample in maker(seed)]
    return collected + ([] if folder is None else list(_real(folder)))


def _real(folder: Path) -> Iterator[Sample]:
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.stat().st_size < LARGEST:
            yield Sample("real", path.name, {path.name: path.read_bytes()})


def _parameters(draw: random.Random, cubes: bool = False, variants: bool = False) -> ParameterSet:
    numbers = np.random.default_rng(draw.randrange(1 << 30))
    group = Axis(np.sort(numbers.choice(100, 4, replace=False)), unit="rpm", name="AxisGroup")
    own = Axis(np.arange(3.0), unit="%")
    members: list[Parameter] = [
        Scalar("K", float(numbers.normal()), unit="Nm", description="a value", functions=["F1"], display_name="k"),
        Block("B", numbers.normal(size=(3, 2))),
        Curve("C", group, numbers.normal(size=4), unit="Nm"),
        Map("M", group, own, np.round(numbers.normal(size=(4, 3)), 2), unit="bar", functions=["F1", "F2"]),
    ]
    if cubes:
        members.append(Cube("Q", [own, own, own], numbers.normal(size=(3, 3, 3))))
    others = [members[0].changed(values=np.array(2.5), variant="Engine=2")] if variants else []
    if variants:
        members[0] = members[0].changed(variant="Engine=1")
    texts = [Text("T", "a word"), Text("E", "ON", unit="-", kind="enumeration"), Text("S", "true", kind="boolean")]
    return ParameterSet(members, texts, [group], others)


def _calibrations(seed: int) -> Iterator[Sample]:
    """Parameters in every format that Kennfeld writes."""
    from kennfeld.calfiles import write

    for ending in (".dcm", ".csv", ".cdfx", ".json", ".xlsx", ".m", ".mat"):
        for number in range(4):
            draw = random.Random(f"{seed}{ending}{number}")
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / f"sample{ending}"
                write(_parameters(draw, cubes=ending not in (".dcm", ".csv"), variants=number % 2 == 1), path)
                yield Sample(f"calibration {ending}", path.name, {path.name: path.read_bytes()})


def _tunes(seed: int) -> Iterator[Sample]:
    """A tune of TunerStudio, alone and beside the file that defines its tables."""
    from tests.calfiles.test_msq import INI, TUNE

    tune = TUNE.encode("latin-1")
    yield Sample("calibration .msq", "tune.msq", {"tune.msq": tune})
    yield Sample("calibration .msq", "tune.msq", {"tune.msq": tune, "mainController.ini": INI.encode("latin-1")})
    yield Sample("calibration .ini", "mainController.ini", {"mainController.ini": INI.encode("latin-1"), "t.msq": tune})


def _loggers(seed: int) -> Iterator[Sample]:
    """Exports of loggers, and a parameter file of CANape."""
    from tests.calfiles.test_par import text
    from tests.measurement.test_loggers import ALL

    for name, content in ALL.items():
        file = f"log.{'vbo' if name == 'vbo' else 'csv'}"
        yield Sample(f"logger {name}", file, {file: content.encode("cp1252")})
    for version in ("3.1", "3.2"):
        yield Sample("calibration .par", "start.par", {"start.par": text(version).encode("cp1252")})


def _projects(seed: int) -> Iterator[Sample]:
    """Project files and a training file, each beside its formula and recording."""
    draw = random.Random(f"{seed}project")
    rows = "".join(f"{k},{draw.random():.3f},{draw.random():.3f}\n" for k in range(40))
    beside = {"sensor.kf": _FORMULA, "bench.csv": f"n,Load,Torque\n{rows}".encode()}
    for name, text in (("project", _PROJECT), ("steps", _PROJECT + _STEPS), ("training", _TRAINING)):
        yield Sample("project .toml", f"{name}.toml", {f"{name}.toml": text.encode(), **beside})


def _images(seed: int) -> Iterator[Sample]:
    """An A2L file and the image that it describes: each is damaged."""
    draw = random.Random(f"{seed}image")
    memory = bytes(draw.randrange(1, 4) for _ in range(48))
    files = {"ecu.a2l": _A2L.encode(), "ecu.hex": _hex(memory), "ecu.s19": _s19(memory)}
    for name in files:
        members = {member: files[member] for member in (name, "ecu.a2l")}
        yield Sample(f"image {Path(name).suffix}", name, members)


def _hex(memory: bytes) -> bytes:
    """Intel HEX of bytes at 0x10000."""
    data = [bytes([16, 0, at, 0]) + memory[at : at + 16] for at in range(0, len(memory), 16)]
    bodies = [bytes([2, 0, 0, 4, 0, 1]), *data, bytes([0, 0, 0, 1])]
    return b"".join(f":{body.hex().upper()}{-sum(body) % 256:02X}\r\n".encode() for body in bodies)


def _s19(memory: bytes) -> bytes:
    """S-records of bytes at 0x10000."""
    lines = [(3, bytes([21, 0, 1, 0, at]) + memory[at : at + 16]) for at in range(0, len(memory), 16)]
    lines.append((7, bytes([5, 0, 0, 0, 0])))
    return b"".join(f"S{kind}{body.hex().upper()}{~sum(body) % 256:02X}\n".encode() for kind, body in lines)


_A2L = """ASAP2_VERSION 1 71
/begin PROJECT P "" /begin MODULE M "" /* a comment */
/begin MOD_COMMON "" BYTE_ORDER MSB_FIRST ALIGNMENT_WORD 2 /end MOD_COMMON
/begin IF_DATA XCP /begin PAGE 1 "x" /end PAGE /end IF_DATA
/begin COMPU_METHOD HALF "" RAT_FUNC "%5.1" "rpm" COEFFS 0 2 0 0 0 1 /end COMPU_METHOD
/begin COMPU_METHOD WORDS "" TAB_VERB "%5.1" "" COMPU_TAB_REF W /end COMPU_METHOD
/begin COMPU_VTAB W "" TAB_VERB 3 1 "on" 2 "off" 3 "auto" DEFAULT_VALUE "none" /end COMPU_VTAB
/begin RECORD_LAYOUT RM NO_AXIS_PTS_X 1 UBYTE NO_AXIS_PTS_Y 2 UBYTE AXIS_PTS_X 3 UWORD INDEX_INCR DIRECT
  AXIS_PTS_Y 4 UWORD INDEX_INCR DIRECT FNC_VALUES 5 UWORD COLUMN_DIR DIRECT /end RECORD_LAYOUT
/begin RECORD_LAYOUT RA AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT /end RECORD_LAYOUT
/begin RECORD_LAYOUT RV FNC_VALUES 1 UBYTE ROW_DIR DIRECT /end RECORD_LAYOUT
/begin CHARACTERISTIC M "a ""map"" of it" MAP 0x10000 RM 0 HALF 0 100
  /begin AXIS_DESCR STD_AXIS Speed HALF 3 0 100 /end AXIS_DESCR
  /begin AXIS_DESCR STD_AXIS Load NO_COMPU_METHOD 3 0 100 /end AXIS_DESCR /end CHARACTERISTIC
/begin CHARACTERISTIC K "" VALUE 0x10020 RV 0 HALF 0 100 BIT_MASK 0x0F /end CHARACTERISTIC
/begin CHARACTERISTIC T "" VALUE 0x10021 RV 0 WORDS 0 3 /end CHARACTERISTIC
/begin CHARACTERISTIC B "" VAL_BLK 0x10022 RV 0 HALF 0 100 MATRIX_DIM 2 3 1 /end CHARACTERISTIC
/begin CHARACTERISTIC F "" CURVE 0x10022 RV 0 HALF 0 100
  /begin AXIS_DESCR FIX_AXIS Speed HALF 4 0 100 FIX_AXIS_PAR 0 1 4 /end AXIS_DESCR /end CHARACTERISTIC
/begin AXIS_PTS A "" 0x10030 Speed RA 0 HALF 3 0 100 /end AXIS_PTS
/begin FUNCTION Fn "" /begin DEF_CHARACTERISTIC M K /end DEF_CHARACTERISTIC /end FUNCTION
/begin TYPEDEF_STRUCTURE S "" 8 /begin STRUCTURE_COMPONENT c TC 0 MATRIX_DIM 2 /end STRUCTURE_COMPONENT
/end TYPEDEF_STRUCTURE
/begin TYPEDEF_CHARACTERISTIC TC "" VALUE RV 0 HALF 0 100 /end TYPEDEF_CHARACTERISTIC
/begin INSTANCE I "" S 0x10024 MATRIX_DIM 2 /end INSTANCE
/end MODULE /end PROJECT
"""
_FORMULA = b"trq [Nm] = Gain(n) * Load + offset\n"
_PROJECT = """# a project
[model]
file = "sensor.kf"

[channels]
Load = "Load"

[calculated]
double = "2 * Load"

[units]
n = "rpm"

[[dataset]]
files = ["bench.csv"]
where = "Load < 0.9"
weight = 1.0

[calibration]
output = ["dcm", "json"]

[axes.AxisN]
input = "n"
breakpoints = [0, 10, 20, 39]

[parameters.Gain]
x = { axis = "AxisN" }
initial = 1.0
bounds = [-5, inf]
smoothness = { x = 0.1 }
gradient = { x = [0, inf] }
pin = [{ at = [10], value = 1.0 }]

[parameters.offset]
initial = 0.0

[[criterion]]
node = "trq"
target = { channel = "Torque" }
loss = "huber"
delta = 2.0

[optimizer]
max_iterations = 3
"""
_STEPS = """
[[step]]
free = ["Gain"]

[[step]]
free = ["*"]

[[limit]]
node = "trq"
max = 50.0
"""
_TRAINING = """[surrogate]
name = "torque"
inputs = ["n", "Load"]
output = "Torque"

[[dataset]]
files = "bench.csv"
"""
Makers = tuple[Callable[[int], Iterator[Sample]], ...]
CORE: Makers = (
    _calibrations,
    _images,
    _tunes,
    _loggers,
    recordings,
    diadem,
    bus_logs,
    _projects,
)
GUESTS: Makers = (  # what importers read
    models,
    functions,
    fmus,
    stored_networks,
    classes,
    components,
)
