"""Sentences on poorly determined weights of neural networks, in one for all layers.

Rows and columns of a layer are numbers without a meaning of their own, so single weights are not named.
"""

from collections.abc import Mapping

import numpy as np

from kennfeld.base.arrays import Bool, Float
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.optimize.trust.direction_text import Direction, join_items, name_weights
from kennfeld.optimize.trust.remedies import Remedy
from kennfeld.optimize.trust.table_changes import WeakDirection

MAX_LAYERS = 3  # that a sentence names
ADVICE = "Record more samples, fit fewer layers, or use a network with fewer neurons."


def describe_weights(
    weak: WeakDirection,
    parts: Mapping[str, Float],
    deviation: Mapping[str, Float],
    parameters: ParameterSet,
    *,
    alone: bool,
) -> list[Direction]:
    """Describe the poorly determined directions that change weights, in one sentence; none if all are certain.

    Args:
        weak: the worst of them.
        parts: its changes, by layer.
        deviation: standard deviations of the weights, by layer; inf if undetermined, NaN if unknown.
        parameters: the fitted parameters.
        alone: True if the direction changes weights only.
    """
    unsure = {name: _is_unsure(deviation[name], parameters[name].values) for name in parts}
    counts = {name: int(np.count_nonzero(where)) for name, where in unsure.items()}
    ranked = sorted((name for name in counts if counts[name]), key=lambda name: -counts[name] / parts[name].size)
    listed = [name_weights(name, counts[name], parts[name].size) for name in ranked[:MAX_LAYERS]]
    if more := sum(counts[name] for name in ranked[MAX_LAYERS:]):
        listed.append(f"{more} of other layers")
    if listed:
        layer = "their layer" if len(ranked) > 1 else "the layer"
        sentence = (
            f"The data hardly determine {join_items(listed)}: "
            f"their standard deviation exceeds the root mean square of {layer}."
        )
    elif alone and weak.exact:
        sentence = f"Combinations of weights of {join_items(list(parts))} have no effect on the fit."
    else:
        return []
    strongest = max(parts, key=lambda name: float(np.abs(parts[name]).max()))
    lock = Remedy(locks={strongest: np.ones(parts[strongest].shape, dtype=bool)})
    return [Direction(sentence, ADVICE, dict(parts), weak.exact, weak.ratio, weak.deviation, (lock,))]


def _is_unsure(deviation: Float, values: Float) -> Bool:
    # negated, so that an unknown deviation, NaN, counts as unsure
    return ~(deviation <= float(np.sqrt(np.mean(np.square(values)))))
