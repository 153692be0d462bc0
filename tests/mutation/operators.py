"""Small changes to a module's code, one at a time: what they are, where they can be made, and the code with one made.

Nothing runs here. Text is left alone, and so are messages, logging, annotations and decorators: a test need not notice
those.
"""

import ast
import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

COMPARE: dict[type, tuple[type, ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
}
ARITHMETIC: dict[type, tuple[type, ...]] = {
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.FloorDiv: (ast.Mult,),
    ast.Mod: (ast.FloorDiv,),
    ast.Pow: (ast.Mult,),
    ast.BitAnd: (ast.BitOr,),
    ast.BitOr: (ast.BitAnd,),
}
NAMES = {
    one: other
    for pair in (
        "min max",
        "any all",
        "argmin argmax",
        "amin amax",
        "nanmin nanmax",
        "minimum maximum",
        "clamp_min clamp_max",
        "sum mean",
        "floor ceil",
        "cos sin",
        "zeros ones",
        "zeros_like ones_like",
    )
    for one, other in (pair.split(), pair.split()[::-1])
}
NUMBERS = ("float", "int", "Tensor", "torch.Tensor", "np.ndarray")
EITHER_WAY = ("min", "max", "minimum", "maximum", "logical_and", "logical_or", "array_equal")
"""Functions for which the order of what they are given is nothing."""
QUIET = ("log", "logging", "warnings")


@dataclass(frozen=True)
class Mutant:
    """One change of one module."""

    module: str
    """Path within the package."""
    line: int
    function: str
    """Where it is, by name; "" at the top."""
    kind: str
    before: str
    after: str
    index: int
    """Of the node, in the order of `ast.walk`."""
    variant: int

    @property
    def name(self) -> str:
        """What it is called in results and among the equivalent ones: it stays when lines move."""
        return f"{self.module} {self.function}: {self.kind}: {self.before} -> {self.after}"


Change = tuple[str, Callable[[ast.AST], ast.AST | list]]
"""The kind of a change, and what makes the new node of a copy of the old."""


def mutants_of(module: str, source: str, strict: frozenset[str] = frozenset()) -> list[list[Mutant]]:
    """All mutants of a module, those of one node together.

    `strict` are functions that need all of their arguments: to leave one out would be a mistake that any call notices.
    """
    tree = ast.parse(source)
    where, skipped, seen, found = _places(tree), _skipped(tree), {}, []  # type: ignore[var-annotated]
    for index, node in enumerate(ast.walk(tree)):
        if id(node) in skipped:
            continue
        needed = isinstance(node, ast.Call) and _called(node) in strict
        own = []
        for variant, (kind, change) in enumerate(_changes(node, where[id(node)][1])):
            after = change(copy.deepcopy(node))
            texts = [_text(node), " ".join(_text(a) for a in after) if isinstance(after, list) else _text(after)]
            if texts[0] == texts[1] or (needed and kind == "argument left out"):
                continue
            line = getattr(node, "lineno", 0) or getattr(getattr(node, "iter", None), "lineno", 0)
            mutant = Mutant(module, line, where[id(node)][0], kind, *texts, index, variant)
            count = seen[mutant.name] = seen.get(mutant.name, 0) + 1
            own.append(replace(mutant, kind=f"{kind} no. {count}") if count > 1 else mutant)
        if own:
            found.append(own)
    return found


def mutated(source: str, mutant: Mutant) -> str:
    """The module's code with the change made."""
    tree = ast.parse(source)
    nodes = list(ast.walk(tree))
    where = _places(tree)
    node = nodes[mutant.index]
    _, change = _changes(node, where[id(node)][1])[mutant.variant]
    new = change(copy.deepcopy(node))
    for parent in nodes:
        for field, value in ast.iter_fields(parent):
            if value is node:
                setattr(parent, field, new)
            elif isinstance(value, list) and any(item is node for item in value):
                place = next(k for k, item in enumerate(value) if item is node)
                value[place : place + 1] = new if isinstance(new, list) else [new]
    return ast.unparse(ast.fix_missing_locations(tree))


def _text(node: ast.AST) -> str:
    if isinstance(node, (ast.If, ast.While)):
        return f"if {_text(node.test)}"
    text = " ".join(ast.unparse(ast.fix_missing_locations(node)).split())
    return text if len(text) <= 90 else f"{text[:43]} ... {text[-42:]}"


def _places(tree: ast.Module) -> dict[int, tuple[str, ast.AST | None]]:
    """By node, the names of the classes and functions it is in, and the innermost function."""
    places: dict[int, tuple[str, ast.AST | None]] = {}

    def visit(node: ast.AST, name: str, function: ast.AST | None) -> None:
        places[id(node)] = (name, function)
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            name = f"{name}.{node.name}" if name else node.name
            function = node if isinstance(node, ast.FunctionDef) else function
        for child in ast.iter_child_nodes(node):
            visit(child, name, function)

    visit(tree, "", None)
    return places


def _skipped(tree: ast.Module) -> set[int]:
    """Nodes that stay: annotations, decorators, imports, assertions, what is raised, logged, or part of formatted text."""
    roots: list[ast.AST] = []
    for node in ast.walk(tree):
        if isinstance(node, (ast.Import, ast.ImportFrom, ast.Assert, ast.Raise, ast.JoinedStr)) or _says(node):
            roots.append(node)
        elif isinstance(node, (ast.arg, ast.AnnAssign)) and node.annotation:
            roots.append(node.annotation)
        elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            roots += node.decorator_list
            roots += [node.returns] if isinstance(node, ast.FunctionDef) and node.returns else []
    return {id(inner) for root in roots for inner in ast.walk(root)}


def _says(node: ast.AST) -> bool:
    """A docstring, a line of the log, or a type by another name, as `Predict = Callable[...]`."""
    if isinstance(node, ast.Expr):
        called = node.value.func if isinstance(node.value, ast.Call) else None
        owner = called.value if isinstance(called, ast.Attribute) else None
        return isinstance(node.value, ast.Constant) or (isinstance(owner, ast.Name) and owner.id in QUIET)
    root = node.value.value if isinstance(node, ast.Assign) and isinstance(node.value, ast.Subscript) else None
    return isinstance(root, ast.Name) and root.id in ("Annotated", "Callable", "Literal", "Mapping", "tuple", "dict")


def _changes(node: ast.AST, function: ast.AST | None) -> list[Change]:
    return [*_of_operators(node), *_of_values(node), *_of_calls(node), *_of_statements(node, function)]


def _put(field: str, value: object) -> Callable[[ast.AST], ast.AST]:
    def change(node: ast.AST) -> ast.AST:
        setattr(node, field, value)
        return node

    return change


def _of_operators(node: ast.AST) -> Iterator[Change]:
    if isinstance(node, ast.Compare):
        for k, operator in enumerate(node.ops):
            for other in COMPARE[type(operator)]:
                yield "comparison", _put("ops", [other() if i == k else op for i, op in enumerate(node.ops)])
    elif isinstance(node, (ast.BinOp, ast.AugAssign)) and not _is_path(node):
        for other in ARITHMETIC.get(type(node.op), ()):
            yield "arithmetic", _put("op", other())
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
            yield "arithmetic", lambda n: n.left  # type: ignore[attr-defined]
    elif isinstance(node, ast.BoolOp):
        yield "and, or", _put("op", ast.And() if isinstance(node.op, ast.Or) else ast.Or())
        for k in range(len(node.values)):
            yield "condition left out", _without(node, k)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.Not, ast.USub, ast.Invert)):
        yield "sign or not", lambda n: n.operand  # type: ignore[attr-defined]
    elif isinstance(node, (ast.If, ast.While, ast.IfExp)):
        yield "condition turned", _put("test", ast.UnaryOp(ast.Not(), node.test))
    elif isinstance(node, ast.comprehension) and node.ifs:
        yield "filter left out", _put("ifs", node.ifs[1:])


