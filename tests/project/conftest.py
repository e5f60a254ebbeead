"""A small project that is right, and a way to change one thing of it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import kennfeld.calfiles  # noqa: F401  registers the writer of parameter sets
from kennfeld.base.errors import Finding, InputError
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Curve, Scalar
from kennfeld.project import Project
from kennfeld.project.section import KeyLocation
from tests.project.cluster_processes import Cluster

TEXT = """\
input Speed[rpm]
input Load
base[Nm] = Gain(Speed) * Load
Predict[Nm] = base + offset
"""

TOML = """\
[model]
file = "sensor.kf"

[channels]
Speed = "n"

[[dataset]]
files = ["bench.csv"]

[calibration]
initial = "start.json"

[[criterion]]
node = "Predict"
target = "Torque"
"""


class Workshop:
    """A folder with a project; `toml`, `text` and files can be replaced before it is read."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.toml, self.text = TOML, TEXT
        self.bench("bench.csv")
        start = [Curve("Gain", Axis([1000, 2000, 3000], input="Speed"), [1.0, 1.0, 1.0]), Scalar("offset", 0.0)]
        self.values("start.json", *start)

    def bench(self, name: str, speed=(1000, 1500, 2000, 2500, 3000, 1200), **changes) -> None:
        """Write steady-state points of the model with Gain = 1, 2, 3 and offset = 5."""
        n = np.asarray(speed, dtype=float)
        load = 10.0 + np.arange(n.size) % 4
        torque = np.interp(n, [1000, 2000, 3000], [1, 2, 3]) * load + 5
        columns = {"n [rpm]": n, "Load": load, "Torque [Nm]": torque} | changes
        self.csv(name, {key: column for key, column in columns.items() if column is not None})

    def csv(self, name: str, columns) -> None:
        rows = zip(*(np.asarray(column, dtype=float) for column in columns.values()), strict=True)
        lines = [",".join(columns), *(",".join("" if np.isnan(x) else repr(float(x)) for x in row) for row in rows)]
        self.write(name, "\n".join(lines) + "\n")

    def write(self, name: str, content: str | bytes) -> None:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)

    def values(self, name: str, *parameters) -> None:
        ParameterSet(parameters).save(self.folder / name)

    def change(self, old: str, new: str) -> "Workshop":
        """Replace a part of the project file that has to be there."""
        assert old in self.toml
        self.toml = self.toml.replace(old, new)
        return self

    def add(self, text: str) -> "Workshop":
        """Put sections at the end of the project file."""
        self.toml += text if text.startswith("\n") else f"\n{text}\n"
        return self

    @property
    def path(self) -> Path:
        self.write("sensor.kf", self.text)
        self.write("kennfeld.toml", self.toml)
        return self.folder / "kennfeld.toml"

    @property
    def project(self) -> Project:
        return Project.read(self.path)

    def findings(self) -> list[Finding]:
        """Findings of reading or checking. Lines of the project file are compared with its text, and then left out."""
        try:
            findings = self.project.check()
        except InputError as error:
            findings = list(error.findings)
        return [self._without_line(finding) for finding in findings]

    def _without_line(self, finding: Finding) -> Finding:
        location = finding.location
        if not isinstance(location, KeyLocation) or not location.line:
            return finding
        line = self.toml.splitlines()[location.line - 1]
        assert any(word in line for word in re.findall(r"[\w.]+", location.path)), (str(finding), line)
        return replace(finding, location=replace(location, line=0))

    def errors(self) -> list[str]:
        return [str(finding) for finding in self.findings() if finding.severity == "error"]

    def warnings(self) -> list[str]:
        assert self.errors() == []
        return [str(finding) for finding in self.findings()]

    def error(self) -> str:
        """The only error."""
        messages = self.errors()
        assert len(messages) == 1, messages
        return messages[0]

    def warning(self) -> str:
        """The only finding, which is a warning."""
        messages = self.warnings()
        assert len(messages) == 1, messages
        return messages[0]


@pytest.fixture
def shop(tmp_path: Path) -> Workshop:
    return Workshop(tmp_path)


@pytest.fixture
def sound_toml():
    """The text of a project file without a fault."""
    return TOML


@pytest.fixture(scope="module")
def shared_cluster(tmp_path_factory):
    """A cluster of two workers for tests that leave its processes alone; an idle one costs time, a new one hardly."""
    pytest.importorskip("distributed", reason="dask.distributed is not installed: pip install kennfeld[cluster]")
    cluster = Cluster(tmp_path_factory.mktemp("cluster"), 2)
    cluster.wait_for_workers()
    yield cluster
    cluster.close()


@pytest.fixture
def start_cluster(tmp_path):
    """Start clusters of this test alone, whose processes it may kill."""
    clusters = []

    def start(workers):
        clusters.append(Cluster(tmp_path, workers))
        clusters[-1].wait_for_workers()
        return clusters[-1]

    yield start
    for cluster in clusters:
        cluster.close()
