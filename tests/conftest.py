"""How every test runs: the same random cases each time, however slow the machine.

A search for new ones is asked for: `pytest --hypothesis-profile=search`.
"""

from hypothesis import HealthCheck, settings

PATIENT = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}

settings.register_profile("same", derandomize=True, **PATIENT)
settings.register_profile("search", print_blob=True, **PATIENT)
settings.load_profile("same")
