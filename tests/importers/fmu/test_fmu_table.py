"""The script that compares FMUs with FMPy."""

import importlib.util
from pathlib import Path

import pytest

from tests.importers.fmu import tank_fmu

pytest.importorskip("fmpy", reason="FMPy is not installed")
SCRIPT = Path(__file__).parents[3] / "scripts/fmu_table.py"
SPEC = importlib.util.spec_from_file_location("fmu_table", SCRIPT)
fmu_table = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(fmu_table)


@pytest.mark.parametrize("version", [2, 3])
def test_outputs_of_all_types_are_compared(tmp_path, version):
    row = fmu_table.compare(tank_fmu.build(tmp_path, version), "co-simulation")
    assert (row["version"], row["outputs"]) == (f"{version}.0", "3")
    assert float(row["result"].split()[0]) < 1e-9


def test_the_reason_of_a_refusal_is_shown(tmp_path):
    row = fmu_table.compare(tank_fmu.build(tmp_path, 2), "model exchange")
    assert row["result"] == "offers co-simulation only, not model exchange"
