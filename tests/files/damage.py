"""Damage to archives and XML files, by seed: what transfers, disks, other tools and attackers do to them."""

import io
import random
import re
import struct
import warnings
import zipfile
from collections.abc import Callable, Mapping
from copy import deepcopy

from lxml import etree

Members = dict[str, bytes]
HOSTILE = (  # values of attributes
    *("", " ", "-1", "0", "1", "2", "7", "1.5", "true", "1 2 3", "1 x", "nan", "inf", "-inf"),
    *("1e-300", "1e300", "1e400", "99999999999999999999", "-99999999999999999999", "9" * 5000),
    *("x" * 100_000, "a." * 20_000, "1 " * 20_000, "[" * 10_000, "'" * 999, "kg" * 100, "(" * 150),
    *("../" * 50 + "etc/passwd", "/etc/passwd", "file:///etc/passwd", "../../x/evil", "http://[::1"),
    *("C:\\evil.fmu", "//host/evil", "a%00b", "%2e%2e/%2e%2e/evil", ".", "..", "resources", "a\tb\nc"),
    *("\u202eevil", "\N{GRINNING FACE}e\u0301", "\x7f\x85", "{0}", "%s%n", "a.b.c", "$(evil)", "\ufeff"),
)
NAMES = (  # of members
    *("../evil", "a/../../evil", "/outside/evil", "C:/evil", "C:evil", "\\evil", "..\\evil", "evil\0.fmu"),
    *("d/" * 3000 + "x", "x" * 300, "y/" * 100 + "z", "a\nb", "modelDescription.xml/x", "resources"),
    *("MODELDESCRIPTION.XML", "binaries/linux64/../../evil", "\N{GRINNING FACE}", "con", "a:b", "."),
    "binaries",
)
SNIPPETS = (  # bytes in a text
    *(b"<", b">", b'"', b"&", b"\0", b"\xff", b"]]>", b"<!--", b"<![CDATA[", b"&#0;", b"&#x1b;", b"&a;"),
    *(b"\xef\xbb\xbf", b"<?x y?>", b"<a>" * 3000, b"<a/>" * 3000, b' x="1"', b' name="a"', b"<odd:e/>"),
    b"[" * 5000,
)
ENTITIES = b'<!ENTITY a0 "ha">'
ENTITIES += b"".join(b'<!ENTITY a%d "%s">' % (n, b"&a%d;" % (n - 1) * 10) for n in range(1, 10))
DOCTYPES = (
    b"<!DOCTYPE a [%s]>" % ENTITIES,
    b'<!DOCTYPE a [<!ENTITY a9 SYSTEM "file:///etc/passwd">]>',
    b'<!DOCTYPE a SYSTEM "http://localhost:9/a.dtd">',
    b'<!DOCTYPE a [<!ENTITY a9 "%s">]>' % (b"x" * 50_000),
)


def damaged(good: Mapping[str, bytes], seed: int) -> bytes:
    """An archive with the damage of this seed."""
    draw = random.Random(seed)
    members = dict(good)
    for _ in range(draw.choice((1, 1, 2, 4))):
        draw.choice(CONTENT)(draw, members)
    data = archive(draw, members)
    return draw.choice(ARCHIVE)(draw, data) if draw.random() < 0.4 else data


def _name(draw: random.Random, members: Members, *more: str) -> str:
    """The name of an XML file, or of a file with one of these suffixes."""
    names = [n for n in members if n.endswith((".xml", ".ssd", ".ssv", ".ssm", ".exp", *more))]
    return draw.choice(names or list(members) or ["modelDescription.xml"])


def tree(draw: random.Random, members: Members) -> None:
    """Attributes and elements dropped, repeated, renamed, moved, or with other values."""
    name = _name(draw, members)
    try:
        root = etree.fromstring(members.get(name, b""), etree.XMLParser(huge_tree=True))
    except etree.XMLSyntaxError:
        return
    for _ in range(draw.choice((1, 1, 1, 2, 3, 8))):
        elements = [e for e in root.iter() if isinstance(e.tag, str)]
        draw.choice((attribute, attribute, attribute, element))(draw, elements)
    encoding = draw.choice(("UTF-8",) * 6 + ("UTF-16", "ISO-8859-1", "ASCII"))
    members[name] = etree.tostring(root, encoding=encoding, xml_declaration=True)


def attribute(draw: random.Random, elements: list[etree._Element]) -> None:
    """Drop, rename, or replace an attribute, by a hostile value or by that of another attribute."""
    e = draw.choice([e for e in elements if e.attrib] or elements)
    if not e.attrib:
        return
    key, other = draw.choice(list(e.attrib)), draw.choice([x for x in elements if x.attrib])
    action = draw.random()
    if action < 0.15:
        del e.attrib[key]
    elif action < 0.25:
        e.set(draw.choice(("x", "source", "name", "derivative", "start")), e.attrib.pop(key))
    elif action < 0.6:
        e.set(key, "".join(c for c in draw.choice(HOSTILE) if c.isprintable() or c in "\t\n\x7f\x85\u202e"))
    else:
        e.set(key, draw.choice(list(other.attrib.values())))


