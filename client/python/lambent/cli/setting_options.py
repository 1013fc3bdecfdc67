"""The fields of a model as options of a command, made from their one declaration."""

import inspect
from collections.abc import Callable
from typing import Annotated, Any, TypeVar

import typer
from lambent_core.pictures import Wanted
from lambent_relight.validation import problems_of
from pydantic import ValidationError

from lambent.errors import UsageProblemError

_TYPES = {"string": str, "integer": int, "number": float, "boolean": bool}
_NAMES = {
    "indirect": "--indirect/--direct-only",
    "axes": "--env-axes",
    "layout": "--env-layout",
    "mend": "--mend-env",
}
Model = TypeVar("Model", bound=Wanted)


def takes(parameter: str, model: type[Wanted], **defaults: Any) -> Callable[[Callable[..., None]], Any]:
    """Return a decorator that gives a command every field of `model` as an option, and their values at once.

    The command receives them as `parameter`. `defaults` are those of this command where they are others.
    """
    nodes = model.model_json_schema()["properties"]

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        def run(**given: Any) -> None:
            command(**{parameter: from_options(model, **{name: given.pop(name) for name in nodes})}, **given)

        own = inspect.signature(command, eval_str=True).parameters.values()
        kept = [each.replace(kind=each.KEYWORD_ONLY) for each in own if each.name != parameter]
        options = [_option(name, node, defaults) for name, node in nodes.items()]
        run.__signature__ = inspect.Signature([*kept, *options])  # type: ignore[attr-defined]
        run.__annotations__ = {each.name: each.annotation for each in (*kept, *options)}
        run.__doc__ = command.__doc__
        return run

    return decorate


def from_options(model: type[Model], **values: Any) -> Model:
    """Return a model of the values of options; raises `cli.bad_choice` with all that cannot be used."""
    try:
        return model(**values)
    except ValidationError as error:
        faults = []
        for problem in problems_of(error, model):
            name = problem.pointer.split("/")[1]
            faults.append(f"{_option_name(name)}: {problem.message.removeprefix(f'{name}: ')}")
        raise UsageProblemError("cli.bad_choice", "; ".join(faults), "see --help for every option") from error


def _option_name(name: str) -> str:
    return _NAMES.get(name, f"--{name.replace('_', '-')}").partition("/")[0]


def _option(name: str, node: dict[str, Any], defaults: dict[str, Any]) -> inspect.Parameter:
    limits = f" ({node['minimum']:.10g} to {node['maximum']:.10g})" if "minimum" in node else ""
    text = node["description"] + (f" ({', '.join(node['enum'])})" if "enum" in node else limits)
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=defaults.get(name, node["default"]),
        annotation=Annotated[
            _TYPES[node["type"]], typer.Option(*filter(None, [_NAMES.get(name)]), help=text)
        ],
    )
