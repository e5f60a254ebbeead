"""The FMU of `lag_fmu.c`: its model descriptions, and its build by the C compiler of this machine."""

import shutil
import subprocess
import tempfile
import zipfile
from functools import cache
from itertools import product
from pathlib import Path

import pytest

from kennfeld.base.fmi_platform import platform_folder
from kennfeld.importers.fmu.importing import fmu

TABLE = list(product((1, 2), (1, 2, 3)))
_EXACT = 'initial="exact"'
SOURCE = Path(__file__).with_name("lag_fmu.c")


def description_2(head='providesDirectionalDerivative="true"', indicators=0, start="", table=TABLE, lift=False):
    def variable(reference, name, rest, real=""):
        return f'<ScalarVariable name="{name}" valueReference="{reference}" {rest}><Real {real}/></ScalarVariable>'

    fixed, tunable = (f'causality="parameter" variability="{word}"' for word in ("fixed", "tunable"))
    values = [
        variable(7 + k, f"table[{i},{j}]", tunable, f'start="{k}" min="-5" max="{5 + k}"')
        for k, (i, j) in reversed(list(enumerate(table)))
    ]
    variables = [
        variable(0, "time", 'causality="independent"'),
        variable(1, "x", f'causality="local" {_EXACT if start else ""}', start),
        variable(2, "der(x)", 'causality="local"', 'derivative="2"'),
        variable(3, "u", 'causality="input"', 'start="0" unit="Nm"'),
        variable(4, "y", 'causality="output"', 'declaredType="Torque"'),
        variable(5, "tau", fixed, 'start="2" min="0.01" max="10" unit="s"'),
        variable(6, "k", tunable, 'start="1"'),
        *values,
        *([variable(40, "lift", f'causality="local" {_EXACT}', 'start="0.35"')] if lift else []),
    ]
    return f"""<?xml version="1.0"?>
<fmiModelDescription fmiVersion="2.0" modelName="lag" guid="{{lag}}" numberOfEventIndicators="{indicators}">
<ModelExchange modelIdentifier="lag" {head}/>
<TypeDefinitions><SimpleType name="Torque"><Real unit="Nm"/></SimpleType></TypeDefinitions>
<DefaultExperiment stepSize="0.1"/>
<ModelVariables>{"".join(variables)}</ModelVariables>
<ModelStructure><Outputs><Unknown index="5" dependencies="2"/></Outputs>
<Derivatives><Unknown index="3" dependencies="2 4"/></Derivatives></ModelStructure>
</fmiModelDescription>"""


def description_3(head='providesDirectionalDerivatives="true"', indicators=0, start="", lift=False):
    fixed, tunable = (f'causality="parameter" variability="{word}"' for word in ("fixed", "tunable"))
    return f"""<?xml version="1.0"?>
<fmiModelDescription fmiVersion="3.0" modelName="lag" instantiationToken="{{lag}}">
<ModelExchange modelIdentifier="lag" {head}/>
<TypeDefinitions><Float64Type name="Torque" unit="Nm"/></TypeDefinitions>
<DefaultExperiment stepSize="0.1"/>
<ModelVariables>
<Float64 name="time" valueReference="0" causality="independent"/>
<Float64 name="x" valueReference="1" causality="local" {_EXACT if start else ""} {start}/>
<Float64 name="der(x)" valueReference="2" causality="local" derivative="1"/>
<Float64 name="u" valueReference="3" causality="input" start="0" unit="Nm"/>
<Float64 name="y" valueReference="4" causality="output" declaredType="Torque"/>
<Float64 name="tau" valueReference="5" {fixed} start="2" min="0.01" max="10" unit="s"/>
<Float64 name="k" valueReference="6" {tunable} start="1"/>
<UInt64 name="columns" valueReference="20" causality="structuralParameter" variability="fixed" start="3"/>
<Float64 name="table" valueReference="7" {tunable} start="0 1 2 3 4 5"><Dimension start="2"/>
<Dimension valueReference="20"/></Float64>
{f'<Float64 name="lift" valueReference="40" causality="local" {_EXACT} start="0.35"/>' * lift}</ModelVariables>
<ModelStructure><Output valueReference="4" dependencies="1"/>
<ContinuousStateDerivative valueReference="2" dependencies="1 3"/>
{'<EventIndicator valueReference="1"/>' * indicators}</ModelStructure>
</fmiModelDescription>"""


DESCRIPTIONS = {2: description_2, 3: description_3}


def pack(path, description, members=(), library=None, version=2):
    """Write an FMU with this description."""
    folder = platform_folder(f"{version}.0")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", description)
        for name, content in dict(members).items():
            archive.writestr(name, content)
        if library is not None:
            archive.write(library, f"binaries/{folder}/{library.name}")
    return path


def compile_library(source, library, version, *options):
    """Write the library of a C source; skip the test if there is no compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("needs a C compiler")
    library.write_bytes(_compiled(compiler, source, f"-DFMI={version}", *options))
    return library


@cache
def _compiled(compiler, source, *options):
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "library.so"
        command = [compiler, "-shared", "-fPIC", "-O1", "-w", *options, "-o", library, source, "-lm"]
        subprocess.run(command, check=True)
        return library.read_bytes()


def build(folder, version, *options, **description):
    """Compile the FMU; skip the test if there is no compiler."""
    library = compile_library(SOURCE, folder / "lag.so", version, *options)
    return pack(folder / "lag.fmu", DESCRIPTIONS[version](**description), library=library, version=version)


def equations_of(path):
    """Return the function by which the graph of an imported FMU evaluates its equations."""
    model = fmu(path)
    functions = [node.payload.function for node in model.graph.nodes if node.op == "external"]
    return next(function for function in functions if "load_equations" in function.loader)
