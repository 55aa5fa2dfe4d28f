"""YAML as people write it for this program: every key once, nothing that stands for more than is written.

A few lines of YAML can mean more than a computer holds, where one list names another several times and that one the
next, and a line of a few million digits keeps a processor busy for hours. None of that is needed to describe a
campaign, a scene or a laboratory, so none of it is read.
"""

from collections.abc import Sequence
from typing import Any

import yaml

LARGEST = 4_000_000
"""Characters above which no description is read."""

_LONGEST_NUMBER = 100
"""Characters of a number; no quantity that is meant has more."""

_NUMBERS = {"tag:yaml.org,2002:int", "tag:yaml.org,2002:float"}


def parsed_yaml(text: str) -> object:
    """What the text of a YAML or JSON file holds.

    Raises `ValueError` with what is wrong as the end of a sentence that begins with the name of the file.
    """
    if len(text) > LARGEST:
        raise ValueError(f"is longer than {LARGEST / 1e6:g} million characters; nothing that is described here is")
    try:
        return yaml.load(text, _Loader)  # nosec B506 # a SafeLoader that reads less
    except yaml.YAMLError as error:
        mark = error.problem_mark if isinstance(error, yaml.MarkedYAMLError) else None
        where = "" if mark is None else f" in line {mark.line + 1}"
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        if "<block" in problem:  # the parser's word for what ends or begins too early
            problem = f"{problem}; keys that belong together must begin in the same column"
        raise ValueError(f"is not valid YAML{where}: {problem}") from None
    except RecursionError:
        raise ValueError("is nested too deeply; a few levels say everything") from None
    except (ValueError, LookupError, AttributeError) as error:  # what the loader lets through of an impossible value
        raise ValueError(f"holds a value that is not possible ({error}); write a text in quotes") from None


def line_of(text: str, path: Sequence[int | str]) -> int:
    """Line, counted from 1, of the key or item to which `path` leads in a text that `parsed_yaml` reads.

    That of what holds it where it is missing.
    """
    node = yaml.compose(text, _Loader)
    assert node is not None  # there is something in the text
    line: int = node.start_mark.line
    for part in path:
        if isinstance(node, yaml.MappingNode):
            found = next(((key, value) for key, value in node.value if key.value == part), None)
            if found is not None:  # or it is missing, or a name of the model that nobody writes
                line, node = found[0].start_mark.line, found[1]
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            node = node.value[part]
            line = node.start_mark.line
    return line + 1


class _Loader(yaml.SafeLoader):
    """Refuses a key that is given twice, of which the standard loader silently keeps the last, and all aliases."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise yaml.MarkedYAMLError(None, None, f'the key "{key.value}" is given twice', key.start_mark)
                seen.add(key.value)
        return super().construct_mapping(node, deep)

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]  # of the library
            raise yaml.MarkedYAMLError(None, None, "an alias is not read here; write out what it stands for", mark)
        node = super().compose_node(parent, index)
        if isinstance(node, yaml.ScalarNode) and node.tag in _NUMBERS and len(node.value) > _LONGEST_NUMBER:
            problem = f"a number of {len(node.value)} digits is not possible; write a text in quotes"
            raise yaml.MarkedYAMLError(None, None, problem, node.start_mark)
        return node
