"""The HTML of a value, by its type."""

from collections.abc import Callable
from typing import Any

from kennfeld.analysis.validation_result import CrossValidation
from kennfeld.base.errors import Finding, FindingList, Findings, visible
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.notebook.dataset_display import channel_html, dataset_html
from kennfeld.notebook.parameter_display import parameter_html, parameter_set_html
from kennfeld.notebook.result_display import cross_validation_html, findings_html, result_html, trust_html
from kennfeld.optimize.fit.result import Result
from kennfeld.optimize.trust.trust import Trust

_WRITERS: dict[type, Callable[[Any], str]] = {
    Parameter: parameter_html,
    ParameterSet: parameter_set_html,
    Channel: channel_html,
    Dataset: dataset_html,
    Result: result_html,
    Trust: trust_html,
    CrossValidation: cross_validation_html,
    Finding: lambda finding: findings_html([finding]),
    FindingList: findings_html,
    Findings: findings_html,
}


def html_of(value: object) -> str:
    """Return a value as HTML for a notebook, without scripts; names in it are escaped.

    >>> from kennfeld.domain.parameters import Scalar
    >>> html_of(Scalar("Kp", 0.08)).count("<b>Kp</b>")
    1
    """
    # subclasses included: a Curve is written as a Parameter
    writer = next(writer for kind, writer in _WRITERS.items() if isinstance(value, kind))
    return visible(writer(value))
