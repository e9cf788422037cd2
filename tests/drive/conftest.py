"""The scripts of the page, one by one, in a browser."""

import json
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import quote

import pytest

from orchestrator.drive.page import scripts

Script = Callable[..., Any]


@pytest.fixture(scope="module")
def script(chromium: Any) -> Iterator[Script]:
    """script(module, expression, argument): an expression of the module m and of a, in a browser."""
    addresses = {name: f"data:text/javascript,{quote(text)}" for name, text in scripts().items()}
    page = chromium.new_page()
    page.set_content(f'<script type="importmap">{json.dumps({"imports": addresses})}</script>')

    def value(module: str, expression: str, argument: object = None) -> Any:
        imported = f"const m = await import('drive/{module}.js')"
        return page.evaluate(f"async (a) => {{ {imported}; return {expression}; }}", argument)

    yield value
    page.close()
