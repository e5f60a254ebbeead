"""Whole files of every format, made from a seed, for `fuzz.py` to damage."""

import gzip
import random
import re
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Block, Cube, Curve, Map, Parameter, Scalar, Text

if TYPE_CHECKING:
    from simulink_files import Model

WRITERS = [
    str(Path(__file__).parents[1] / "tests" / room)
    for room in ("measurement", "calfiles", "models/ascet", "models/simulink")
]
END = "***End_of_Header***"  # of LabVIEW
_MADE = re.compile(rb"[A-Z][a-z]{2} [A-Z][a-z]{2} [ \d]\d [\d:]{8} \d{4}: updated")  # different each time
LARGEST = 300_000  # bytes of a real file that is damaged as well


@dataclass(frozen=True)
class Sample:
    """A whole file, with the files that belong beside it; the one called `name` is damaged."""

    kind: str
    name: str
    files: Mapping[str, bytes]


def samples(seed: int, folder: Path | None = None) -> list[Sample]:
    """Some files a kind, and the small ones of a folder as kind `real`."""
    sys.path += WRITERS  # what writes files for the tests
    collected = [sample for maker in _MAKERS for sample in maker(seed)]
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
    from test_msq import INI, TUNE

    tune = TUNE.encode("latin-1")
    yield Sample("calibration .msq", "tune.msq", {"tune.msq": tune})
    yield Sample("calibration .msq", "tune.msq", {"tune.msq": tune, "mainController.ini": INI.encode("latin-1")})
    yield Sample("calibration .ini", "mainController.ini", {"mainController.ini": INI.encode("latin-1"), "t.msq": tune})


def _loggers(seed: int) -> Iterator[Sample]:
    """Exports of loggers, and a parameter file of CANape."""
    from test_loggers import ALL
    from test_par import text

    for name, content in ALL.items():
        file = f"log.{'vbo' if name == 'vbo' else 'csv'}"
        yield Sample(f"logger {name}", file, {file: content.encode("cp1252")})
    for version in ("3.1", "3.2"):
        yield Sample("calibration .par", "start.par", {"start.par": text(version).encode("cp1252")})


def _recordings(seed: int) -> Iterator[Sample]:
    """Measurement files of every format that a library here writes."""
    writers: dict[str, Callable[[Path, np.random.Generator], None]] = {
        ".csv": _csv,
        ".txt": _german,
        ".xlsx": _excel,
        ".parquet": _parquet,
        ".feather": _feather,
        ".tdms": _tdms,
        ".h5": _hdf5,
        ".frame.h5": _stored_frame,
        ".table.h5": _stored_table,
        ".nc": _netcdf,
        ".arrows": _arrow_stream,
        ".mf4": _mdf("4.10"),
        ".mdf": _mdf("3.30"),
        ".mlg": _mlg,
        ".msl": _msl,
        ".hpl": _hptuners,
        ".lvm": _lvm,
        ".mat": _mat,
        ".mat73": _mat73,
        ".xls": _xls,
        ".csv.gz": _gzipped(_csv),
        ".parquet.gz": _gzipped(_parquet),
        ".mlg.gz": _gzipped(_mlg),
        ".tdms.gz": _gzipped(_tdms),
        ".csv.zip": _zipped(_csv),
        ".txt.gz": _gzipped(_german),
        ".msl.gz": _gzipped(_msl),
        ".gbk.csv": _chinese,
    }
    for ending, write in writers.items():
        for number in range(3):
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / f"sample{ending}"
                write(path, np.random.default_rng([seed, number]))
                yield Sample(f"measurement {ending}", path.name, {path.name: path.read_bytes()})


