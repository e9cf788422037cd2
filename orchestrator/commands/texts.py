"""What the texts of options mean that name something and give it a value."""

from __future__ import annotations

from collections.abc import Iterable

from orchestrator.errors import Problem


def swaps(texts: Iterable[str]) -> dict[str, str]:
    """{component: variant or path} from the texts 'component=variant'."""
    return assignments(texts, "--swap", "component=variant or component=file.fmu")


def factors(texts: Iterable[str]) -> dict[str, int]:
    """{component: steps} from the texts 'component=steps'."""
    expected = "component=N, N steps of it in each communication step"
    found = assignments(texts, "--factor", expected)
    for name, text in found.items():
        if not text.isdecimal():
            raise Problem(f"--factor {name}={text}: expected {expected}")
    return {name: int(text) for name, text in found.items()}


def assignments(
    texts: Iterable[str], option: str = "--set", expected: str = "component.variable=value or input=value"
) -> dict[str, str]:
    """{name: value} from the texts 'name=value' of an option."""
    values = dict[str, str]()
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not name:
            raise Problem(f"{option} {text}: expected {expected}")
        if values.setdefault(name, value) != value:
            raise Problem(f"{option} {text}: {name} is {values[name]} already, expected one value")
    return values
