"""Reader of `modelDescription.xml` of FMI 2.0 and 3.0."""

import math
from collections.abc import Iterator, Mapping, Sequence

from kennfeld.base.errors import Findings, InputError, Location
from kennfeld.base.garbage_collection import no_collection
from kennfeld.base.xml_document import XmlElement, XmlLimits, parse_xml
from kennfeld.importers.fmu.description import REAL_TYPES, Dependency, FmuDescription, FmuInterface, FmuVariable
from kennfeld.importers.fmu.number_types import number_type

MOST_VALUES = 1_000_000  # of all arrays together
MOST_REFERENCE = 2**32 - 1
_TYPES_2 = ("Real", "Integer", "Boolean", "String", "Enumeration")
_VERSIONS = {"2": "2.0", "3": "3.0"}
_BOOLEANS = {"false": 0.0, "true": 1.0}
_EXPORT = "Export the FMU again."
LIMITS = XmlLimits(
    size=300_000_000,
    levels=50,
    elements=1_000_000,  # several for each variable
    children=200_000,
    reduced="Export the FMU without its local variables.",
    complete=_EXPORT,
    keeps_text=False,
)


def read_description(raw: bytes, file: str, platforms: Sequence[str]) -> FmuDescription:
    """Read what a model description states.

    Args:
        raw: the contents of `modelDescription.xml`.
        file: name of the FMU, for messages.
        platforms: platforms for which the FMU has libraries.

    Raises:
        InputError: the description is of another version, is damaged, or exceeds the limits.
    """
    with no_collection():
        root = parse_xml(raw, f"{file}/modelDescription.xml", LIMITS)
        return _Reader(root, f"{file}/modelDescription.xml").description(tuple(platforms))


