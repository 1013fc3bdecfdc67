"""Write the reflectance that Python and the browser share, as TypeScript and as GLSL.

python scripts/shared_reflectance.py FOLDER    writes reflectance.ts and reflectance.glsl (`npm run schema`)

`lambent_relight.brdf_kernels` states it. Its functions of numbers are translated one by one: assignments, a
return, arithmetic, whole powers, `max`, `min`, `math.sqrt` and `math.pi`. Anything else is refused, and so is
a name that is neither a parameter, a local nor a constant of `shared_constants`.
"""

import ast
import re
import sys
from pathlib import Path

from shared_constants import SHARED

SOURCE = Path(__file__).parents[1] / "client/python/lambent_relight/brdf_kernels.py"
FUNCTIONS = ("base_reflectance", "schlick_weight", "ggx_density", "shadowing", "specular_cos")
CONSTANTS = {name: other or name for name, other in SHARED["brdf"].items()}
# What GLSL has under the same name, and where TypeScript has it.
BUILT_IN = {"max": "Math.max", "min": "Math.min", "math.sqrt": "Math.sqrt", "math.pi": "Math.PI"}
ALLOWED = (ast.BinOp, ast.Constant, ast.Call, ast.Load, ast.Add, ast.Sub, ast.Mult, ast.Div)


def camel(name: str) -> str:
    """Return a name of Python as the browser writes it."""
    return re.sub(r"_([a-z0-9])", lambda match: match[1].upper(), name.lower())


class Expressions(ast.NodeTransformer):
    """Names and calls of one function as the browser has them; `powers` collects its exponents."""

    def __init__(self, known: set[str], powers: set[int], *, shader: bool) -> None:
        self.known = known
        self.powers = powers
        self.shader = shader

    def text(self, node: ast.expr) -> str:
        """Return an expression; but for names, Python, TypeScript and GLSL write it alike."""
        return ast.unparse(self.visit(node))

    def generic_visit(self, node: ast.AST) -> ast.AST:
        """Refuse what only Python has."""
        if not isinstance(node, ALLOWED):
            raise ValueError(f"{ast.unparse(node)} cannot be translated")
        return super().generic_visit(node)

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id in self.known or node.id in FUNCTIONS:
            return ast.Name(camel(node.id))
        if node.id in CONSTANTS:
            return ast.Name(CONSTANTS[node.id] if self.shader else camel(CONSTANTS[node.id]))
        return self._built_in(node)

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        return self._built_in(node)

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        if not isinstance(node.op, ast.Pow):
            return self.generic_visit(node)
        if not (isinstance(node.right, ast.Constant) and isinstance(node.right.value, int)):
            raise ValueError(f"{ast.unparse(node)} is not a whole power")
        self.powers.add(node.right.value)
        return ast.Call(ast.Name(f"power{node.right.value}"), [self.visit(node.left)], [])

    def _built_in(self, node: ast.expr) -> ast.expr:
        name = ast.unparse(node)
        if name not in BUILT_IN:
            raise ValueError(f"{name} is unknown")
        return ast.Name(name.rpartition(".")[2] if self.shader else BUILT_IN[name])


def function(name: str, arguments: list[str], steps: list[str], text: str, *, shader: bool) -> str:
    """Return a function of numbers; those with a comment are for other modules."""
    body = "\n".join(f"  {step};" for step in steps)
    if shader:
        typed = ", ".join(f"float {each}" for each in arguments)
        return (f"// {text}\n" if text else "") + f"float {name}({typed}) {{\n{body}\n}}\n"
    typed = ", ".join(f"{each}: number" for each in arguments)
    before = f"/** {text} */\nexport " if text else ""
    return f"{before}function {name}({typed}): number {{\n{body}\n}}\n"


def translated(source: str, *, shader: bool) -> str:
    """Return the functions of a module of Python, and before them the powers that they take."""
    nodes = {node.name: node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)}
    powers: set[int] = set()
    functions = []
    for name in FUNCTIONS:
        arguments = [argument.arg for argument in nodes[name].args.args]
        expressions, steps = Expressions(set(arguments), powers, shader=shader), []
        for node in nodes[name].body[1:]:
            match node:
                case ast.Assign(targets=[ast.Name(id=local)], value=value):
                    steps.append(
                        f"{'float' if shader else 'const'} {camel(local)} = {expressions.text(value)}"
                    )
                    expressions.known.add(local)
                case ast.Return(value=ast.expr() as value):
                    steps.append(f"return {expressions.text(value)}")
                case _:
                    raise ValueError(f"{ast.unparse(node)} cannot be translated")
        text = ast.get_docstring(nodes[name]) or ""
        functions.append(function(camel(name), [*map(camel, arguments)], steps, text, shader=shader))
    # Products cost less than a general power.
    for exponent in sorted(powers, reverse=True):
        product = f"return {' * '.join(['value'] * exponent)}"
        functions.insert(0, function(f"power{exponent}", ["value"], [product], "", shader=shader))
    return "\n".join(functions)


def main(folder: Path) -> None:
    """Write both files."""
    note = "// Generated by scripts/shared_reflectance.py from lambent_relight/brdf_kernels.py.\n"
    source = SOURCE.read_text(encoding="utf-8")
    script = translated(source, shader=False)
    used = sorted({camel(each) for each in CONSTANTS.values()} & set(re.findall(r"\w+", script)))
    imported = f'import {{ {", ".join(used)} }} from "./constants.js";\n\n'
    (folder / "reflectance.ts").write_text(note + imported + script, encoding="utf-8")
    (folder / "reflectance.glsl").write_text(note + translated(source, shader=True), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
