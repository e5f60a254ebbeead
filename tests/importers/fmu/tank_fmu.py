"""The FMU of `tank_fmu.c`: its model descriptions, its build by the C compiler of this machine, and its formulas."""

import zipfile
from pathlib import Path

import numpy as np

from kennfeld.base.fmi_platform import platform_folder
from tests.importers.fmu.lag_fmu import compile_library

SOURCE = Path(__file__).with_name("tank_fmu.c")
STEP, COUNT = 0.1, 40
VARIABLES = [  # name, causality, variability, type, start
    ("flow", "input", "continuous", "Real", "0"),
    ("mode", "input", "discrete", "Integer", "0"),
    ("open", "input", "discrete", "Boolean", "true"),
    ("y", "output", "continuous", "Real", ""),
    ("steps", "output", "discrete", "Integer", ""),
    ("high", "output", "discrete", "Boolean", ""),
    ("gain", "parameter", "tunable", "Real", "1"),
    ("tau", "parameter", "fixed", "Real", "2"),
    ("level", "parameter", "fixed", "Real", "0"),
    ("fault", "parameter", "fixed", "Real", "0"),
    ("at", "parameter", "fixed", "Real", "1e30"),
]
TYPES_3 = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean"}


def description_2(head):
    named = [*VARIABLES, *((f"table[{i + 1}]", "parameter", "fixed", "Real", "0") for i in range(3))]
    variables = [
        f'<ScalarVariable name="{name}" valueReference="{number}" causality="{causality}" variability="{variability}">'
        f"<{kind}{_start(start)}/></ScalarVariable>"
        for number, (name, causality, variability, kind, start) in enumerate(named, start=1)
    ]
    outputs = "".join(f'<Unknown index="{number}"/>' for number in (4, 5, 6))
    return f"""<?xml version="1.0"?>
<fmiModelDescription fmiVersion="2.0" modelName="tank" guid="{{tank}}">
<CoSimulation modelIdentifier="tank" {head}/>
<DefaultExperiment stepSize="{STEP}"/>
<ModelVariables>{"".join(variables)}</ModelVariables>
<ModelStructure><Outputs>{outputs}</Outputs></ModelStructure>
</fmiModelDescription>"""


def description_3(head):
    variables = [
        f'<{TYPES_3[kind]} name="{name}" valueReference="{number}" causality="{causality}" variability="{variability}"'
        f"{_start(start)}/>"
        for number, (name, causality, variability, kind, start) in enumerate(VARIABLES, start=1)
    ]
    outputs = "".join(f'<Output valueReference="{number}"/>' for number in (4, 5, 6))
    return f"""<?xml version="1.0"?>
<fmiModelDescription fmiVersion="3.0" modelName="tank" instantiationToken="{{tank}}">
<CoSimulation modelIdentifier="tank" {head}/>
<DefaultExperiment stepSize="{STEP}"/>
<ModelVariables>{"".join(variables)}
<Float64 name="table" valueReference="12" causality="parameter" variability="fixed" start="0 0 0"><Dimension start="3"/>
</Float64></ModelVariables>
<ModelStructure>{outputs}</ModelStructure>
</fmiModelDescription>"""


def _start(value):
    return f' start="{value}"' if value else ""


DESCRIPTIONS = {2: description_2, 3: description_3}


def build(folder, version, *options, head='canHandleVariableCommunicationStepSize="true"'):
    """Compile the FMU; skip the test if there is no compiler."""
    library, path = compile_library(SOURCE, folder / "tank.so", version, *options), folder / "tank.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", DESCRIPTIONS[version](head))
        archive.write(library, f"binaries/{platform_folder(f'{version}.0')}/{library.name}")
    return path


def recording(count=COUNT):
    """Return time and inputs."""
    n = np.arange(count)
    return {"time": STEP * n, "flow": 1.0 + np.sin(0.7 * n), "mode": np.full(count, 3.0), "open": (n % 5 > 1) * 1.0}


def closed_form(data, gain=1.0, tau=2.0, level=0.0):
    """Return the level x at the samples."""
    x = [level + data["flow"][0]]
    for flow, is_open, h in zip(data["flow"], data["open"], np.diff(data["time"]), strict=False):
        x.append(x[-1] + h * (flow * gain if is_open else 0.0) - h * x[-1] / tau)
    return np.array(x)
