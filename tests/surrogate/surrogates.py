"""Small surrogates and recordings that the tests of this folder share."""

import numpy as np

from kennfeld.domain.dataset import Dataset
from kennfeld.domain.rbf import Expansion
from kennfeld.surrogate import DynamicSurrogate, StaticSurrogate, SurrogateQuality, Validity


def random_expansion(seed, inputs, centres, size=0.2):
    """Bells of the same widths at every centre."""
    rng = np.random.default_rng(seed)
    return Expansion(
        0.1 * rng.normal(),
        0.3 * rng.uniform(-1, 1, inputs) / inputs,
        size * rng.normal(size=centres),
        rng.normal(size=(centres, inputs)),
        np.tile(rng.uniform(0.8, 1.6, inputs), (centres, 1)),
    )


def validity(inputs):
    rng = np.random.default_rng(1)
    return Validity.around(rng.normal(size=(40, inputs)), np.ones(inputs))


QUALITY = (
    SurrogateQuality("bench", "training", "one step", 12, 0.1, 0.99, 0.3),
    SurrogateQuality("flat", "test", "free run", 3, 1 / 3, float("nan"), 1e-17),
)


def static_surrogate():
    return StaticSurrogate(
        "torque", ("speed", "air"), "Torque", ("rpm", "%", "Nm"), random_expansion(0, 2, 3), validity(2), QUALITY
    )


def dynamic_surrogate(**changes):
    attributes = {
        "name": "engine",
        "inputs": ("throttle", "load"),
        "lags": ((0, 2), (1,)),
        "output": "n",
        "output_lags": (1, 3),
        "step": 0.02,
        "expansion": random_expansion(1, 5, 4),
        "validity": validity(5),
        "quality": QUALITY,
        "start": 0.25,
        "limits": (-2.0, np.inf),
        "units": ("deg", "Nm", "rpm"),
        "stability": "All 48 free runs stayed bounded.",
        "remarks": ("n stays at its minimum -2 for 20 samples",),
    }
    return DynamicSurrogate(**(attributes | changes))


def tank_recording(name, seed, samples=400, noise=0.01, use="training"):
    """A level that fills by u and drains by its own square root, once a second."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.2, 1.5, samples // 10 + 1), 10)[:samples]
    level = np.empty(samples)
    now = 0.5
    for k in range(samples):
        level[k] = now
        now += 0.2 * (u[k] - np.sqrt(now))
    measured = level + noise * rng.normal(size=samples)
    return Dataset.of(name, {"u": u, "level": measured}, units={"level": "m"}, time=np.arange(samples) * 1.0, use=use)
