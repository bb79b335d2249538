"""YAML that nobody vouches for: plain values alone, of bounded size and depth, and no word of it is run."""

from __future__ import annotations

from typing import Any

import yaml
from yaml.nodes import Node, ScalarNode

from legtool_runtime.errors import one_line

#: Characters of a text, nodes that it stands for with what its aliases repeat, and how deep they nest.
MOST_CHARACTERS, MOST_NODES, DEEPEST = 64_000_000, 1_000_000, 100
_MOST_DIGITS = 30


class _Loader(yaml.SafeLoader):
    """A safe loader without dates, and within bounds."""

    yaml_implicit_resolvers = {  # noqa: RUF012  PyYAML's own attribute, a dict there too
        first: [(tag, pattern) for tag, pattern in resolvers if tag != "tag:yaml.org,2002:timestamp"]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth, self._nodes = 0, 0
        self._held: dict[int, int] = {}

    def compose_node(self, parent: Node | None, index: int) -> Node | None:
        before = self._nodes
        alias = self.check_event(yaml.AliasEvent)
        self._depth += 1
        if self._depth > DEEPEST:
            raise yaml.YAMLError(f"nests deeper than {DEEPEST}")
        node = super().compose_node(parent, index)
        self._depth -= 1
        if alias and id(node) not in self._held:
            raise yaml.YAMLError("holds itself")
        self._nodes += self._held[id(node)] if alias else 1
        if self._nodes > MOST_NODES:
            raise yaml.YAMLError(f"stands for more than {MOST_NODES} values")
        if not alias:
            self._held[id(node)] = self._nodes - before
        return node

    def construct_yaml_int(self, node: ScalarNode) -> int:
        if len(str(node.value)) > _MOST_DIGITS:
            raise yaml.YAMLError(f"a number of more than {_MOST_DIGITS} digits")
        return int(super().construct_yaml_int(node))


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)


def parse_yaml(text: str) -> Any:
    """Plain values of a YAML text.

    Raises:
        ValueError: not YAML, or beyond the bounds; the message is one short line.
    """
    if len(text) > MOST_CHARACTERS:
        raise ValueError(f"has {len(text)} characters, expected at most {MOST_CHARACTERS}")
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        told = getattr(error, "problem", None) or (None if mark else str(error))
        where = f" at line {mark.line + 1}" if mark else ""
        raise ValueError(f"not valid YAML{where}{f' ({one_line(told)})' if told else ''}") from error
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError) as error:  # of a tag and its value
        raise ValueError(f"not valid YAML ({one_line(str(error))})") from error