def _diadem(seed: int) -> Iterator[Sample]:
    """Descriptions of DIAdem, each beside its values, and the values beside their description."""
    import test_diadem as dat
    import test_tdm_header as tdm

    numbers = np.random.default_rng([seed, 7])
    values = numbers.normal(size=12).astype("<f8").tobytes()
    header = (
        dat.GLOBAL
        + "#ENDGLOBALHEADER\n\n"
        + dat.implicit("Time", "s", 6, 0.0, 0.1)
        + dat.explicit("Speed", "run.r64", "REAL64", 6, unit="rpm")
        + dat.explicit("Load", "run.r64", "REAL64", 6, first=2, method="BLOCK", _222=2)
        + dat.explicit("Text", "run.asc", "ASCII", 3, method="BLOCK", _230=";")
    )
    beside = {"run.r64": values, "run.asc": b"1;2\n3;4\n5;6\n"}
    for encoding in ("cp1252", "utf-16"):
        yield Sample("measurement .dat", "run.dat", {"run.dat": header.encode(encoding), **beside})
    stamps = tdm.stamps(0.1 * np.arange(3))
    blocks = (
        tdm.block(0, byteOffset=0, length=3, valueType="eFloat64Usi")
        + tdm.block(1, byteOffset=96, length=3, valueType="eTimeUsi")
        + tdm.block(2, byteOffset=144, length=3, valueType="eInt16Usi")
    )
    channels = (
        tdm.group("bench", 1, 2, 3)
        + tdm.flagged("inc2")
        + tdm.channel(2, "Stamp", "", tdm.EXPLICIT, '<values external="inc1"/>')
        + tdm.channel(3, "Time", "s", tdm.parameters("implicit_linear", 0.5, 0.1))
    )
    description = tdm.HEAD.format(blocks=blocks, data=channels + tdm.ROWS).encode()
    binary = {"bench.tdx": values + stamps + np.array([15, 0, 15], dtype="<i2").tobytes()}
    yield Sample("measurement .tdm", "bench.tdm", {"bench.tdm": description, **binary})
    yield Sample("measurement .tdx", "bench.tdx", {"bench.tdm": description, **binary})
    packed = BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(zipfile.ZipInfo("header.xml"), description)
    yield Sample("measurement .tdm packed", "bench.tdm", {"bench.tdm": packed.getvalue(), **binary})


def _bus_logs(seed: int) -> Iterator[Sample]:
    """Logs of a bus, each beside its database, and the database beside a log."""
    from bus_files import DBC, Frame, drive, eec1, write_log, write_mf4

    draw = random.Random(f"{seed}bus")
    frames = drive(40)
    frames += [Frame(0.005 * k, 0x0CF00400, eec1(draw.randrange(2000), 10), True, 2) for k in range(40)]
    frames += [Frame(0.01 * k, 502, bytes([draw.randrange(3), k, 0])) for k in range(20)]
    for ending in (".mf4", ".asc", ".blf", ".trc", ".log"):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"drive{ending}"
            (write_mf4 if ending == ".mf4" else write_log)(path, sorted(frames))
            content = _MADE.sub(b"Wed Jan  1 00:00:00 2020: updated", path.read_bytes())
            content = re.sub(rb"(?m)^date .*$", b"date Wed Jan 1 00:00:00.000 2020", content)
        files = {path.name: content, "engine.dbc": DBC.encode()}
        yield Sample(f"bus log {ending}", path.name, files)
        yield Sample("CAN database", "engine.dbc", files)


def _columns(numbers: np.random.Generator, rows: int = 40) -> dict[str, np.ndarray]:
    collected = {name: np.round(numbers.normal(size=rows), 3) for name in ("Speed", "Load")}
    return {"time": 0.1 * np.arange(rows)} | collected