class _Reader:
    def __init__(self, root: XmlElement, file: str) -> None:
        self.root, self.file = root, file
        self.findings = Findings()
        version = root.attributes.get("fmiVersion", "")
        if root.tag != "fmiModelDescription" or version.partition(".")[0] not in _VERSIONS:
            message = f"FMI {version or 'of no version'} is not supported"
            raise InputError.of(Location(file, root.line), message, "Export the FMU as FMI 2.0 or 3.0.")
        self.version = _VERSIONS[version.partition(".")[0]]
        self.types = dict(self._declared_types())

    def description(self, platforms: tuple[str, ...]) -> FmuDescription:
        root, second = self.root.attributes, self.version == "2.0"
        variables = self._variables()
        structure = self.root.first("ModelStructure") or XmlElement("ModelStructure", {}, 0)
        outputs = _unknowns(structure, "Outputs") if second else structure.all("Output")
        derivatives = _unknowns(structure, "Derivatives") if second else structure.all("ContinuousStateDerivative")
        experiment = self.root.first("DefaultExperiment")
        step = None if experiment is None else self._number(experiment, "stepSize", math.nan)
        description = FmuDescription(
            version=self.version,
            name=root.get("modelName", ""),
            token=root.get("guid" if second else "instantiationToken", ""),
            tool=root.get("generationTool", ""),
            model_exchange=self._interface("ModelExchange"),
            co_simulation=self._interface("CoSimulation"),
            variables=variables,
            outputs=self._dependencies(outputs, variables),
            derivatives=self._dependencies(derivatives, variables),
            indicators=self._indicators(structure),
            step=step if step is not None and 0 < step < math.inf else None,
            discrete=self._discrete() if self.version == "3.0" else (),
            platforms=platforms,
        )
        self._check_names(variables)
        if not self.findings.has_errors:
            self._check_derivatives(description)
        self.findings.finish()
        return description

    def _indicators(self, structure: XmlElement) -> int:
        if self.version == "2.0":
            return int(self._number(self.root, "numberOfEventIndicators", 0.0))
        return sum(1 for _ in structure.all("EventIndicator"))

    def _discrete(self) -> tuple[str, ...]:
        elements = (element for part in self.root.all("ModelVariables") for element in part.children)
        return tuple(e.attributes.get("name", "") for e in elements if "previous" in e.attributes)

    def _interface(self, tag: str) -> FmuInterface | None:
        element = self.root.first(tag)
        if element is None:
            return None
        identifier = element.attributes.get("modelIdentifier", "")
        if not identifier.replace("_", "a").isalnum():
            self._error(element, f"invalid modelIdentifier {identifier[:60]!r}")
        directional = "providesDirectionalDerivative" + "s" * (self.version == "3.0")
        names = (
            directional,
            "needsExecutionTool",
            "canBeInstantiatedOnlyOncePerProcess",
            "canHandleVariableCommunicationStepSize",
        )
        return FmuInterface(identifier, *map(element.is_true, names))

    def _declared_types(self) -> Iterator[tuple[str, Mapping[str, str]]]:
        for element in (child for types in self.root.all("TypeDefinitions") for child in types.children):
            # FMI 2.0: <SimpleType name=...><Real unit=.../></SimpleType>; FMI 3.0: <Float64Type name=... unit=.../>
            parts = element.children if self.version == "2.0" else [element]
            for part in parts[:1]:
                yield element.attributes.get("name", ""), part.attributes

    def _variables(self) -> tuple[FmuVariable, ...]:
        elements = [element for part in self.root.all("ModelVariables") for element in part.children]
        if self.version == "2.0":
            return self._variables_2(elements)
        # a dimension may refer to a structural parameter, whose start is the number of elements
        sizes = {e.attributes.get("valueReference"): e.attributes.get("start", "") for e in elements}
        return tuple(self._variable(e, e.tag, e.attributes, sizes) for e in elements)

    def _variables_2(self, elements: Sequence[XmlElement]) -> tuple[FmuVariable, ...]:
        variables = []
        for element in elements:
            tag, attributes = "", element.attributes
            # FMI 2.0: <ScalarVariable name="..."><Real start="..."/></ScalarVariable>; in FMI 3.0, the tag is the type
            for child in element.children:
                if child.tag in _TYPES_2:
                    tag, attributes = child.tag, {**child.attributes, **attributes}
                    break
            variables.append(self._variable(element, tag, attributes, {}))
        # an index may point to a variable that follows, so that all are read before
        references = [variable.reference for variable in variables]
        return tuple(
            v if v.derivative is None else v._replace(derivative=self._referenced(v, references)) for v in variables
        )

    def _referenced(self, variable: FmuVariable, references: Sequence[int]) -> int:
        """Return the value reference of the variable that `derivative` of FMI 2.0 names by its index from 1 on."""
        index = variable.derivative or 0
        if 1 <= index <= len(references):
            return references[index - 1]
        self.findings.error(Location(self.file, variable.line), f"{variable.name} is the derivative of no variable")
        return -1

    def _variable(
        self, element: XmlElement, tag: str, attributes: Mapping[str, str], sizes: Mapping[str | None, str]
    ) -> FmuVariable:
        declared, get = self.types.get(attributes.get("declaredType", "")), attributes.get
        # what a variable states itself takes precedence over its declared type
        whole = attributes if declared is None else {**declared, **attributes}
        line, name, number = element.line, get("name", ""), self._attribute
        real, numeric = tag in REAL_TYPES, number_type(self.version, tag) is not None
        if not name:
            self._error(element, "a variable has no name")
        shape = self._shape(element, sizes) if self.version == "3.0" and element.children else ()
        return FmuVariable(
            name=name,
            reference=int(number(whole, line, "valueReference", -1.0)),
            type=tag,
            causality=get("causality", "local"),
            variability=get("variability", "continuous" if real else "discrete"),
            start=self._start(whole, line, math.prod(shape)) if numeric else (),
            shape=shape,
            unit=whole.get("unit", ""),
            minimum=number(whole, line, "min", -math.inf) if numeric and "min" in whole else -math.inf,
            maximum=number(whole, line, "max", math.inf) if numeric and "max" in whole else math.inf,
            nominal=abs(number(whole, line, "nominal", 0.0)) if real and "nominal" in whole else 0.0,
            # an index in FMI 2.0, see `_referenced`; a value reference in FMI 3.0
            derivative=int(number(whole, line, "derivative", 0.0)) if real and "derivative" in attributes else None,
            initial=get("initial", ""),
            line=line,
        )

    def _shape(self, element: XmlElement, sizes: Mapping[str | None, str]) -> tuple[int, ...]:
        shape = []
        for dimension in element.all("Dimension"):
            reference = dimension.attributes.get("valueReference")
            text = dimension.attributes.get("start") or sizes.get(reference, "")
            # `isdigit` alone accepts superscripts, and Python refuses to convert thousands of digits
            shape.append(int(text) if text.isascii() and text.isdigit() and len(text) < 9 else 0)
        if math.prod(shape) > MOST_VALUES or (shape and min(shape) == 0):
            text = " x ".join(map(str, shape))
            self._error(element, f"{element.attributes.get('name', '')[:60]} has {text} values")
            return ()
        return tuple(shape)

    def _start(self, attributes: Mapping[str, str], line: int, size: int) -> tuple[float, ...]:
        texts = attributes.get("start", "").split()
        if not texts:
            return ()
        try:
            values = tuple([_BOOLEANS[text] if text in _BOOLEANS else float(text) for text in texts])
        except ValueError:
            message = f"start={attributes['start'][:60]!r} must be a number"
            self.findings.error(Location(self.file, line), message, _EXPORT)
            return ()
        # one number is the start of all elements; too few numbers are none
        return values * size if len(values) == 1 else values[:size] if len(values) >= size else ()

    def _dependencies(self, unknowns: Iterator[XmlElement], variables: Sequence[FmuVariable]) -> tuple[Dependency, ...]:
        key = "index" if self.version == "2.0" else "valueReference"
        if self.version == "2.0":
            numbered = dict(enumerate(variables, start=1))
        else:
            numbered = {variable.reference: variable for variable in variables}
        result = []
        for unknown in unknowns:
            variable = numbered.get(int(self._number(unknown, key, -1.0)))
            if variable is None:
                self._error(unknown, f"{key}={unknown.attributes.get(key, '')[:20]} is that of no variable")
                continue
            stated = unknown.attributes.get("dependencies")
            words = [] if stated is None else [word for word in stated.split() if word.isdigit()]
            # an empty list states that there are no dependencies, a missing one nothing at all
            used = frozenset(numbered[int(word)].reference for word in words if int(word) in numbered)
            result.append(Dependency(variable, None if stated is None else used))
        return tuple(result)

    def _check_names(self, variables: Sequence[FmuVariable]) -> None:
        names: dict[str, FmuVariable] = {}
        for variable in variables:
            first = names.setdefault(variable.name, variable)
            problems = []
            if first is not variable:
                problems.append(f"is also the name of the variable in line {first.line}")
            if variable.minimum > variable.maximum:
                problems.append(f"has min={variable.minimum:g} above max={variable.maximum:g}")
            if not 0 <= variable.reference <= MOST_REFERENCE:
                problems.append(f"has the valueReference {variable.reference:.6g}")
            for problem in problems:
                message = f"{variable.name[:60]} {problem}"
                self.findings.error(Location(self.file, variable.line), message, _EXPORT)

    def _check_derivatives(self, description: FmuDescription) -> None:
        known = {variable.reference for variable in description.variables if variable.is_real}
        for variable, _ in description.derivatives:
            if variable.derivative not in known:
                message = f"{variable.name} is listed as a derivative, but of no state"
                self.findings.error(Location(self.file, variable.line), message, _EXPORT)

    def _number(self, element: XmlElement, key: str, default: float) -> float:
        return self._attribute(element.attributes, element.line, key, default)

    def _attribute(self, attributes: Mapping[str, str], line: int, key: str, default: float) -> float:
        text = attributes.get(key)
        if text is None:
            return default
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if math.isnan(number) or (math.isinf(number) and key not in ("min", "max")):
            self.findings.error(Location(self.file, line), f"{key}={text[:60]!r} must be a number", _EXPORT)
            return 0.0
        return number

    def _error(self, element: XmlElement, message: str) -> None:
        self.findings.error(Location(self.file, element.line), message, _EXPORT)


def _unknowns(structure: XmlElement, group: str) -> Iterator[XmlElement]:
    return (unknown for part in structure.all(group) for unknown in part.all("Unknown"))
