"""`modelDescription.xml` and `buildDescription.xml` of FMI 3.0."""

from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement

from kennfeld.base.formatting import one_line
from kennfeld.export.fmi2_description import add_units, offers_model_exchange, xml_text
from kennfeld.export.fmu_variables import ExportedVariable, input_dependencies, naming_convention
from kennfeld.export.prepared import PreparedFunction


def fmi3_description(
    function: PreparedFunction, variables: tuple[ExportedVariable, ...], token: str, rule: str, step: float, fixed: bool
) -> str:
    """Return the description; value references are positions among the variables."""
    root = Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=function.name,
        instantiationToken=token,
        description=f"{one_line(function.title)}. {rule}",
        generationTool="Kennfeld",
        variableNamingConvention=naming_convention(variables),
    )
    common = {
        "modelIdentifier": function.name,
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        "providesDirectionalDerivatives": "true",
    }
    if offers_model_exchange(function):
        SubElement(root, "ModelExchange", {**common, "needsCompletedIntegratorStep": "false"})
    SubElement(root, "CoSimulation", {**common, "canHandleVariableCommunicationStepSize": str(not fixed).lower()})
    add_units(root, variables)
    SubElement(root, "DefaultExperiment", stepSize=repr(step))
    entries = SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        _add_variable(entries, variable, reference)
    _add_structure(root, function, variables)
    return xml_text(root)


def build_description(name: str) -> str:
    """Return how the sources of the FMU are compiled."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    files = SubElement(SubElement(root, "BuildConfiguration", modelIdentifier=name), "SourceFileSet", language="C99")
    for file in ("fmi3.c", f"{name}.c"):
        SubElement(files, "SourceFile", name=file)
    return xml_text(root)


def _add_variable(entries: Element, variable: ExportedVariable, reference: int) -> None:
    attributes = {"name": variable.name, "valueReference": str(reference)}
    if variable.description:
        attributes["description"] = variable.description
    attributes["causality"] = variable.causality
    attributes["variability"] = "tunable" if variable.causality == "parameter" else "continuous"
    if variable.causality in ("output", "parameter"):
        attributes["initial"] = "exact" if variable.causality == "parameter" else "calculated"
    if variable.unit:
        attributes["unit"] = variable.unit
    if variable.start is not None:
        attributes["start"] = " ".join(repr(float(x)) for x in variable.start.ravel())
    entry = SubElement(entries, "Float64", attributes)
    for size in variable.start.shape if variable.start is not None else ():
        SubElement(entry, "Dimension", start=str(size))


def _add_structure(root: Element, function: PreparedFunction, variables: Sequence[ExportedVariable]) -> None:
    structure = SubElement(root, "ModelStructure")
    reference = {(v.name, v.causality): number for number, v in enumerate(variables)}
    for at, signal in enumerate(function.outputs):
        used = [str(reference[name, "input"]) for name in input_dependencies(function, at)]
        own = str(reference[signal.name, "output"])
        SubElement(structure, "Output", valueReference=own, dependencies=" ".join(used))
    # first outputs may depend on all that is known then; some tools require that it is said
    known = " ".join(str(number) for (_, causality), number in reference.items() if causality != "output")
    for signal in function.outputs:
        own = str(reference[signal.name, "output"])
        SubElement(structure, "InitialUnknown", valueReference=own, dependencies=known)