def _csv(path: Path, numbers: np.random.Generator) -> None:
    columns = _columns(numbers)
    lines = ["time [s],Speed [rpm],Load [%]", *(",".join(map(str, row)) for row in zip(*columns.values(), strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _german(path: Path, numbers: np.random.Generator) -> None:
    columns = _columns(numbers)
    rows = (";".join(str(cell).replace(".", ",") for cell in row) for row in zip(*columns.values(), strict=True))
    path.write_text("\r\n".join(["# Prüfstand 3", "Zeit;Drehzahl;Last", "s;1/min;%", *rows]), encoding="cp1252")


def _chinese(path: Path, numbers: np.random.Generator) -> None:
    rows = (",".join(map(str, row)) for row in zip(*_columns(numbers).values(), strict=True))
    path.write_text("\n".join(["时间 [s],转速 [rpm],负荷 [%]", *rows]), encoding="gb18030")


def _gzipped(write: Callable[[Path, np.random.Generator], None]) -> Callable[[Path, np.random.Generator], None]:
    def write_packed(path: Path, numbers: np.random.Generator) -> None:
        write(path, numbers)
        path.write_bytes(gzip.compress(path.read_bytes(), mtime=0))

    return write_packed


def _zipped(write: Callable[[Path, np.random.Generator], None]) -> Callable[[Path, np.random.Generator], None]:
    def write_packed(path: Path, numbers: np.random.Generator) -> None:
        write(path, numbers)
        content = path.read_bytes()
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(zipfile.ZipInfo("sample.csv"), content)

    return write_packed


def _xls(path: Path, numbers: np.random.Generator) -> None:
    from xls_files import Formula, xls

    columns = _columns(numbers, int(numbers.integers(5, 400)))
    rows = [["time", "Speed", "Load"], ["s", "rpm", "%"], *zip(*(c.tolist() for c in columns.values()), strict=True)]
    path.write_bytes(xls({"Notes": [["a", True, Formula(2.0), Formula()]], "Data": rows}, short=len(rows) < 50))


def _projects(seed: int) -> Iterator[Sample]:
    """Project files and a training file, each beside its formula and recording."""
    draw = random.Random(f"{seed}project")
    rows = "".join(f"{k},{draw.random():.3f},{draw.random():.3f}\n" for k in range(40))
    beside = {"sensor.kf": _FORMULA, "bench.csv": f"n,Load,Torque\n{rows}".encode()}
    for name, text in (("project", _PROJECT), ("steps", _PROJECT + _STEPS), ("training", _TRAINING)):
        yield Sample("project .toml", f"{name}.toml", {f"{name}.toml": text.encode(), **beside})


def _excel(path: Path, numbers: np.random.Generator) -> None:
    import xlsxwriter

    with xlsxwriter.Workbook(str(path)) as book:
        book.set_properties({"created": datetime(2020, 1, 1)})  # else the time of making, different each time
        sheet = book.add_worksheet("Data")
        for column, (name, values) in enumerate(_columns(numbers).items()):
            sheet.write(0, column, name)
            sheet.write_column(1, column, values.tolist())


def _parquet(path: Path, numbers: np.random.Generator) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    parquet.write_table(pa.table(_columns(numbers)), path)


def _feather(path: Path, numbers: np.random.Generator) -> None:
    import pyarrow as pa
    from pyarrow import feather

    feather.write_feather(pa.table(_columns(numbers)), path)


def _tdms(path: Path, numbers: np.random.Generator) -> None:
    from nptdms import ChannelObject, TdmsWriter

    even = {"wf_increment": 0.1, "wf_start_time": np.datetime64("2020-01-01T00:00:00"), "unit_string": "rpm"}
    with TdmsWriter(path) as writer:
        for group, rows in (("fast", 40), ("slow", 7)):
            columns = _columns(numbers, rows).items()
            writer.write_segment([ChannelObject(group, name, values, even) for name, values in columns])


def _hdf5(path: Path, numbers: np.random.Generator) -> None:
    import h5py

    with h5py.File(path, "w", track_order=False) as file:
        for group, rows in (("fast", 40), ("slow", 7)):
            for name, values in _columns(numbers, rows).items():
                file[f"{group}/{name}"] = values
                file[f"{group}/{name}"].attrs["units"] = "s" if name == "time" else "rpm"


def _stored_frame(path: Path, numbers: np.random.Generator) -> None:
    import h5py
    from test_hdf5 import fixed_frame

    with h5py.File(path, "w") as file:
        fixed_frame(file, "datetime64[us]")


def _stored_table(path: Path, numbers: np.random.Generator) -> None:
    import h5py
    from test_hdf5 import stored_table

    with h5py.File(path, "w") as file:
        stored_table(file, ["Speed", "Load"])


def _arrow_stream(path: Path, numbers: np.random.Generator) -> None:
    import pyarrow as pa
    from pyarrow import ipc

    table = pa.table(_columns(numbers))
    with path.open("wb") as stream, ipc.new_stream(stream, table.schema) as writer:
        writer.write_table(table, max_chunksize=15)


def _netcdf(path: Path, numbers: np.random.Generator) -> None:
    from scipy.io import netcdf_file

    with netcdf_file(path, "w") as file:
        file.createDimension("time", 40)
        for name, values in _columns(numbers).items():
            variable = file.createVariable(name, "d", ("time",))
            variable[:] = values
            variable.units = "s" if name == "time" else "rpm"


def _mdf(version: str) -> Callable[[Path, np.random.Generator], None]:
    def write(path: Path, numbers: np.random.Generator) -> None:
        import warnings

        from asammdf import MDF, Signal

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with MDF(version=version) as mdf:
                for rows in (40, 7):
                    columns = _columns(numbers, rows)
                    time = columns.pop("time")
                    mdf.append([Signal(v, time, name=f"{n}{rows}", unit="rpm") for n, v in columns.items()])
                mdf.save(path, overwrite=True, compression=int(numbers.integers(0, 3)) if version > "4" else 0)
        path.write_bytes(_MADE.sub(b"Wed Jan  1 00:00:00 2020: updated", path.read_bytes()))

    return write


def _mlg(path: Path, numbers: np.random.Generator) -> None:
    from mlg_files import bits, mark, mlg, number, record

    version = int(numbers.integers(1, 3))
    fields = [
        number("Time", unit="s"),
        number("RPM", 2, "rpm"),
        number("AFR", 0, scale=0.1),
        bits("Engine", "on", "cold"),
    ]
    values = [(0.1 * i, 800 + i, 147, i % 4) for i in range(40)]
    records = [record(fields, row, stamp=1000 * i % 65536) for i, row in enumerate(values)]
    path.write_bytes(mlg(fields, [*records[:20], mark("here"), *records[20:]], version=version, info="note=1"))


def _msl(path: Path, numbers: np.random.Generator) -> None:
    rows = (f"{0.1 * i:.3f}\t{800 + i}\t{numbers.normal():.2f}" for i in range(40))
    path.write_text(
        "\n".join(['"MS2Extra"', '"Capture Date: 1"', "Time\tRPM\tMAP", "s\trpm\tkPa", *rows, "MARK 000"]),
        encoding="utf-8",
    )


def _hptuners(path: Path, numbers: np.random.Generator) -> None:
    head = "HP Tuners CSV Log File\nVersion: 1.0\n\n[Log Information]\nNotes: \n\n[Channel Information]\n0,1,2\n"
    rows = [f"{0.1 * i:.2f},{800 + i},{numbers.normal():.2f}" if i % 2 else f"{0.1 * i:.2f},,1.5" for i in range(40)]
    path.write_text(
        head + "\n".join(["Offset,Engine RPM,Air", "s,rpm,g/s", "", "[Channel Data]", *rows, ""]), encoding="utf-8"
    )


def _lvm(path: Path, numbers: np.random.Generator) -> None:
    head = [
        "LabVIEW Measurement",
        "Writer_Version\t2",
        "Separator\tTab",
        "Multi_Headings\tNo",
        "X_Columns\tOne",
        END,
        "",
    ]
    block = ["Channels\t2", "Samples\t40\t40", "X0\t0\t0", "Delta_X\t0.1\t0.1", END, "X_Value\tSpeed\tLoad\tComment"]
    rows = (f"{0.1 * i:.2f}\t{numbers.normal():.3f}\t{i}" for i in range(40))
    path.write_text("\n".join([*head, *block, *rows]), encoding="utf-8")


def _mat(path: Path, numbers: np.random.Generator) -> None:
    from scipy.io import savemat

    columns = _columns(numbers)
    group = {"time": columns["time"][:7], "signals": {"values": columns["Speed"][:7], "label": "Speed"}}
    savemat(path, {**columns, "group": group, "note": "a text"}, do_compression=bool(numbers.integers(0, 2)))


def _mat73(path: Path, numbers: np.random.Generator) -> None:
    from matlab_files import save73

    columns = _columns(numbers)
    save73(path, {**columns, "group": {"time": columns["time"][:7], "data": columns["Load"][:7]}, "note": "a text"})


def _images(seed: int) -> Iterator[Sample]:
    """An A2L file and the image that it describes: each is damaged."""
    draw = random.Random(f"{seed}image")
    memory = bytes(draw.randrange(1, 4) for _ in range(48))
    files = {"ecu.a2l": _A2L.encode(), "ecu.hex": _hex(memory), "ecu.s19": _s19(memory)}
    for name in files:
        members = {member: files[member] for member in (name, "ecu.a2l")}
        yield Sample(f"image {Path(name).suffix}", name, members)


def _models(seed: int) -> Iterator[Sample]:
    """Models in every layout, each beside its script, and dictionaries of both formats beside a model."""
    from simulink_data import entry, sldd, thing
    from simulink_files import ENDINGS, LAYOUTS

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


def _functions(seed: int) -> Iterator[Sample]:
    """Functions in C, with a file that they include and one of parameters, and in Python."""
    files = {"plant.c": _C_CODE, "plant.h": _C_HEADER, "plant_data.c": _C_DATA}
    yield Sample("function .c", "plant.c", {name: text.encode() for name, text in files.items()})
    yield Sample("function .c", "plant.h", {name: text.encode() for name, text in files.items()})
    yield Sample("function .py", "plant.py", {"plant.py": _PYTHON.encode()})


def _blocks(draw: random.Random, dictionary: str = "") -> "Model":
    """Algebra, a table, dynamics, a masked and an enabled subsystem."""
    from simulink_files import Mask, Model

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
    from simulink_files import Chart, Model

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
    from simulink_files import Model

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


def _classes(seed: int) -> Iterator[Sample]:
    """ESDL classes, with an application beside them, and the messages that they read."""
    from esdl_projects import BATTERY, LIBRARY, MACHINE, VEHICLE
    from random_programs import HEAD

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


def _components(seed: int) -> Iterator[Sample]:
    """Components of ASCET 6: archives, and each file of a component with the others beside it."""
    from amd_files import archive
    from component_samples import LOW_PASS, machine_component, plant_component

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

_MAKERS: tuple[Callable[[int], Iterator[Sample]], ...] = (
    _calibrations,
    _images,
    _tunes,
    _loggers,
    _recordings,
    _diadem,
    _bus_logs,
    _models,
    _functions,
    _classes,
    _components,
    _projects,
)
