"""Reading of XML files: elements by local name, attributes by type, messages with file and line; writing.

Text that other tools would read differently is refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from markupsafe import Markup

from orchestrator.base.errors import Problem
from orchestrator.base.files import Location
from orchestrator.base.numerals import boolean, finite

Element = Any  # lxml ships no types
# The largest descriptions in use have 100 000 variables, 1.5 million elements and attributes, and 40 MB.
MAX_BYTES = 200 << 20
MAX_ITEMS = 2_500_000  # elements and attributes; each takes up to 450 bytes of memory, together 1.1 GB
MAX_NAME = 10_000  # characters of an attribute `name`, which many messages quote; the longest have some 500
MAX_LEVELS = 100  # systems inside systems take two each


@dataclass(frozen=True)
class XmlElement:
    """An XML element with its file, for messages."""

    file: Location
    element: Element

    @property
    def name(self) -> str:
        """The local name, without namespace or prefix; empty for comments."""
        return local_name(self.element)

    @property
    def location(self) -> str:
        """File and line, for messages."""
        return f"{self.file}: line {self.element.sourceline}"

    def problem(self, message: str) -> Problem:
        """The Problem for an error in this element."""
        return Problem(f"{self.location}: {self.name}: {message}")

    def children(self, *path: str) -> Iterator[XmlElement]:
        """The elements at a path of names; without a path all child elements."""
        elements = children(self.element, *path) if path else (e for e in self.element if local_name(e))
        return (XmlElement(self.file, e) for e in elements)

    def child(self, *path: str) -> XmlElement | None:
        """The first element at a path of names, or None."""
        return next(self.children(*path), None)

    @property
    def attributes(self) -> Mapping[str, str]:
        """The attributes, except those with a namespace."""
        return {n: text for n, text in attributes_of(self.element).items() if not n.startswith("{")}

    def get(self, name: str) -> str | None:
        """The text of an attribute, or None."""
        text = self.element.get(name)
        return None if text is None else str(text)

    def required(self, name: str) -> str:
        """The text of a required attribute."""
        text = self.get(name)
        if text is None:
            got = ", ".join(str(n).rpartition("}")[2] for n in self.element.attrib) or "none"
            raise self.problem(f"expected an attribute {name}, got {got}")
        return text

    def number(self, name: str, default: float | None = None) -> float:
        """The value of an attribute, a finite number."""
        text = self.get(name)
        if text is None and default is not None:
            return default
        try:
            return finite(text or "")
        except ValueError:
            raise self.problem(f"expected a finite number for {name}, got {text!r}") from None

    def boolean(self, name: str) -> bool:
        """The value of a boolean attribute; false if it is missing."""
        text = self.element.get(name, "false")
        try:
            return boolean(text)
        except ValueError:
            raise self.problem(f"expected true or false for {name}, got {text!r}") from None


def attributes_of(element: Element) -> dict[str, str]:
    """The attributes by name; `items` of lxml looks for each value by its name, among all."""
    return dict(zip(element.keys(), map(str, element.xpath("@*")), strict=True))


def read_xml(file: Location, expected: str) -> XmlElement:
    """The root of an XML file; its local name must be `expected`."""
    return XmlElement(file, parse_text(file.read(MAX_BYTES), file, expected))


def parse_text(text: bytes, file: Location, expected: str) -> Element:
    """The root of the content of a file; undeclared prefixes are accepted, as some tools write them."""
    from lxml import etree

    safe = {"resolve_entities": False, "no_network": True}
    if fault := too_large(text):
        raise Problem(f"{file}: {fault}")
    parser = etree.XMLParser(**safe)
    try:
        root = etree.fromstring(text, parser)
    except etree.XMLSyntaxError as error:
        if message := _syntax_error(error, parser.error_log):
            raise Problem(f"{file}: cannot be read as XML: {message}") from error
        root = etree.fromstring(text, etree.XMLParser(recover=True, **safe))
    if fault := excess(root):
        raise Problem(f"{file}: {fault}")
    for entity in root.iter(etree.Entity):  # entities are not resolved, so their content would be missing
        message = f"expected the content itself, got the entity {entity.text}"
        raise XmlElement(file, entity.getparent()).problem(message)
    if local_name(root) != expected:
        raise Problem(f"{file}: expected the element {expected}, got {local_name(root)}")
    return root


def too_large(text: bytes) -> str:
    """Why a text would take too much memory as a tree; empty if it would not."""
    items = text.count(b"<") + text.count(b"=")
    limit = f"expected at most {MAX_ITEMS} elements and attributes, a limit of this tool"
    return f"{limit}, got {items}" if items > MAX_ITEMS else ""


def excess(root: Element) -> str:
    """Why a tree has too many levels for functions that call themselves, or too long names; empty if not."""
    if root.xpath(f"boolean({'/*' * (MAX_LEVELS + 1)})"):
        return f"expected at most {MAX_LEVELS} levels of elements"
    if root.xpath(f"boolean(//@name[string-length() > {MAX_NAME}])"):
        return f"expected names of at most {MAX_NAME} characters"
    return ""


def _syntax_error(error: Exception, log: Any) -> str:
    """The first error other than an undeclared prefix; empty if there is none."""
    from lxml import etree

    undeclared = etree.ErrorTypes.NS_ERR_UNDEFINED_NAMESPACE
    others = [f"{e.message}, line {e.line}, column {e.column}" for e in log if e.type != undeclared]
    if not len(log):
        others = [re.sub(r" *\(<string>.*\)$", "", str(error))]
    return " ".join("".join(others[:1]).split())


def local_name(element: Element) -> str:
    """The local name, without namespace or prefix; empty for comments."""
    tag = element.tag
    return _local(tag) if isinstance(tag, str) else ""


@lru_cache(maxsize=1000)
def _local(tag: str) -> str:
    return tag.rpartition("}")[2].rpartition(":")[2]


def children(element: Element | None, *path: str) -> Iterator[Element]:
    """The elements at a path of names."""
    if element is None:
        return
    if not path:
        yield element
        return
    for child in element:
        if local_name(child) == path[0]:
            yield from children(child, *path[1:])


def child(element: Element | None, *path: str) -> Element | None:
    """The first element at a path of names, or None."""
    return next(children(element, *path), None)


def shortest_decimal(value: float) -> str:
    """The shortest decimal that is read back as the same number; other tools display this text."""
    short = f"{value:.15g}"
    return short if float(short) == value else repr(value)


# ---- writing


def as_text(value: object) -> str:
    """A value as XML text; a float has all digits that are needed to read it back."""
    if isinstance(value, float):
        return shortest_decimal(value)
    return str(value).lower() if isinstance(value, bool) else str(value)


def attributes(values: Mapping[str, object] | None = None, /, **more: object) -> Markup:
    """Attributes of an element as text; those that are None are left out."""
    from xml.sax.saxutils import quoteattr  # on first use: it loads a client for HTTP, and readers need none

    texts = {name: as_text(value) for name, value in {**(values or {}), **more}.items() if value is not None}
    return Markup("".join(f" {name}={quoteattr(text)}" for name, text in texts.items()))


def rendered_xml(template: Path, **content: object) -> bytes:
    """The content of an XML file from a Jinja template, which can call `attributes`."""
    from lxml import etree

    from orchestrator.base.text import rendered  # with NumPy, which readers do not need

    text = rendered(template, escaped=True, attributes=attributes, **content)
    root = etree.fromstring(text.encode(), etree.XMLParser(remove_blank_text=True))
    for element in root.iter():
        element.text = (element.text or "").strip() or None  # the parser keeps blanks in an empty element
    made: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return made


@cache
def package_version() -> str:
    """Version of the installed distribution; "0" if it is not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("harvester-cosim")
    except PackageNotFoundError:
        return "0"


def generation_tool() -> str:
    """Name and version of this program, for the attribute generationTool."""
    return f"harvester-cosim {package_version()}"
