"""Three scalars of a sensor equation: the Steinhart-Hart coefficients of a thermistor."""

import numpy as np

import kennfeld as kf

# resistance in kOhm and temperature in degC, as a calibration bath gives them
resistance = np.array([32.65, 19.90, 12.49, 10.00, 8.06, 5.33, 3.60, 2.49, 1.75, 1.26, 0.92])
temperature = np.array([0.0, 10, 20, 25, 30, 40, 50, 60, 70, 80, 90])

result = kf.calibrate(
    "T[degC] = 1 / (A + B*log(R) + C*log(R)^3) - 273.15",
    {"R": resistance, "bath": temperature},
    {"A": 0.003, "B": 0.0003, "C": 0.0},
    target="bath",
)
print(result)
for name, parameter in result.parameters.items():
    print(f"{name} = {parameter.value:.6g}")
