import numpy as np

from kennfeld.native.workspace import Workspace
from tests.native.models import MODELS, case
from tests.native.reference import compiled


def test_a_piece_starts_in_the_first_cell_of_every_delay():
    code = compiled(case(MODELS["delayed"](), 5))
    values = code.values
    space = Workspace(code.kernel, code.samples, np.zeros(len(code.kernel.layout.axes)), 5)
    space.use(values)
    space.hints[:] = 2
    space.start(0)
    latencies = code.kernel.layout.latencies
    assert [space.hints[i] for i, latency in enumerate(latencies) if latency > 1] == [0]
