"""Every message of the package as its source says it: code, severity, and the words between the values."""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "emps_design"
SEVERITIES = ("note", "warning", "grave", "wrong")  # the functions that make a message


@dataclass(frozen=True)
class Made:
    """A place in the package that makes a message: its ``code``, ``severity`` and ``module``, and its text.

    ``texts`` are its words, {} for each value, one for each way in which it may be put together.
    """

    code: str
    severity: str
    module: str
    texts: tuple[str, ...]


def messages() -> list[Made]:
    """Every place that makes a message."""
    return [made for module in sorted(PACKAGE.rglob("*.py")) for made in _of(module)]


def _of(module: Path) -> Iterator[Made]:
    tree = ast.parse(module.read_text(encoding="utf-8"))
    imported = {
        name.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module == "emps_design.messages"
        for name in node.names
    }
    for scope in ast.walk(tree):
        if not isinstance(scope, ast.Module | ast.FunctionDef):
            continue
        calls = [node for node in _inside(scope) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
        for call in sorted(calls, key=lambda call: call.lineno):
            if call.func.id in SEVERITIES and call.func.id in imported:
                code, text = call.args
                assert isinstance(code, ast.Constant), f"{module}:{call.lineno}: expected a code, not an expression"
                name = str(module.relative_to(PACKAGE))
                yield Made(code.value, call.func.id, name, tuple(_words(text, (scope, tree), call.lineno)))


def _inside(scope: ast.AST) -> Iterator[ast.AST]:
    """The nodes of a module or function but for those of functions in it."""
    for node in ast.iter_child_nodes(scope):
        if not isinstance(node, ast.FunctionDef):
            yield node
            yield from _inside(node)


def _words(text: ast.expr, scopes: tuple[ast.AST, ...], line: int) -> Iterator[str]:
    """The words of ``text`` at a ``line``, and of the names in it; those of values that are computed are unknown."""
    match text:
        case ast.Constant():
            yield str(text.value)
        case ast.JoinedStr():
            yield "".join(part.value if isinstance(part, ast.Constant) else "{}" for part in text.values)
            for part in text.values:
                if isinstance(part, ast.FormattedValue) and isinstance(part.value, ast.Name):
                    yield from _words(part.value, scopes, line)
        case ast.IfExp():
            yield from (*_words(text.body, scopes, line), *_words(text.orelse, scopes, line))
        case ast.BinOp():
            yield from (*_words(text.left, scopes, line), *_words(text.right, scopes, line))
        case ast.Call(func=ast.Name()):  # of a text that is filled in
            for part in text.args:
                yield from _words(part, scopes, line)
        case ast.Name():
            for value, there in _assigned(text.id, scopes, line):
                yield from _words(value, scopes, there)


def _assigned(name: str, scopes: tuple[ast.AST, ...], line: int) -> list[tuple[ast.expr, int]]:
    """What was last assigned to ``name`` before ``line`` and added to it, innermost scope first, with its lines."""
    for scope in scopes:
        values = []
        for node in sorted(_inside(scope), key=lambda node: getattr(node, "lineno", 0)):
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            own = any(isinstance(target, ast.Name) and target.id == name for target in targets)
            if own and isinstance(node, ast.Assign | ast.AugAssign) and node.lineno < line:
                values = [*(values if isinstance(node, ast.AugAssign) else []), (node.value, node.lineno)]
        if values:
            return values
    return []
