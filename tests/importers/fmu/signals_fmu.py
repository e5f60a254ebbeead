"""The FMU of `signals_fmu.c`: integers, booleans and enumerations, without continuous states."""

from pathlib import Path

from tests.importers.fmu.lag_fmu import compile_library, pack

SOURCE = Path(__file__).with_name("signals_fmu.c")
_VARIABLES = (
    ("gain", 1, "Real", 'causality="parameter" variability="tunable"', 'start="1"'),
    ("gear", 2, "Integer", 'causality="input"', 'start="0" min="-3" max="6"'),
    ("on", 3, "Boolean", 'causality="input"', 'start="false"'),
    ("mode", 4, "Enumeration", 'causality="input"', 'start="1" declaredType="Mode"'),
    ("y", 5, "Real", 'causality="output"', ""),
    ("same", 6, "Integer", 'causality="output"', ""),
    ("lit", 7, "Boolean", 'causality="output"', ""),
    ("chosen", 8, "Enumeration", 'causality="output"', 'declaredType="Mode"'),
)
_VARIABLES_3 = (
    ("narrow", 9, "Float32", 'causality="input"', 'start="0"'),
    ("level", 10, "UInt8", 'causality="input"', 'start="0"'),
    ("small", 11, "Float32", 'causality="output"', ""),
)
_NAMES_3 = {"Real": "Float64", "Integer": "Int32"}


def description(version, interfaces):
    """Return the model description of FMI 2.0 or 3.0."""
    variables = _VARIABLES if version == 2 else (*_VARIABLES, *_VARIABLES_3)
    if version == 2:
        lines = [
            f'<ScalarVariable name="{name}" valueReference="{reference}" {words}><{kind} {rest}/></ScalarVariable>'
            for name, reference, kind, words, rest in variables
        ]
        outputs = [f'<Unknown index="{k}"/>' for k in (5, 6, 7, 8)]
        structure, head = f"<Outputs>{''.join(outputs)}</Outputs>", 'guid="{signals}"'
    else:
        lines = [
            f'<{_NAMES_3.get(kind, kind)} name="{name}" valueReference="{reference}" {words} {rest}/>'
            for name, reference, kind, words, rest in variables
        ]
        structure = "".join(f'<Output valueReference="{k}"/>' for k in (5, 6, 7, 8, 11))
        head = 'instantiationToken="{signals}"'
    return f"""<?xml version="1.0"?>
<fmiModelDescription fmiVersion="{version}.0" modelName="signals" {head}>
<ModelExchange modelIdentifier="signals"/>{interfaces}
<ModelVariables>{"".join(lines)}</ModelVariables>
<ModelStructure>{structure}</ModelStructure>
</fmiModelDescription>"""


def build_signals(folder, version, *options, interfaces=""):
    """Compile the FMU; skip the test if there is no compiler."""
    library = compile_library(SOURCE, folder / "signals.so", version, *options)
    return pack(folder / "signals.fmu", description(version, interfaces), library=library, version=version)
