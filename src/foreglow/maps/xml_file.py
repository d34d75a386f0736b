"""XML files and the numbers in them, with errors that name the element."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from foreglow.files import MIB, number_in, read_bytes

MAX_XML_BYTES = 64 * MIB
"""Largest map: that of a city."""

MAX_XML_ITEMS = MAX_XML_BYTES // 16
"""Elements and attributes, which take 160 bytes each; a map has a longer name and value for each than 16 bytes."""


def read_xml(path: Path, root: str) -> Element:
    """The XML file `path`, whose outermost element is called `root`.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not XML, has another root, or is beyond a bound.
    """
    data = read_bytes(path, MAX_XML_BYTES)
    if b"<!DOCTYPE" in data or b"\0" in data:  # entities of their own, or an encoding that hides them
        raise ValueError(f"{path}: expected XML without a document type, in UTF-8")
    num_items = data.count(b"<") + data.count(b"=")
    if num_items > MAX_XML_ITEMS:
        raise ValueError(f"{path}: expected at most {MAX_XML_ITEMS} elements and attributes, got {num_items}")
    try:
        element = ElementTree.fromstring(data)
    except (ElementTree.ParseError, LookupError, ValueError) as error:  # the latter two for strange encodings
        raise ValueError(f"{path}: expected XML: {error}") from None
    if element.tag != root:
        raise ValueError(f"{path}: expected XML with the root <{root}>, got <{element.tag}>")
    return element


def number_of(element: Element, name: str, origin: str, default: float | None = None) -> float:
    """The number in the attribute `name` of an element.

    Args:
        element: The element.
        name: The attribute.
        origin: Path and element, for messages.
        default: Value of a missing attribute; None if it must not be missing.

    Raises:
        ValueError: If it is missing, or not a finite number.
    """
    text = element.get(name)
    if text is None and default is not None:
        return default
    try:
        value = number_in(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        got = "nothing" if text is None else repr(text)
        raise ValueError(f"{origin}: <{element.tag}> {name}: expected a finite number, got {got}")
    return value
