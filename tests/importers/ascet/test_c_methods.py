"""Methods in C: the code beside a class against the same code compiled by the system, and methods of SystemLib."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest

from kennfeld.ascet.c_body_parser import parse_c_body
from kennfeld.base.errors import Finding, InputError
from kennfeld.importers.ascet.importing import esdl, import_esdl
from tests.importers.ascet.esdl_projects import run, write_project

COMPILER = shutil.which("cc") or shutil.which("gcc")
# name and result of functions of (uint16 x, uint8 k, boolean b), and their bodies
BODIES = {
    "clear": ("uint16", "return (x & ~(((uint16) 1) << k));"),
    "small": ("uint16", "return x & ~((uint8) 1);"),
    "left": ("uint16", "return x << k;"),
    "turn": ("uint16", "return ((x << k) | (x & ~(((uint16) 1 << (16-k)) -1))>>(16-k));"),
    "byte": ("uint8", "return (uint8) (x * 3u + k);"),
    "minus": ("uint16", "return x - 40000;"),
    "low": ("sint8", "return (sint8) x;"),
    "any": ("boolean", "return (x & 0x0FF0);"),
    "word": ("uint32", "return ~((uint32) x << k) & 0xFFFFFFFF;"),
    "flip": ("uint16", "return (b ? x ^ 0x00FF : x | 1) + (b << 3) + b + b;"),
    "local": ("uint16", "uint16 s;\n/* halves */ s = x; s += s / 2; if (s > 30000) s = s % 7; else { s--; } return s;"),
    "chosen": ("uint8", "switch (k) { case 1: return 10; case 2: { x = 3; break; } default: x = 9; } return x;"),
}
X = np.array([0, 1, 2, 77, 255, 256, 4660, 21846, 32768, 43981, 65534, 65535])
K = np.array([0, 1, 2, 3, 5, 7, 8, 9, 12, 14, 15, 15])
B = np.array([0, 1] * 6)


def declared(bodies, stateless="stateless "):
    types = "".join(
        f"type {sign}int{bits} is integer using {sign}int{bits};\n" for sign in "us" for bits in (8, 16, 32)
    )
    heads = "".join(f"\tpublic {kind} {name}(uint16 in x, uint8 in k, boolean in b);\n" for name, kind in bodies)
    return f"package Own;\n{types}{stateless}class C {{\n{heads}}}\n"


def project(folder, text, bodies, inner=""):
    files = {f"Own/Own/C_c_code_snippets/{inner}{name}.c": body for name, body in bodies.items()}
    return write_project(folder, {"Own/Own/C.esdl": text, **files}) / "Own/Own/C.esdl"


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    if COMPILER is None:
        pytest.skip("no C compiler")
    folder = tmp_path_factory.mktemp("c")
    head = "#include <stdint.h>\n" + "".join(
        f"typedef {sign.replace('s', '')}int{bits}_t {sign}int{bits};\n" for sign in "us" for bits in (8, 16, 32)
    )
    functions = "".join(
        f"{kind} f_{name}(uint16 x, uint8 k, boolean b) {{ {body} }}\n" for name, (kind, body) in BODIES.items()
    )
    (folder / "f.c").write_text(f"{head}typedef _Bool boolean;\n{functions}")
    subprocess.run([COMPILER, "-shared", "-fPIC", "-fwrapv", "-o", "f.so", "f.c"], cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "f.so"))


C_TYPES = {"uint8": ctypes.c_uint8, "sint8": ctypes.c_int8, "uint16": ctypes.c_uint16, "uint32": ctypes.c_uint32}


def test_code_in_c_calculates_what_a_compiler_makes_of_it(tmp_path, compiled):
    bodies = {name: body for name, (_, body) in BODIES.items()}
    path = project(tmp_path, declared([(name, kind) for name, (kind, _) in BODIES.items()]), bodies)
    for name, (kind, _) in BODIES.items():
        nodes = run(esdl(path, methods=[name]), {"x": X, "k": K, "b": B})
        function = getattr(compiled, f"f_{name}")
        function.restype = C_TYPES.get(kind, ctypes.c_bool)
        function.argtypes = [ctypes.c_uint16, ctypes.c_uint8, ctypes.c_bool]
        expected = [float(function(int(x), int(k), bool(b))) for x, k, b in zip(X, K, B, strict=True)]
        assert nodes[name].tolist() == expected, name


def test_code_in_c_reads_and_changes_the_elements_of_its_class(tmp_path):
    text = """package Own;
import Lib.Time.DeltaTime;
@c_code class C { characteristic real period = 0.25; characteristic real high = 2.0;
  real time = 0.0; boolean on = false; real out = 0.0;
  public void calc(); public void init(); public real value(); }
