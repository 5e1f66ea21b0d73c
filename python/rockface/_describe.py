"""Says what the signature of a stage function is, from the text of its module: nothing of the module is executed.

Reads `{"module": path, "function": name}` from standard input and writes what planning needs to standard output. It runs
without the package being imported, and needs the standard library only.
"""

from __future__ import annotations

import ast
import json
import os
import sys
from importlib import metadata
from importlib.machinery import PathFinder
from typing import Any, NoReturn

KINDS = {
    "Raster": "raster", "DepthMap": "depth", "Mesh": "mesh", "Meshes": "meshes", "Cloud": "cloud", "Surface": "surface",
    "Cameras": "cameras", "Pairs": "pairs", "Transform": "transform", "Covariance": "covariance", "Table": "table",
    "Inventory": "inventory", "Picture": "picture", "Figure": "figure", "File": "file", "Files": "files",
}  # fmt: skip
SIMPLE = {"float": "number", "int": "integer", "bool": "boolean", "str": "text", "Path": "file", "Any": "any"}
LISTS = {"list", "List", "Sequence", "Gathered"}
WAYS = "rockface.Raster, list[rockface.Raster], rockface.Raster | None, float, int, bool, str, Path, Literal, list[float]"


class DescriptionError(Exception):
    """Why a function is no stage, with the parameter of the step it is about."""

    def __init__(self, message: str, path: list[str], known: list[str] | None = None) -> None:
        super().__init__(message)
        self.message, self.path, self.known = message, path, known or []


def refuse(message: str, *path: str, known: list[str] | None = None) -> NoReturn:
    """Ends with a fault of a parameter."""
    raise DescriptionError(message, list(path), known)


def parsed(path: str) -> ast.Module:
    """The syntax tree of a file."""
    try:
        with open(path, "rb") as file:
            return ast.parse(file.read(), path)
    except SyntaxError as error:
        refuse(f"`{path}`, line {error.lineno}: {error.msg}", "module")
    except (OSError, ValueError, RecursionError) as error:
        refuse(f"cannot read `{path}`: {error}", "module")


def last(node: ast.expr) -> str:
    """The last word of `a.b.c`; empty for anything else."""
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def decoration(function: ast.FunctionDef) -> ast.expr | None:
    """The decorator `@rockface.stage` or `@rockface.stage(...)` of a function."""
    for decorator in function.decorator_list:
        called = decorator.func if isinstance(decorator, ast.Call) else decorator
        if last(called) == "stage":
            return decorator
    return None


def found(tree: ast.Module, name: str) -> tuple[ast.FunctionDef, dict[str, ast.expr]]:
    """The function of a name, and the arguments of its decorator."""
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    stages = [node.name for node in functions if isinstance(node, ast.FunctionDef) and decoration(node)]
    own = next((node for node in functions if node.name == name), None)
    if own is None:
        refuse(f"the module has no function `{name}`; its stages are {', '.join(stages) or 'none'}", "function", known=stages)
    decorator = decoration(own) if isinstance(own, ast.FunctionDef) else None
    if not isinstance(own, ast.FunctionDef) or decorator is None:
        refuse(f"`{name}` is no stage: write `@rockface.stage` above a plain `def`", "function", known=stages)
    keywords = decorator.keywords if isinstance(decorator, ast.Call) else []
    return own, {keyword.arg: keyword.value for keyword in keywords if keyword.arg}


def literal(node: ast.expr | None) -> Any:
    """The value of a plain expression such as `0.5` or `["a"]`; raises ValueError for others."""
    if node is None:
        return None
    value = ast.literal_eval(node)
    return list(value) if isinstance(value, tuple) else value


