"""How every test runs: the same random cases each time.

A search for new ones is asked for: `pytest --hypothesis-profile=search`.
"""

from hypothesis import settings

settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("search", deadline=None, print_blob=True)
settings.load_profile("same")
