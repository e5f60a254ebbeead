"""`modelDescription.xml` of FMI 2.0."""

from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from kennfeld.base.formatting import one_line
from kennfeld.export.fmu_variables import ExportedVariable, input_dependencies, naming_convention
from kennfeld.export.prepared import PreparedFunction


def fmi2_description(
    function: PreparedFunction, variables: tuple[ExportedVariable, ...], token: str, rule: str, step: float, fixed: bool
) -> str:
    """Return the description; value references are positions among the variables."""
    root = Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=function.name,
        guid=token,
        description=f"{one_line(function.title)}. {rule}",
        generationTool="Kennfeld",
        variableNamingConvention=naming_convention(variables),
        numberOfEventIndicators="0",
    )
    common = {
        "modelIdentifier": function.name,
        "canNotUseMemoryManagementFunctions": "true",
        "canGetAndSetFMUstate": "true",
        "canSerializeFMUstate": "true",
        "providesDirectionalDerivative": "true",
    }
    if offers_model_exchange(function):
        _add_sources(
            SubElement(root, "ModelExchange", {**common, "completedIntegratorStepNotNeeded": "true"}), function
        )
    varying = {"canHandleVariableCommunicationStepSize": "false" if fixed else "true"}
    _add_sources(SubElement(root, "CoSimulation", {**common, **varying}), function)
    add_units(root, variables)
    SubElement(root, "DefaultExperiment", stepSize=repr(step))
    entries = SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        _add_variable(entries, variable, reference)
    _add_structure(root, function, variables)
    return xml_text(root)


def xml_text(root: Element) -> str:
    """Return the text of a document."""
    indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(root, encoding="unicode") + "\n"


def offers_model_exchange(function: PreparedFunction) -> bool:
    """Return True if a function is one of inputs and time alone, without memory and the length of steps."""
    return not function.states and not {"dt", "dt_next"} & set(function.clocks)


def _add_sources(interface: Element, function: PreparedFunction) -> None:
    sources = SubElement(interface, "SourceFiles")
    for name in ("fmi2.c", f"{function.name}.c"):
        SubElement(sources, "File", name=name)


def add_units(root: Element, variables: Sequence[ExportedVariable]) -> None:
    """Declare the units of variables."""
    units = dict.fromkeys(variable.unit for variable in variables if variable.unit)
    if units:
        definitions = SubElement(root, "UnitDefinitions")
        for unit in units:
            SubElement(definitions, "Unit", name=unit)


def _add_variable(entries: Element, variable: ExportedVariable, reference: int) -> None:
    attributes = {"name": variable.name, "valueReference": str(reference)}
    if variable.description:
        attributes["description"] = variable.description
    attributes["causality"] = variable.causality
    attributes["variability"] = "tunable" if variable.causality == "parameter" else "continuous"
    if variable.causality != "input":
        attributes["initial"] = "exact" if variable.causality == "parameter" else "calculated"
    real = SubElement(SubElement(entries, "ScalarVariable", attributes), "Real")
    if variable.unit:
        real.set("unit", variable.unit)
    if variable.start is not None:
        real.set("start", repr(float(variable.start)))


def _add_structure(root: Element, function: PreparedFunction, variables: Sequence[ExportedVariable]) -> None:
    structure = SubElement(root, "ModelStructure")
    index = {(v.name, v.causality): number for number, v in enumerate(variables, start=1)}
    outputs = SubElement(structure, "Outputs")
    for at, signal in enumerate(function.outputs):
        used = [str(index[name, "input"]) for name in input_dependencies(function, at)]
        SubElement(outputs, "Unknown", index=str(index[signal.name, "output"]), dependencies=" ".join(used))
    initial = SubElement(structure, "InitialUnknowns")
    for signal in function.outputs:
        SubElement(initial, "Unknown", index=str(index[signal.name, "output"]))