def without_none(node: ast.expr) -> tuple[ast.expr, bool]:
    """The `T` of `T | None` and `Optional[T]`, and whether it was one."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr):
        sides = [node.left, node.right]
        rest = [side for side in sides if not (isinstance(side, ast.Constant) and side.value is None)]
        if len(rest) == 1:
            return rest[0], True
    if isinstance(node, ast.Subscript) and last(node.value) == "Optional":
        return node.slice, True
    return node, False


def parameter(node: ast.expr) -> dict[str, Any] | None:
    """The type of a parameter as planning checks it; `None` for what is no parameter."""
    inner, optional = without_none(node)
    kind: dict[str, Any] | None = None
    if last(inner) in SIMPLE:
        kind = {"type": SIMPLE[last(inner)]}
    elif isinstance(inner, ast.Subscript) and last(inner.value) == "Literal":
        choices = inner.slice.elts if isinstance(inner.slice, ast.Tuple) else [inner.slice]
        kind = {"type": "any", "choices": [literal(choice) for choice in choices]}
    elif isinstance(inner, ast.Subscript) and last(inner.value) in LISTS:
        of = parameter(inner.slice)
        kind = {"type": "list", "of": of} if of else None
    elif isinstance(inner, ast.Subscript) and last(inner.value) == "Annotated" and isinstance(inner.slice, ast.Tuple):
        kind = parameter(inner.slice.elts[0])
        for note in inner.slice.elts[1:]:
            if kind and isinstance(note, ast.Call) and last(note.func) == "Range":
                given = [literal(argument) for argument in note.args]
                named = {keyword.arg: literal(keyword.value) for keyword in note.keywords}
                low, high = [*given, None, None][:2]
                bounds = {"min": named.get("low", low), "max": named.get("high", high)}
                kind.update({key: bound for key, bound in bounds.items() if bound is not None})
    if kind and optional:
        kind["optional"] = True
    return kind


def port(node: ast.expr) -> dict[str, Any] | None:
    """The kind of an input or output; `None` for what is none."""
    inner, optional = without_none(node)
    if last(inner) in KINDS:
        return {"kind": KINDS[last(inner)], **({"optional": True} if optional else {})}
    if isinstance(inner, ast.Subscript) and last(inner.value) in LISTS and last(inner.slice) in KINDS and not optional:
        return {"kind": KINDS[last(inner.slice)], "many": True}
    return None


def annotation(node: ast.expr) -> ast.expr:
    """An annotation, also one that is written as a text."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return ast.parse(node.value, mode="eval").body
    return node


def signature(function: ast.FunctionDef) -> tuple[dict[str, Any], dict[str, Any], bool]:
    """Inputs, types of parameters, and whether the function draws."""
    arguments, name = function.args, function.name
    if arguments.vararg or arguments.kwarg or arguments.posonlyargs:
        refuse(f"`{name}` takes `*` or `/` arguments; a stage names all it takes", "function")
    listed = [*arguments.args, *arguments.kwonlyargs]
    defaults = [*[None] * (len(arguments.args) - len(arguments.defaults)), *arguments.defaults, *arguments.kw_defaults]
    inputs, types, draws = {}, {}, False
    for argument, default in zip(listed, defaults, strict=True):
        if argument.annotation is None:
            refuse(f"`{argument.arg}` of `{name}` has no type: write one of {WAYS}", "function")
        written = annotation(argument.annotation)
        kind, taken = parameter(written), port(written)
        if last(written) == "Random":
            draws = True
        elif taken:
            inputs[argument.arg] = taken
        elif kind:
            if kind["type"] == "file":
                # Which file is read stands in the pipeline: its only default is that there is none.
                if isinstance(default, ast.Constant) and default.value is None:
                    kind["default"] = None
            elif default is not None:
                try:
                    kind["default"] = literal(default)
                except ValueError:
                    refuse(f"the default of `{argument.arg}` of `{name}` is no plain value", "function")
            types[argument.arg] = kind
        else:
            told = ast.unparse(written)
            refuse(f"`{argument.arg}` of `{name}` has the type `{told}`, which is none of {WAYS}, rockface.Random", "function")
    return inputs, types, draws


def outputs(tree: ast.Module, function: ast.FunctionDef, decorated: dict[str, ast.expr]) -> dict[str, Any]:
    """The outputs: one kind, or the fields of a NamedTuple of the module."""
    name = function.name
    if function.returns is None:
        refuse(f"`{name}` does not say what it returns: for example `-> rockface.Raster`", "function")
    returned = annotation(function.returns)
    one = port(returned)
    if one and set(one) == {"kind"}:
        own = literal(decorated.get("output")) or one["kind"]
        return {str(own): one}
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == last(returned)]
    if not classes or not any(last(base) == "NamedTuple" for base in classes[0].bases):
        told = ast.unparse(returned)
        message = f"`{name}` returns `{told}`; a stage returns an artefact such as rockface.Raster, or a NamedTuple of this module"
        refuse(message, "function")
    fields = {}
    for line in classes[0].body:
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name):
            kind = port(annotation(line.annotation))
            if not kind or set(kind) != {"kind"}:
                refuse(f"`{line.target.id}` of `{classes[0].name}` is `{ast.unparse(line.annotation)}`, no artefact", "function")
            fields[line.target.id] = kind
    return fields