"""
    body = (
        "//#ifdef PC\n time += DeltaTime.deltaT;\n if (time > period) {on = !on; time = 0.0;}\n out = 1.0 + on * high;"
    )
    path = project(tmp_path, text, {"calc": body, "value": "return out;", "init": "on = false;"})
    report = import_esdl(path).report
    assert [label.rpartition(".")[2] for label in report.methods] == ["calc", "value"]
    assert [file.name for file in report.files if file.suffix == ".c"] == ["calc.c", "value.c"]
    values = run(esdl(path, step=0.1), samples=7)["value"]
    assert values.tolist() == [1.0, 1.0, 3.0, 3.0, 3.0, 1.0, 1.0]


def test_the_code_of_the_implementation_of_a_class_is_taken(tmp_path):
    text = "package Own;\nclass C using Impl_8bit { public real calc(); representation Impl_8bit { } }"
    project(tmp_path, text, {"calc": "return 1.0;"})
    path = project(tmp_path, text, {"calc": "return 2.0f;"}, "Impl_8bit/")
    assert run(esdl(path), samples=1)["calc"].tolist() == [2.0]


@pytest.mark.parametrize(
    ("body", "part"),
    [
        ("#ifdef PC\nreturn 1;\n#endif", "C.calc is implemented in C, which is not supported: expected an expression"),
        ("return 010;", "the octal number 010"),
        ("static uint8 n; n++; return n;", "a static variable of C"),
        ("switch (x) { case 1: x = 2; default: x = 3; } return x;", "falls through"),
        ("return read_port(3);", "unknown method read_port"),
        ("return *x;", "expected an expression, got '*'"),
        ("return 1q;", "invalid number 1q"),
        ("for (i = 0; i < 3; i++) x++; return x;", "expected 'in'"),
    ],
)
def test_code_in_c_that_is_not_supported_is_reported_with_its_line(tmp_path, body, part):
    text = "package Own;\nclass C { public real calc(integer in x); }"
    path = project(tmp_path, text, {"calc": f"\n{body}"})
    (finding,) = import_esdl(path).report.findings
    assert part in finding.message
    assert (finding.location.file, finding.location.line) == ("calc.c", 2)


def test_the_parser_of_c_knows_conversions_and_suffixes():
    assert isinstance(parse_c_body("return (uint8 x);", "f.c"), Finding)
    assert isinstance(parse_c_body("return (uint8) (x) + 0x1Ful * (TRUE ? 2.0F : 1);", "f.c"), tuple)


SYSTEM = """package SystemLib.Bitoperations;
type Word is integer using uint32;
stateless class {name} {{ public Word {method}(Word in x, Word in k{more}); }}
"""


@pytest.mark.parametrize(
    ("name", "method", "more", "expected"),
    [
        ("rotate", "getRotate", "", lambda x, k, b: ((x << k) | (x >> (16 - k))) & 0xFFFF),
        ("writeBit", "getWriteBit", ", boolean in b", lambda x, k, b: x & ~(1 << k) | (b << k)),
        ("and", "getAnd", "", lambda x, k, b: x & k),
        ("shiftLeft", "getShiftLeft", "", lambda x, k, b: (x << k) & 0xFFFF),
    ],
)
def test_bit_operations_of_system_lib_need_no_code(tmp_path, name, method, more, expected):
    text = SYSTEM.format(name=name, method=method, more=more)
    path = write_project(tmp_path, {f"Own/SystemLib/Bitoperations/{name}.esdl": text}) / "Own/SystemLib/Bitoperations"
    model = esdl(path / f"{name}.esdl")
    nodes = run(model, {key: column for key, column in zip("xkb", (X, K, B), strict=True) if key in model.graph.inputs})
    assert nodes[method].tolist() == [expected(int(x), int(k), int(b)) for x, k, b in zip(X, K, B, strict=True)]


def test_a_byte_is_written_from_eight_bits(tmp_path):
    arguments = "".join(f", boolean in b{at}" for at in range(8))
    text = "package SystemLib.Bitoperations;\ntype Word is integer using uint32;\n"
    text += f"class writeByte {{ public Word getWriteByte(Word in x{arguments}); }}"
    path = write_project(tmp_path, {"Own/SystemLib/Bitoperations/writeByte.esdl": text})
    model = esdl(path / "Own/SystemLib/Bitoperations/writeByte.esdl")
    bits = {f"b{at}": (K * 17 >> at) & 1 for at in range(8)}
    nodes = run(model, {"x": X, **bits})
    assert nodes["getWriteByte"].tolist() == ((X & ~255) | (K * 17 & 255)).tolist()


ASSERTS = """package Own;
stateless class Assert { @symbol("ASSERT_NEAR") public extern void assertNear(real x, real y); }
class Port { integer n = 0; public extern void write(real x); }
class C { Assert assert; Port port; real n = 0.0;
  real count() { n = n + 1.0; return n; }
  public real calc(real in x) { BODY return n + x; } }
"""


def test_calls_of_methods_in_c_that_change_nothing_are_skipped_with_a_remark(tmp_path):
    text = ASSERTS.replace("BODY", "assert.assertNear(count(), 1.0); if (x > 0.0) { assert.assertNear(x, 2.0); }")
    path = write_project(tmp_path, {"Own/Own/C.esdl": text}) / "Own/Own/C.esdl"
    model = esdl(path, "C")
    assert run(model, {"x": [0.5, 0.25]})["calc"].tolist() == [1.5, 2.25]
    assert sum("Own.Assert.assertNear is in C and returns nothing" in str(remark) for remark in model.remarks) == 1


def test_calls_of_a_log_whose_code_is_not_supported_are_skipped(tmp_path):
    text = "package Own;\nstateless class L { @c_code public void log(real x); }\n"
    text += "class C { L l; public real calc(real in x) { l.log(x); return x; } }"
    code = {"Own/Own/C.esdl": text, "Own/Own/L_c_code_snippets/log.c": 'FILE *fp;\nfprintf(fp, "%f", x);'}
    model = esdl(write_project(tmp_path, code) / "Own/Own/C.esdl", "C")
    assert run(model, {"x": [2.0]})["calc"].tolist() == [2.0]
    assert any("Own.L.log is in C and returns nothing" in str(remark) for remark in model.remarks)


def test_a_method_in_c_that_may_change_a_variable_is_not_skipped(tmp_path):
    path = write_project(tmp_path, {"Own/Own/C.esdl": ASSERTS.replace("BODY", "port.write(x);")}) / "Own/Own/C.esdl"
    with pytest.raises(InputError, match=r"Port\.write is implemented in C"):
        esdl(path, "C")
