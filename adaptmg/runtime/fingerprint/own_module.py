"""A module of the user's of which one cannot say what is used: its whole text, and all that it imports.

Comments, docstrings, and the annotations of functions play no part.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field

from adaptmg.runtime.fingerprint.instructions import code_text
from adaptmg.runtime.fingerprint.loaded import Given, given

__all__ = ["OwnText", "own_text"]


@dataclass(frozen=True)
class OwnText:
    """What counts of a module.

    Attributes
    ----------
    content : str
    imports : list of str
        Full names; whether the last part of one is a module or a name in it, the text does not say.
    given : Given
        What it gives its names.
    """

    content: str
    imports: list[str] = field(default_factory=list)
    given: Given = field(default_factory=Given)


def own_text(text: str, name: str, package: str) -> OwnText:
    """Read a module.

    Parameters
    ----------
    text, name : str
        Of the module.
    package : str
        In which relative imports look.
    """
    try:
        tree = ast.parse(text, name)
        imports = list(dict.fromkeys(_imports(tree, package)))
        code = compile(_Plain().visit(tree), name, "exec", dont_inherit=True, optimize=2)
    except (SyntaxError, ValueError, RecursionError):
        return OwnText(text)
    return OwnText(code_text(code), imports, given(compile(text, name, "exec", dont_inherit=True)))


def _imports(tree: ast.AST, package: str) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")
            outer = ".".join(parents[:len(parents) - node.level + 1]) if node.level else ""
            base = ".".join(filter(None, (outer, node.module)))
            yield from (base if alias.name == "*" else f"{base}.{alias.name}" for alias in node.names)


class _Plain(ast.NodeTransformer):
    """Without annotations of functions."""

    def visit_FunctionDef(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> ast.AST:
        given = node.args
        for argument in (*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg):
            if argument is not None:
                argument.annotation = None
        node.returns = None
        return self.generic_visit(node)

    visit_AsyncFunctionDef = visit_FunctionDef