def imports(tree: ast.Module, package: str) -> set[str]:
    """Dotted names a module imports; relative ones are completed by its package."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = package.split(".")[: len(package.split(".")) - node.level + 1] if package else []
                base = ".".join([*parents, *([base] if base else [])])
            names |= {base, *(f"{base}.{alias.name}" if base else alias.name for alias in node.names)}
    return {name for name in names if name}


def installed(path: str) -> bool:
    """Whether a file belongs to Python or to an installed package."""
    parts = os.path.normpath(path).split(os.sep)
    standard = os.path.dirname(os.__file__)
    return "site-packages" in parts or "dist-packages" in parts or os.path.normpath(path).startswith(standard + os.sep)


def local(name: str, folder: str) -> list[tuple[str, str]]:
    """The files of a dotted name below a folder of the user's own, with those of the packages it lies in."""
    files, place = [], folder
    parts = name.split(".")
    for depth, part in enumerate(parts):
        dotted, base = ".".join(parts[: depth + 1]), os.path.join(place, part)
        if os.path.isfile(os.path.join(base, "__init__.py")):
            files.append((dotted, os.path.join(base, "__init__.py")))
            place = base
        elif os.path.isfile(base + ".py"):
            files.append((dotted, base + ".py"))
            break
        elif os.path.isdir(base) and depth + 1 < len(parts):
            place = base
        else:
            break
    return files


def elsewhere(top: str) -> str | None:
    """The folder of a top-level name that lies on the search path, but in no installed package (such as a package that is
    installed as a link to its sources).
    """
    if top in sys.stdlib_module_names or top == "rockface":
        return None
    spec = PathFinder.find_spec(top)
    origin = spec.origin if spec else None
    if origin is None or not origin.endswith(".py") or installed(origin):
        return None
    folder = os.path.dirname(origin)
    return os.path.dirname(folder) if os.path.basename(origin) == "__init__.py" else folder


def sources(module: str, tree: ast.Module) -> tuple[dict[str, str], set[str]]:
    """Files of the user's own that a module imports, by dotted name, and the top-level names of all other imports."""
    own = os.path.dirname(module)
    files: dict[str, str] = {}
    others: set[str] = set()
    waiting = [(name, own) for name in imports(tree, "")]
    while waiting:
        name, folder = waiting.pop()
        met = local(name, folder)
        if not met:
            top = name.split(".")[0]
            place = elsewhere(top)
            met = local(name, place) if place else []
            if not met:
                others.add(top)
                continue
            folder = place or folder
        for dotted, file in met:
            if os.path.normpath(file) == os.path.normpath(module) or dotted in files:
                continue
            files[dotted] = file
            package = dotted if file.endswith("__init__.py") else dotted.rpartition(".")[0]
            waiting += [(further, folder) for further in imports(parsed(file), package)]
    return files, others


def versions(names: set[str], needed: set[str], declared: list[str]) -> dict[str, str]:
    """Versions of Python, of the packages that hold these top-level names, and of those the decorator declares.

    One that is not there is a fault if the module imports it always; inside a function it may never be wanted.
    """
    told = {"python": ".".join(map(str, sys.version_info[:3]))}
    foreign = {name for name in names if name not in sys.stdlib_module_names and name != "__future__"}
    holders: dict[str, list[str]] | None = None
    for name in sorted(foreign):
        try:
            told[name] = metadata.version(name)
            continue
        except metadata.PackageNotFoundError:
            pass
        if holders is None:
            holders = dict(metadata.packages_distributions())
        for package in holders.get(name, []):
            told[package] = metadata.version(package)
        if name not in holders and name in needed and name != "rockface":
            refuse(f"the module imports `{name}`, which is not installed in {sys.executable}", "module")
        if name not in holders:
            told[name] = "not installed"
    for package in declared:
        try:
            told[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            refuse(f"the stage declares the package `{package}`, which is not installed in {sys.executable}", "function")
    return told


def described(module: str, name: str) -> dict[str, Any]:
    """All that planning needs to know of a function."""
    tree = parsed(module)
    function, decorated = found(tree, name)
    inputs, types, draws = signature(function)
    made = outputs(tree, function, decorated)
    files, others = sources(module, tree)
    packages = literal(decorated.get("packages")) or []
    always = ast.Module([node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)], [])
    needed = {name.split(".")[0] for name in imports(always, "")}
    folders = [folder for folder in sys.path if os.path.isdir(folder) and installed(os.path.join(folder, ""))]
    return {
        "inputs": inputs,
        "outputs": made,
        "types": types,
        "draws": draws,
        "sources": files,
        "packages": versions(others, needed, packages),
        # An upgrade of a package renames the folder of its metadata.
        "rests_on": [module, *files.values(), *(folder for folder in folders if "-packages" in folder)],
    }


def main() -> None:
    """Answers one question."""
    question = json.load(sys.stdin)
    try:
        answer = described(question["module"], question["function"])
    except DescriptionError as fault:
        answer = {"fault": {"path": fault.path, "message": fault.message, "known": fault.known}}
    except (ValueError, SyntaxError) as error:
        message = f"the signature of `{question['function']}` cannot be read without running it: {error}"
        answer = {"fault": {"path": ["function"], "message": message}}
    json.dump(answer, sys.stdout)


if __name__ == "__main__":
    main()
