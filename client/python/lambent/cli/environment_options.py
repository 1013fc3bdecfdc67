"""Options that say how an environment map is to be understood, the same in every command."""

from typing import Annotated

import typer
from lambent_relight.environment.axes import QUARTER_TURNS
from lambent_relight.environment.input import EnvironmentInput
from lambent_relight.environment.layouts import AUTO, CHOICES

from lambent.cli.rendering import check_choice
from lambent.errors import UsageProblemError

EnvAxesOption = Annotated[
    str, typer.Option("--env-axes", metavar="NAME", help=f"The maps' layout: {', '.join(QUARTER_TURNS)}.")
]
EnvLayoutOption = Annotated[
    str,
    typer.Option("--env-layout", metavar="NAME", help=f"How the files show a sphere: {', '.join(CHOICES)}."),
]
SunClampOption = Annotated[
    float, typer.Option("--sun-clamp", metavar="L", help="Limit radiance to L and report the loss; 0: keep.")
]
MendEnvOption = Annotated[
    bool, typer.Option("--mend-env", help="Replace NaN, negative and infinite values instead of refusing.")
]


def environment_input(
    env_axes: str, sun_clamp: float, mend_env: bool, env_layout: str = AUTO
) -> EnvironmentInput:
    """Return the options as one value; raises `cli.bad_choice` for one that cannot be meant."""
    check_choice("--env-axes", env_axes, tuple(QUARTER_TURNS))
    check_choice("--env-layout", env_layout, CHOICES)
    if not 0.0 <= sun_clamp < float("inf"):
        raise UsageProblemError(
            "cli.bad_choice", f"--sun-clamp {sun_clamp}", "give a positive radiance, or 0"
        )
    return EnvironmentInput(axes=env_axes, layout=env_layout, mend=mend_env, sun_clamp=sun_clamp)
