"""Files for the examples in docstrings: those that name a file run in a folder that has it."""

import shutil
from pathlib import Path

import pytest

NAMES = (
    *("kennfeld.toml", "torque.kf", "bench.csv", "fresh.csv", "start.dcm"),
    *("engine.slx", "knock.onnx", "lag.fmu", "Plant.esdl", "engine.json", "missing."),
)


@pytest.fixture(scope="session")
def example_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the torque demo, a Simulink model, an ESDL class and an FMU."""
    from kennfeld.project.demo import write
    from tests.importers.ascet.esdl_projects import BATTERY, write_project
    from tests.importers.fmu.lag_fmu import description_2, pack
    from tests.importers.simulink.simulink_files import Model

    folder = tmp_path_factory.mktemp("examples") / "torque"
    write("torque", folder)
    model = Model("engine")
    model.inport("n")
    model.block("Gain", "Times", Gain="Slope")
    model.block("Bias", "Plus", Bias="1")
    model.outport("y")
    model.chain("n", "Times", "Plus", "y")
    model.write(folder, "slx parts")
    write_project(folder, BATTERY)
    library = folder / "lag.so"
    library.touch()  # examples read its description and do not run it
    pack(folder / "lag.fmu", description_2(), library=library)
    return folder


@pytest.fixture(autouse=True)
def example_folder(request: pytest.FixtureRequest) -> None:
    """Run an example in a folder of its own: a copy of the files if it names one of them."""
    if not isinstance(request.node, pytest.DoctestItem):
        return
    source = "".join(example.source for example in request.node.dtest.examples)
    folder = request.getfixturevalue("tmp_path") / "work"
    if any(name in source for name in NAMES):
        shutil.copytree(request.getfixturevalue("example_files"), folder)
    else:
        folder.mkdir()
    if "knock.onnx" in source:
        pytest.importorskip("onnx")
        from tests.importers.onnx.networks import perceptron, random_layers

        perceptron(folder / "knock.onnx", random_layers([2, 4, 1]))
    request.getfixturevalue("monkeypatch").chdir(folder)
