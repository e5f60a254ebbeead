"""Blocks of toolboxes that are not part of a model: physical networks, and libraries by their product."""

import pytest

from kennfeld.importers.simulink.importing import import_simulink
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import run


def plant():
    """Two signals out of a physical network, and a block within it."""
    drawn = Model(solver="FixedStepDiscrete", step="0.1")
    drawn.inport("u")
    drawn.link("In", "nesl_utility/Simulink-PS Converter")
    drawn.link("Mass", "fl_lib/Thermal/Thermal Elements/Thermal Mass", ports=(0, 0))
    for at in (1, 2):
        drawn.link(f"Out{at}", "nesl_utility/PS-Simulink Converter", ports=(0, 1))
        drawn.block("Gain", f"G{at}", Gain="2")
        drawn.outport(f"y{at}")
        drawn.chain(f"Out{at}", f"G{at}", f"y{at}")
    drawn.chain("u", "In")
    return drawn


def test_a_physical_network_is_named_once_with_the_binds_of_its_outputs(tmp_path):
    report = import_simulink(plant().write(tmp_path)).report
    (finding,) = map(str, report.findings)
    assert finding == (
        "Out1 and 1 more: it belongs to a physical network of Simscape, which cannot be calibrated. "
        'Bind its outputs: bind = { "Out1" = "channel or formula", "Out2" = "channel or formula" }.'
    )
    assert {block.path for block in report.unsupported if not block.stops} == {"In", "Mass"}


def test_with_these_binds_the_model_imports(tmp_path):
    model = import_simulink(plant().write(tmp_path), bind={"Out1": "T", "Out2": "p + 1"}).require_model()
    outputs = run(model, {"T": [1.0], "p": [2.0]})
    assert (outputs["y1"][0], outputs["y2"][0]) == (2.0, 6.0)


def linked(source):
    drawn = Model(solver="FixedStepDiscrete", step="0.1")
    drawn.inport("u")
    drawn.link("B", source)
    drawn.outport("y")
    drawn.chain("u", "B", "y")
    return drawn


@pytest.mark.parametrize(
    ("library", "product", "folder"),
    [
        ("dspstat3", "DSP System Toolbox", "dsp"),
        ("aerolibatmos2", "Aerospace Blockset", "aeroblks"),
        ("autolibshared", "Powertrain Blockset", "autoblks"),
        ("pePmsmTorqueEstimator", "Simscape Electrical", "physmod"),
    ],
)
def test_a_library_of_a_toolbox_is_named_with_its_folder(library, product, folder, tmp_path):
    (finding,) = map(str, import_simulink(linked(f"{library}/X").write(tmp_path)).report.findings)
    assert f"B: it links to the library {library} of {product}, which was not found." in finding
    assert f"Add its folder below matlabroot/toolbox/{folder} to `folders`" in finding


def test_an_own_library_elsewhere_in_the_project_is_proposed_by_its_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "kennfeld.toml").write_text("")
    library = Model("own", kind="Library")
    inner = library.subsystem("Twice")
    inner.inport("u")
    inner.block("Gain", "G", Gain="2")
    inner.outport("y")
    inner.chain("u", "G", "y")
    for folder in ("lib", "models"):
        (tmp_path / folder).mkdir()
    library.write(tmp_path / "lib")
    path = linked("own/Twice").write(tmp_path / "models")
    proposal, missing = map(str, import_simulink(path).report.findings)
    assert proposal.startswith(
        "B: needs own.slx, which is in lib. Add it with --folder lib, or to folders under [model]"
    )
    assert missing.startswith("B: it links to the library own, which was not found in models.")
    assert import_simulink(path, folders=["lib"]).report.whole
