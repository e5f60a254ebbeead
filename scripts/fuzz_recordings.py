"""Recordings of every format, made from a seed, for `fuzz.py` to damage."""

import gzip
import random
import re
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from datetime import datetime
from io import BytesIO
from pathlib import Path

import numpy as np
from fuzz_sample import Sample

END = "***End_of_Header***"  # of LabVIEW
_MADE = re.compile(rb"[A-Z][a-z]{2} [A-Z][a-z]{2} [ \d]\d [\d:]{8} \d{4}: updated")  # different each time


def recordings(seed: int) -> Iterator[Sample]:
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
        ".objects.mat": _mat_objects,
        ".objects.mat73": _mat_objects,
        ".ld": _motec,
        ".raw": _famos,
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


def diadem(seed: int) -> Iterator[Sample]:
    """Descriptions of DIAdem, each beside its values, and the values beside their description."""
    from tests.measurement import test_diadem as dat
    from tests.measurement import test_tdm_header as tdm

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


def bus_logs(seed: int) -> Iterator[Sample]:
    """Logs of a bus, each beside its database, and the database beside a log."""
    from tests.measurement.bus_files import DBC, Frame, drive, eec1, write_log, write_mf4

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
    from tests.measurement.xls_files import Formula, xls

    columns = _columns(numbers, int(numbers.integers(5, 400)))
    rows = [["time", "Speed", "Load"], ["s", "rpm", "%"], *zip(*(c.tolist() for c in columns.values()), strict=True)]
    path.write_bytes(xls({"Notes": [["a", True, Formula(2.0), Formula()]], "Data": rows}, short=len(rows) < 50))


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

    from tests.measurement.test_hdf5 import fixed_frame

    with h5py.File(path, "w") as file:
        fixed_frame(file, "datetime64[us]")


def _stored_table(path: Path, numbers: np.random.Generator) -> None:
    import h5py

    from tests.measurement.test_hdf5 import stored_table

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
    from tests.measurement.mlg_files import bits, mark, mlg, number, record

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
    from tests.measurement.matlab_files import save73

    columns = _columns(numbers)
    save73(path, {**columns, "group": {"time": columns["time"][:7], "data": columns["Load"][:7]}, "note": "a text"})


def _mat_objects(path: Path, numbers: np.random.Generator) -> None:
    from tests.measurement import matlab_objects as objects

    columns = {"Speed": numbers.normal(size=(3, 1)), "State": objects.categorical(["off", "on"], [1, 2, 0])}
    dates = objects.datetime([1e12, 1e12 + 1, 1e12 + 2], [0.0, 1e-5, 2e-5])
    variables = {
        "run": objects.timetable(dates, columns, ("rpm", "")),
        "even": objects.timetable(objects.even_times(objects.duration([0.0]), rate=10.0), columns),
        "points": objects.table(columns | {"Note": objects.string("a", "bc", "")}, ("rpm", "", "")),
    }
    save = objects.save_objects73 if path.suffix == ".mat73" else objects.save5
    save(path, variables)


def _motec(path: Path, numbers: np.random.Generator) -> None:
    from tests.measurement.race_files import LogChannel, motec_file

    speed = LogChannel("Engine RPM", "rpm", numbers.integers(0, 9000, 40).astype("<i2"), decimals=1)
    others = [
        LogChannel("Throttle", "%", numbers.normal(size=20).astype("<f4"), rate=5),
        LogChannel("Gear", "", numbers.integers(0, 6, 40).astype("<i4")),
    ]
    path.write_bytes(motec_file([speed, *others]))


def _famos(path: Path, numbers: np.random.Generator) -> None:
    from tests.measurement.race_files import Component, famos_curve, famos_file

    values = Component(numbers.integers(0, 9000, 40).astype("<i2"), "rpm", 0.5, 1.0)
    events = (
        Component(numbers.normal(size=9).astype("<f4"), "bar"),
        Component(np.arange(9, dtype="<u8"), "s", 1e-3, kind=13),
    )
    curves = [
        famos_curve("Speed", values, step=0.01, comment="of the engine", trigger=(28, 11, 2026, 10, 15, 30.0)),
        famos_curve("Pressure", *events, number=2),
        famos_curve(
            "", Component(numbers.integers(0, 4, 40).astype("<u2"), kind=11), number=3, names=[("On", 1), ("Off", 2)]
        ),
    ]
    path.write_bytes(famos_file(*curves))
