"""Small projects with functions in C, Python and ONNX files."""

from pathlib import Path

C_FILE = """/* a filter and a gain */
double lag(double x, double T, double dt)
{
    static int started = 0;
    static double y;
    if (!started) { y = x; started = 1; }
    y += dt / (T + dt) * (x - y);
    return y;
}

double twice(double x) { return 2 * x; }
"""
TRANSLATED = '''"""A file that does not run."""

from pathlib import Path

Path(__file__).with_name("ran").touch()


def gain(x, offset=1.0):
    return 3 * x + offset
'''
CALLED = """from pathlib import Path

Path(__file__).with_name("ran").touch()


def table(x, k=2.0):
    return {0: k * x}[0]
"""


def write_functions(folder: Path, text: str = "y = K * u\n", functions: str = "", file: str = "torque.kf") -> Path:
    """Write a project with samples of u and wanted = 3 u + 1, and a C and two Python files; return its project file."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "engine.c").write_text(C_FILE)
    (folder / "gain.py").write_text(TRANSLATED)
    (folder / "table.py").write_text(CALLED)
    (folder / "torque.kf").write_text(text)
    (folder / "bench.csv").write_text(
        "\n".join(["time,u,wanted", *(f"{u / 10},{u},{3 * u + 1}" for u in range(1, 9)), ""])
    )
    (folder / "kennfeld.toml").write_text(
        f'[model]\nfile = "{file}"\n{functions}\n[[dataset]]\nfiles = "bench.csv"\n'
        '[[criterion]]\nnode = "y"\ntarget = "wanted"\n[parameters.K]\ninitial = 1.0\n'
    )
    return folder / "kennfeld.toml"


PRODUCT = """\
model.file = "f.kf"
[[dataset]]
files = "d.csv"
[[criterion]]
node = "m"
target = "y"
[parameters.A]
initial = 2.0
[parameters.B]
initial = 1.0
"""


def write_product(folder: Path) -> Path:
    """Write a project whose two factors no data tell apart, and return its file."""
    folder.mkdir()
    (folder / "f.kf").write_text("input x\nm = A * B * x\n", encoding="utf-8")
    rows = "".join(f"{x},{3 * x + (-1) ** x}\n" for x in range(20))
    (folder / "d.csv").write_text(f"x,y\n{rows}", encoding="utf-8")
    (folder / "kennfeld.toml").write_text(PRODUCT, encoding="utf-8")
    return folder / "kennfeld.toml"