def _is_path(node: ast.BinOp | ast.AugAssign) -> bool:
    """Paths are joined by /, and their parts are text: nothing else can be done with those."""
    right = node.right if isinstance(node, ast.BinOp) else node.value
    text = isinstance(right, ast.JoinedStr) or (isinstance(right, ast.Constant) and isinstance(right.value, str))
    return isinstance(node.op, ast.Div) and text


def _without(node: ast.BoolOp, index: int) -> Callable[[ast.AST], ast.AST]:
    left = [value for k, value in enumerate(node.values) if k != index]
    return lambda _: left[0] if len(left) == 1 else ast.BoolOp(node.op, left)


def _of_values(node: ast.AST) -> Iterator[Change]:
    if isinstance(node, ast.Constant):
        value = node.value
        if isinstance(value, bool):
            yield "constant", _put("value", not value)
        elif isinstance(value, int):
            for other in dict.fromkeys((value + 1, value - 1, 0)):
                yield "constant", _put("value", other)
        elif isinstance(value, float):
            for other in (value * 2, 0.0) if value else (1.0,):
                yield "constant", _put("value", other)
    elif isinstance(node, (ast.Attribute, ast.Name)) and isinstance(node.ctx, ast.Load):
        field = "attr" if isinstance(node, ast.Attribute) else "id"
        if (name := getattr(node, field)) in NAMES:
            yield "name", _put(field, NAMES[name])
    elif isinstance(node, ast.Slice):
        for field in ("lower", "upper"):
            bound = getattr(node, field)
            if bound is not None and not isinstance(bound, ast.Constant):
                yield "slice", _put(field, ast.BinOp(bound, ast.Add(), ast.Constant(1)))
            if bound is not None:
                yield "slice", _put(field, None)
    elif isinstance(node, (ast.Tuple, ast.List)) and isinstance(node.ctx, ast.Load) and len(node.elts) > 1:
        for k in range(len(node.elts) - 1):
            yield "items swapped", _put("elts", _swapped(node.elts, k))
    elif isinstance(node, ast.Dict) and len(node.keys) > 1:
        for k in range(len(node.keys) - 1):
            yield "values swapped", _put("values", _swapped(node.values, k))


