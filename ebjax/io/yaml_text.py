"""YAML from text to plain values. Whatever is wrong with it is one kind of error, and aliases cannot grow it."""

from typing import Any

import yaml

from ebjax.io.json_text import DEEP, MOST_DEPTH, is_deep

MOST_VALUES = 200_000
"""Counted with every alias written out: a few lines of aliases of aliases stand for more than memory holds."""


class PlainLoader(yaml.SafeLoader):
    """PyYAML's safe loader, bounded, which raises yaml.YAMLError where PyYAML raises whatever its conversions do."""

    def fetch_flow_collection_start(self, token: type[yaml.Token]) -> None:
        """An opening bracket; PyYAML's time grows with the square of their depth."""
        self._check_depth()
        super().fetch_flow_collection_start(token)

    def add_indent(self, column: int) -> bool:
        """A list or mapping by its indent."""
        self._check_depth()
        return super().add_indent(column)

    def _check_depth(self) -> None:
        if self.flow_level + len(self.indents) > MOST_DEPTH:
            raise yaml.scanner.ScannerError(None, None, DEEP, self.get_mark())

    def get_single_node(self) -> Any:
        """The document's tree."""
        node = super().get_single_node()
        if node is not None and _count(node, {}) > MOST_VALUES:
            said = f"its aliases stand for more than {MOST_VALUES} values"
            raise yaml.composer.ComposerError(None, None, said, node.start_mark)
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """The value of a node."""
        try:
            return super().construct_object(node, deep)
        except (ValueError, TypeError, LookupError, AttributeError, OverflowError):  # a day that no month has
            kind = node.tag.rpartition(":")[2]
            said = f"{str(node.value)[:40]!r} is no {kind}; put it in quotes if it is a word"
            raise yaml.constructor.ConstructorError(None, None, said, node.start_mark) from None


def parse_yaml(text: str, loader: type[yaml.SafeLoader] = PlainLoader) -> Any:
    """The plain values of a text of one document.

    Raises:
      yaml.YAMLError: it is none; `problem` and `problem_mark` say what and where, if that is known.
    """
    try:
        values = yaml.load(text, Loader=loader)
    except RecursionError:
        raise yaml.MarkedYAMLError(problem=DEEP) from None
    if is_deep(values):
        raise yaml.MarkedYAMLError(problem=DEEP)
    return values


def _count(node: yaml.Node, counts: dict[yaml.Node, float | int]) -> float | int:
    """The values of a tree, those of its aliases each time; infinite where a node is part of itself."""
    if node not in counts:
        counts[node] = float("inf")
        parts = [part for pair in node.value for part in pair] if isinstance(node, yaml.MappingNode) else node.value
        inner = parts if isinstance(node, yaml.CollectionNode) else ()
        counts[node] = 1 + sum(_count(part, counts) for part in inner)
    return counts[node]
