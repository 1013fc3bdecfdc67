"""The settings of a picture as options, made from their one declaration."""

import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer
from lambent_core.pictures import RenderSettings
from lambent_relight.settings import settled

from lambent.cli.rendering import check_choice, relight_errors

_TYPES = {"string": str, "integer": int, "number": float, "boolean": bool}
_SWITCHES = {"indirect": "--indirect/--direct-only"}


def takes_settings(**defaults: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that gives a command every setting as an option, and its value as `settings`.

    `defaults` are those of this command where they are others. Raises `cli.bad_choice` for a word that is
    none of the choices, and the code of the setting for a number out of range.
    """
    schema = RenderSettings.model_json_schema()["properties"]

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        def run(**given: Any) -> None:
            chosen = {name: given.pop(name) for name in schema}
            for name, node in schema.items():
                if "enum" in node:
                    check_choice(f"--{name.replace('_', '-')}", chosen[name], node["enum"])
            with relight_errors():
                settings = settled(**chosen)
            command(settings=settings, **given)

        options = [_option(name, node, defaults) for name, node in schema.items()]
        own = inspect.signature(command, eval_str=True).parameters
        before = [each.replace(kind=each.KEYWORD_ONLY) for each in own.values() if each.name != "settings"]
        run.__signature__ = inspect.Signature([*before, *options])  # type: ignore[attr-defined]
        run.__annotations__ = {each.name: each.annotation for each in (*before, *options)}
        run.__doc__ = command.__doc__
        return run

    return decorate


def _option(name: str, node: dict[str, Any], defaults: dict[str, Any]) -> inspect.Parameter:
    kind = _TYPES[node["type"]]
    text = node["description"] + (f" ({', '.join(node['enum'])})" if "enum" in node else "")
    words = [_SWITCHES[name]] if name in _SWITCHES else []
    limits: dict[str, Any] = {"min": int(node["minimum"]), "max": int(node["maximum"])} if kind is int else {}
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=defaults.get(name, node["default"]),
        annotation=Annotated[kind, typer.Option(*words, help=text, **limits)],
    )