def element(draw: random.Random, elements: list[etree._Element]) -> None:
    """Drop, repeat, rename, move or nest an element."""
    e, other = draw.choice(elements), draw.choice(elements)
    parent, action = e.getparent(), draw.random()
    if parent is None:
        return
    if action < 0.3:
        parent.remove(e)
    elif action < 0.6:
        for _ in range(draw.choice((1, 1, 2, 200))):
            parent.append(deepcopy(e))
    elif action < 0.75:
        e.tag = other.tag
    elif action < 0.9:
        if e not in other.iterancestors() and e is not other:
            other.append(e)
    else:
        for _ in range(draw.choice((3, 60, 120, 600))):
            outer = etree.Element(parent.tag, dict(e.attrib))
            parent.replace(e, outer)
            outer.append(e)
            parent = outer


def text(draw: random.Random, members: Members) -> None:
    """Bytes of a text overwritten, inserted, cut; a document type."""
    name = _name(draw, members, ".toml", ".csv", ".py")
    data = members.get(name, b"")
    at = draw.randrange(len(data) + 1)
    action = draw.random()
    if action < 0.3:
        data = data[:at] + draw.choice(SNIPPETS) + data[at:]
    elif action < 0.5:
        data = data[:at] + data[at + draw.choice((1, 5, 50, 5000)) :]
    elif action < 0.7:
        data = data[:at] + bytes([draw.randrange(256)]) + data[at + 1 :]
    elif action < 0.8:
        encoding = draw.choice(("utf-16", "utf-32", "cp037", "utf-7"))
        data = data.decode("utf-8", "replace").encode(encoding, "replace")
    else:
        head, mark, tail = data.partition(b"?>")
        place = (b'="', b'="&a9;') if draw.random() < 0.5 else (b"><", b">&a9;<")
        quoted = tail.replace(*place, 1)
        data = head + mark + draw.choice(DOCTYPES) + quoted
    members[name] = data


def member(draw: random.Random, members: Members) -> None:
    """A member dropped, emptied, cut, moved to a hostile name, exchanged with another, or put into itself."""
    if not members:
        return
    name, other = draw.choice(list(members)), draw.choice(list(members))
    action = draw.random()
    if action < 0.2:
        del members[name]
    elif action < 0.3:
        members[name] = b""
    elif action < 0.45:
        members[name] = members[name][: draw.randrange(len(members[name]) + 1)]
    elif action < 0.75:
        members[draw.choice(NAMES)] = members[name] if draw.random() < 0.5 else members.pop(name)
    elif action < 0.9:
        members[name], members[other] = members[other], members[name]
    else:
        members[name] = archive(draw, members)


def noise(draw: random.Random, members: Members) -> None:
    """Bytes of any member overwritten, such as those of a library or of an FMU in a system."""
    if not members:
        return
    name = draw.choice(list(members))
    data = bytearray(members[name])
    for _ in range(draw.choice((1, 3, 30)) if data else 0):
        data[draw.randrange(len(data))] = draw.randrange(256)
    members[name] = bytes(data)


CONTENT: tuple[Callable[[random.Random, Members], None], ...] = (tree, tree, tree, tree, text, member, noise)


def archive(draw: random.Random, members: Mapping[str, bytes]) -> bytes:
    """A zip archive, seldom with members that are packed by other methods, are links, or exist twice."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of names that exist twice
        for name, data in members.items():
            info = zipfile.ZipInfo("x")
            info.filename, odd = name, draw.random() < 0.03
            info.compress_type = zipfile.ZIP_DEFLATED
            if odd:
                info.compress_type = draw.choice((zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA, zipfile.ZIP_STORED))
                info.external_attr = draw.choice((0o120777 << 16, 0o40755 << 16, 0o10644 << 16, 0))
            for _ in range(2 if draw.random() < 0.02 else 1):
                file.writestr(info, data)
    return buffer.getvalue()


def flip(draw: random.Random, data: bytes) -> bytes:
    """Bytes overwritten near the structures of the archive: its headers and its directory."""
    content = bytearray(data)
    marks = [found.start() for found in re.finditer(rb"PK\x01\x02|PK\x03\x04|PK\x05\x06", data)]
    for _ in range(draw.choice((1, 2, 10))):
        at = draw.choice(marks or [0]) + draw.randrange(60)
        if at < len(content):
            content[at] = draw.choice((0, 1, 255, draw.randrange(256)))
    return bytes(content)


FIELDS = ((8, "H"), (10, "H"), (16, "I"), (20, "I"), (24, "I"), (42, "I"), (28, "H"), (30, "H"))


def field(draw: random.Random, data: bytes) -> bytes:
    """One number in the directory of the archive replaced: method, flags, sum, sizes, offset."""
    content = bytearray(data)
    places = [found.start() for found in re.finditer(rb"PK\x01\x02", data)]
    if places:
        at = draw.choice(places)
        offset, kind = draw.choice(FIELDS)
        value = draw.choice((0, 1, 8, 12, 14, 99, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, draw.randrange(len(data))))
        struct.pack_into(f"<{kind}", content, at + offset, value & (0xFFFF if kind == "H" else 0xFFFFFFFF))
    return bytes(content)


def cut(draw: random.Random, data: bytes) -> bytes:
    """The end, the beginning or the middle is missing, or something is in front or behind."""
    at = draw.randrange(len(data) + 1)
    length = draw.choice((1, 30, 1000))
    more, middle = b"x" * length, data[:at] + data[at + length :]
    return draw.choice((data[:at], data[at:], middle, more + data, data + more, data * 2))


ARCHIVE: tuple[Callable[[random.Random, bytes], bytes], ...] = (flip, field, field, cut)
