"""Lines on a trained surrogate."""

import numpy as np

from kennfeld.analysis.extrapolation import surrogate_coordinates
from kennfeld.base.formatting import count_noun
from kennfeld.optimize.quality.quality import r2_text
from kennfeld.surrogate.filtered_surrogate import FilteredSurrogate
from kennfeld.surrogate.surrogate_file import Surrogate
from kennfeld.surrogate.surrogate_models import DynamicSurrogate


def describe_surrogate(surrogate: Surrogate) -> str:
    """Return a sentence with the inputs, lags and size of a surrogate."""
    call = f"{surrogate.output} = {surrogate.name}({', '.join(surrogate.inputs)})"
    shape = " of a Matern kernel" if surrogate.expansion.kernel == "matern52" else ""
    hinges = surrogate.expansion.hinges
    kinks = f" and {count_noun(len(hinges), 'kink')}" if hinges else ""
    centres = f"{surrogate.expansion.size} centres{shape}{kinks}"
    if isinstance(surrogate, FilteredSurrogate):
        filters = ", ".join(f"{T:.4g}" for T in surrogate.time_constants)
        late = f", {count_noun(surrogate.delay, 'sample')} late" if surrogate.delay else ""
        return f"{call}, steps of {surrogate.step:g} s, {centres}; inputs filtered over {filters} s{late}"
    if not isinstance(surrogate, DynamicSurrogate):
        return f"{call}, {centres}"
    delayed = [*zip(surrogate.inputs, surrogate.lags, strict=True), (surrogate.output, surrogate.output_lags)]
    lags = "; ".join(f"{name} {', '.join(map(str, numbers)) or 'none'}" for name, numbers in delayed)
    return f"{call}, steps of {surrogate.step:g} s, {centres}; lags in samples: {lags}"


def quality_table(surrogate: Surrogate) -> list[list[str]]:
    """Return a row for each dataset and mode of evaluation."""
    rows = [
        [
            *(q.dataset, q.use, q.mode, str(q.samples)),
            *(f"{q.rmse:.4g}", r2_text(q.r2, q.samples, q.rmse), f"{q.max_abs:.4g}"),
        ]
        for q in surrogate.quality
    ]
    return [["dataset", "use", "mode", "samples", "RMSE", "R2", "max |error|"], *rows]


def ranges_table(surrogate: Surrogate) -> list[list[str]]:
    """Return the range of the training data for each input, and for the output if it is fed back."""
    rows = [["trained on", "unit", "from", "to"]]
    validity = surrogate.validity
    if validity is None:
        return rows
    names = np.array([name for name, _ in surrogate_coordinates(surrogate)])
    units = dict(zip([*surrogate.inputs, surrogate.output], surrogate.units, strict=False))
    for name in dict.fromkeys(names.tolist()):
        ends = validity.least[names == name].min(), validity.most[names == name].max()
        rows.append([name, units.get(name, ""), *(f"{end:.6g}" for end in ends)])
    return rows