def _swapped(items: list, index: int) -> list:
    return [*items[:index], items[index + 1], items[index], *items[index + 2 :]]


def _of_calls(node: ast.AST) -> Iterator[Change]:
    if not isinstance(node, ast.Call):
        return
    for k in range(len(node.args) - 1) if _called(node) not in EITHER_WAY else ():
        yield "arguments swapped", _put("args", _swapped(node.args, k))
    for k, keyword in enumerate(node.keywords):
        if keyword.arg and keyword.arg != "description":
            yield "argument left out", _put("keywords", [w for i, w in enumerate(node.keywords) if i != k])
    if len(node.args) > 1 and not isinstance(node.args[-1], ast.Starred):
        yield "argument left out", _put("args", node.args[:-1])


def strict_functions(source: str) -> set[str]:
    """Functions and classes of a module that have no argument to leave out."""
    nodes = [node for node in ast.walk(ast.parse(source)) if isinstance(node, (ast.FunctionDef, ast.ClassDef))]
    return {n.name for n in nodes if isinstance(n, ast.ClassDef) or not (n.args.defaults or n.args.vararg)}


def _called(node: ast.Call) -> str:
    return getattr(node.func, "attr", getattr(node.func, "id", ""))


def _of_statements(node: ast.AST, function: ast.AST | None) -> Iterator[Change]:
    if isinstance(node, ast.Return) and node.value is not None:
        kind = ast.unparse(function.returns) if isinstance(function, ast.FunctionDef) and function.returns else ""
        if kind == "bool":
            yield "result turned", _put("value", ast.UnaryOp(ast.Not(), node.value))
        elif kind in NUMBERS:
            yield "result turned", _put("value", ast.UnaryOp(ast.USub(), node.value))
        elif kind.startswith("list["):
            yield (
                "result turned",
                _put("value", ast.Subscript(node.value, ast.Slice(step=ast.Constant(-1)), ast.Load())),
            )
    elif isinstance(node, ast.Continue):
        yield "statement", lambda _: ast.Break()
    elif isinstance(node, ast.Break):
        yield "statement", lambda _: ast.Pass()
    elif isinstance(node, ast.AugAssign) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)):
        yield "statement left out", lambda _: ast.Pass()
