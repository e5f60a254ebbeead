import numpy as np
import pytest
from tank_fmu import COUNT, build, closed_form, recording

import kennfeld as kf
from kennfeld.models.fmu.importing import fmu

TABLE = np.array([0.1, 0.2, 0.3])


@pytest.fixture(scope="module", params=[2, 3])
def tank(request, tmp_path_factory):
    return build(tmp_path_factory.mktemp("tank"), request.param)


def test_outputs_are_those_of_steps_with_the_inputs_of_the_sample_before(tank):
    data = recording()
    model = fmu(tank)
    table = model.carried["table"].changed(values=TABLE)
    nodes = kf.simulate(model, data, {"gain": 1.3, "tau": 0.7, "level": 0.4, "table": table})
    x = closed_form(data, 1.3, 0.7, 0.4)
    np.testing.assert_allclose(nodes["y"].values, x + TABLE @ [1, 2, 3], rtol=1e-13)
    np.testing.assert_array_equal(nodes["steps"].values, 3 + np.arange(COUNT))
    np.testing.assert_array_equal(nodes["high"].values, x > 1)


def test_pieces_start_anew(tank):
    data = recording(2 * COUNT)
    data["flow"][COUNT - 1] = np.nan  # the end of a piece
    y = kf.simulate(fmu(tank), data, {})["y"].values
    second = {name: values[COUNT:] for name, values in data.items()}
    np.testing.assert_allclose(y[-COUNT:], closed_form(second), rtol=1e-12)
