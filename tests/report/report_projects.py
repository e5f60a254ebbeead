"""Projects that a report has to cope with, and the way to what a report embeds."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from kennfeld.project import Project
from kennfeld.report import document

CRITERION = '\n[[criterion]]\nnode = "y"\ntarget = { channel = "m" }\n'


class Workshop:
    """A folder in which projects are written."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def csv(self, name: str, columns) -> None:
        rows = zip(*(np.asarray(column, dtype=float) for column in columns.values()), strict=True)
        lines = [",".join(columns), *(",".join("" if np.isnan(x) else repr(float(x)) for x in row) for row in rows)]
        (self.folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")

    def project(self, text: str, toml: str, columns, *, test=None, criterion: str = CRITERION) -> Project:
        (self.folder / "model.kf").write_text(text, encoding="utf-8")
        self.csv("bench.csv", columns)
        head = '[model]\nfile = "model.kf"\n\n[[dataset]]\nfiles = ["bench.csv"]\n'
        if test is not None:
            self.csv("fresh.csv", test)
            head += '\n[[dataset]]\nfiles = ["fresh.csv"]\nuse = "test"\n'
        (self.folder / "kennfeld.toml").write_text(head + criterion + toml, encoding="utf-8")
        return Project.read(self.folder / "kennfeld.toml")


def scattered(count=300, seed=0):
    rng = np.random.default_rng(seed)
    x, z = rng.uniform(0, 10, count), rng.uniform(0, 5, count)
    return {"x": x, "z": z, "m": x * (1 + 0.1 * z) + rng.normal(0, 0.1, count)}


def a_map(shop):
    toml = '[parameters.M]\nx = { input = "x", count = 5 }\ny = { input = "z", count = 4 }\ninitial = 1.0\n'
    toml += "bounds = [0, 12]\nsmoothness = 0.01\n"
    return shop.project("y[Nm] = M(x, z)\n", toml, scattered(), test=scattered(100, 1))


def scalars(shop):
    return shop.project("y = a + b * x\n", "[parameters.a]\ninitial = 0\n[parameters.b]\ninitial = 0\n", scattered())


def a_cube(shop):
    directions = zip("xyz", "xzw", strict=True)
    axes = "".join(f'{d} = {{ input = "{n}", begin = 0, end = 10, count = 3 }}\n' for d, n in directions)
    toml = f"[parameters.C]\n{axes}initial = 0\nsmoothness = 0.1\n"
    return shop.project("y = C(x, z, w)\n", toml, scattered() | {"w": scattered(300, 2)["x"]})


def a_network(shop):
    """A network with one free layer of two inputs and three neurons; needs the package onnx."""
    from tests.importers.onnx.networks import perceptron, random_layers

    perceptron(shop.folder / "net.onnx", random_layers([2, 3, 1]))
    toml = '[functions]\nnet = "net.onnx"\n[parameters."net.layer1"]\nfree = true\n'
    return shop.project("y = net(x / 10, z / 5)\n", toml, scattered())


def missing_targets(shop):
    data = scattered()
    data["m"][::3] = np.nan
    toml = '[parameters.C]\nx = { input = "x", begin = 0, end = 40, count = 9 }\ninitial = 1\n'
    return shop.project("y = C(x) + 0*z\n", toml, data)


def one_sample(shop):
    return shop.project("y = a + 0*x\n", "[parameters.a]\ninitial = 0\n", {"x": [1.0], "m": [2.0]})


def a_failed_fit(shop):
    data = {"x": [1.0, 2.0], "m": [1.0, 2.0]}
    return shop.project("y = log(0 * x) + a * x\n", "[parameters.a]\ninitial = 1\n", data)


def recordings(shop):
    time = np.arange(600) * 0.1
    x = np.sign(np.sin(time)) + 2
    t = np.empty(600)
    state = x[0]
    for k in range(600):
        state += 0.1 / 1.1 * (2 * x[k] - state)
        t[k] = state
    toml = '[parameters.C]\nx = { input = "x", begin = 0, end = 4, count = 3 }\ninitial = 1\n'
    toml += "[parameters.T]\ninitial = 2\nbounds = [0.5, 5]\n"
    return shop.project("y = PT1(C(x), T)\n", toml, {"time [s]": time, "x": x, "m": t})


def two_criteria(shop):
    criterion = CRITERION + '\n[[criterion]]\nnode = "y"\ntarget = 3.0\nweight = 0.1\n'
    criterion += '\n[[criterion]]\nnode = "v"\ntarget = { node = "w" }\n'
    toml = "[parameters.a]\ninitial = 1\n[parameters.b]\ninitial = 1\n"
    return shop.project("y = a * x\nv = a + b\nw = 2 * x\n", toml, scattered(), criterion=criterion)


def kept_values(shop):
    toml = '[calibration]\nfree = ["M"]\n[parameters.M]\nx = { input = "x", begin = 0, end = 30, count = 7 }\n'
    toml += 'y = { input = "z", breakpoints = [1] }\ninitial = 1\nlock = [{ x = [0, 1] }]\n'
    toml += "pin = [{ at = [10, 1], value = 11 }]\n[parameters.k]\ninitial = 0\n"
    toml += "[parameters.B]\nx = { breakpoints = [0, 1] }\ninitial = 0\n"
    return shop.project("y = M(x, z) + k + B(x)\n", toml, scattered())


def limited(shop):
    toml = '[parameters.C]\nx = { input = "x", begin = 0, end = 10, count = 6 }\ninitial = 1\n'
    toml += "gradient = { x = [0, 1.1] }\n[parameters.k]\ninitial = 0\n"
    limits = '\n[[limit]]\nnode = "y - z"\nmax = 11.0\nwhere = "x > 2"\n'
    equal = '\n[[equality]]\nterms = [{ parameter = "C", at = [0] }, { parameter = "k" }]\nvalue = 0.1\n'
    return shop.project("y = C(x) + k\n", toml, scattered(), criterion=CRITERION + limits + equal)


def several_files(shop):
    """A drive in each of 15 files; the errors grow from file to file, and are largest from 30 to 40 s."""
    for number in range(15):
        time = np.arange(300) * 0.2
        x = 2 + np.sin(time + number)
        error = 0.01 * (number + 1) * np.where((time >= 30) & (time < 40), 3.0, 1.0)
        shop.csv(f"drive_{number:02d}.csv", {"time": time, "x": x, "m": 2 * x + error * np.sign(np.sin(40 * time))})
    project = shop.project("y = a * x\n", "[parameters.a]\ninitial = 1\n", scattered(), test=scattered(100, 1))
    text = project.path.read_text(encoding="utf-8").replace('["bench.csv"]', '["drive_*.csv"]')
    project.path.write_text(text, encoding="utf-8")
    return Project.read(project.path)


PROJECTS = [
    several_files,
    limited,
    a_map,
    scalars,
    a_cube,
    missing_targets,
    one_sample,
    a_failed_fit,
    recordings,
    two_criteria,
    kept_values,
]


class CalibratedProject:
    """A project, its result and its report."""

    def __init__(self, project: Project) -> None:
        self.project, self.result = project, project.calibrate()
        self.report = document(project, self.result, project.check())


class Page(HTMLParser):
    """A report taken apart: its text by element, its data, and everything that could load something."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.text, self.tags, self.addresses, self.words = text, [], [], []
        self._open: list[str] = []
        self.policy = ""
        self.feed(text)
        self.data = json.loads(re.search(r'<script type="application/json"[^>]*>(.*?)</script>', text, re.DOTALL)[1])

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [value for name, value in attrs if name in ("src", "href", "data", "action", "srcset")]
        if ("http-equiv", "Content-Security-Policy") in attrs:
            self.policy = dict(attrs)["content"]
        if tag not in ("meta", "br", "input"):
            self._open.append(tag)

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        if not {"script", "style"} & set(self._open):
            self.words.append(data)

    def figures(self, kind):
        return [figure for figure in self.data["figures"] if figure["kind"] == kind]

    @property
    def words_in_a_row(self) -> str:
        return " ".join(" ".join(self.words).split())
