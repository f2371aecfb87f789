"""Hypothesis on busy machines: how long one example takes says nothing about the code. A test draws the same examples
each time, until it is changed; --hypothesis-profile fresh draws new ones (`./run test long` does).
"""

from hypothesis import HealthCheck, settings

settings.register_profile("fresh", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("tautline", settings.get_profile("fresh"), derandomize=True)
settings.load_profile("tautline")
