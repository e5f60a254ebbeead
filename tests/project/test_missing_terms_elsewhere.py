"""Functions that are not formula text: node and line of a missing term are named, and their source stays as it is."""

import numpy as np
import pytest

from kennfeld import Project, cli

SOURCES = {
    "engine.c": """const volatile double k = 0.4;

double torque(double load, double speed)
{
    return 2.0 * load - k * speed;
}
""",
    "engine.py": "def torque(load, speed, k):\n    return 2.0 * load - k * speed\n",
}
PROJECT = """[model]
file = "{model}"

[[dataset]]
name = "bench"
files = ["bench.csv"]

[[criterion]]
node = "torque"
target = {{ channel = "m" }}
"""
pytestmark = pytest.mark.guests


def write_bench(folder, file, model, more=""):
    rng = np.random.default_rng(0)
    load, speed, oil = rng.uniform(0, 1, (3, 200))
    m = 2 * load - 0.5 * speed - 0.4 * oil**2 + 0.005 * rng.normal(size=200)
    table = np.column_stack([load, speed, oil, m])
    np.savetxt(folder / "bench.csv", table, "%.6f", ",", header="load,speed,oil,m", comments="")
    (folder / file).write_text(SOURCES[file], encoding="utf-8")
    path = folder / "kennfeld.toml"
    path.write_text(PROJECT.format(model=model) + more, encoding="utf-8")
    return path


def test_a_proposal_for_a_function_in_c_says_what_to_add_and_writes_nothing(tmp_path, capsys):
    path = write_bench(tmp_path, "engine.c", "engine.c:torque")
    before = {each: each.read_bytes() for each in (path, tmp_path / "engine.c")}
    assert cli.run(["propose", str(path), "--kind", "add", "--channel", "oil", "--apply", "1"]) == 2
    error = capsys.readouterr().err
    assert "engine.c:torque is not formula text, into which terms are written; nothing was changed" in error
    assert "Add a curve of oil to torque where the function was made: node torque" in error
    assert "As formula text: torque = torque + AddTorqueOil(oil)" in error
    assert {each: each.read_bytes() for each in before} == before
    assert not (tmp_path / ".kennfeld" / "kennfeld" / "proposals.json").exists()


CALLS = {"engine.c": "engine(load, speed)", "engine.py": "engine(load, speed, k)"}


@pytest.mark.parametrize("file", list(SOURCES))
def test_a_term_around_a_call_is_written_into_the_formula_and_not_into_the_function(tmp_path, file):
    value = "\n[parameters.k]\ninitial = 0.4\n" if file.endswith(".py") else ""
    path = write_bench(tmp_path, file, "f.kf", f'\n[functions]\nengine = "{file}:torque"\n{value}')
    (tmp_path / "f.kf").write_text(f"torque[Nm] = {CALLS[file]}\n", encoding="utf-8")
    project = Project.read(path)
    proposal = project.propose(kinds=["add"], channels=["oil"])[0]
    assert set(project.apply(proposal)) == {tmp_path / "f.kf", path}
    assert (tmp_path / "f.kf").read_text(encoding="utf-8") == f"torque[Nm] = {CALLS[file]} + AddTorqueOil(oil)\n"
    assert (tmp_path / file).read_text(encoding="utf-8") == SOURCES[file]
    assert Project.read(path).calibrate().quality[0].rmse_after == pytest.approx(proposal.rmse.after, rel=1e-3)
