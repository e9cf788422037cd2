"""How many examples a property test draws: few and the same in `make test`, ten times as many in a search."""

from typing import Any

from hypothesis import HealthCheck, settings

USUAL = 40
# how long an example takes is a matter of the computer and of what else it does
ANY_COMPUTER: dict[str, Any] = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}


def register() -> None:
    """`same`: each run draws the same examples; `search`: others in each run, ten times as many."""
    settings.register_profile("same", settings.default, derandomize=True, max_examples=USUAL, **ANY_COMPUTER)
    more = {"database": None, "print_blob": True, "max_examples": 10 * USUAL}
    settings.register_profile("search", settings.default, derandomize=False, **more, **ANY_COMPUTER)
    settings.load_profile("same")


def examples(usual: int, *allowed: HealthCheck) -> settings:
    """Settings of a test that takes another number of examples: `usual`, more in a search.

    allowed   health checks that the test does without
    """
    share = settings.default.max_examples / USUAL
    return settings(max_examples=round(usual * share), suppress_health_check=[HealthCheck.too_slow, *allowed])
